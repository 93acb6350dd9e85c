"""Random lives of an engine: commands in some order, some of which are refused."""

from __future__ import annotations

import json
from random import Random

from dyknow.engine.durability import commands as c
from dyknow.engine.model.errors import DyknowError
from dyknow.engine.model.views import Since, StreamDeclaration
from dyknow.languages.errors import LanguageError
from dyknow.ontology.errors import OntologyError
from dyknow.streams.history import Retention
from dyknow.streams.past_queries import Forgotten
from dyknow.streams.sample import Field, FieldType
from dyknow.streams.time import SECOND

REFUSALS = (DyknowError, LanguageError, OntologyError, Forgotten)
IRI = "http://www.ida.liu.se/dyknow/"
OBJECTS = ("uav1", "uav2", "rmax1")
FIELDS = (Field("id", FieldType.STRING), Field("v", FieldType.FLOAT), Field("h", FieldType.FLOAT))
FAST = """REGISTER TEMPLATE dyknow:FastEvent(?o, ?type, ?limit) COMPUTE EVERY 1s AS
PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
CONSTRUCT { ?o dyknow:speed ?average }
FROM <http://www.ida.liu.se/dyknow/ontology.rdf>
WHERE { ?o a ?type . ?o dyknow:speed ?speed }
AGGREGATE {(?average, AVG, {?speed}) FILTER (?average > ?limit)}
WINDOW [RANGE 3s STEP 1s]"""
TURN = """REGISTER TEMPLATE dyknow:TurnEvent(?o, ?least) AS
PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
SELECT ?o ?h ?s
WHERE { ?o dyknow:heading ?h . OPTIONAL { ?o dyknow:speed ?s } FILTER (?h > ?least) }
WINDOW [RANGE 2s STEP 1s]"""
SORTS = """@prefix dyknow: <http://www.ida.liu.se/dyknow/> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
dyknow:rmax1 a dyknow:RMAX . dyknow:uav1 a dyknow:UAV . dyknow:uav2 a dyknow:UAV .
"""
ANNOTATIONS = (
    "stream s contains speed(UAV) = v, heading(UAV) = h for every UAV = id",
    "stream s contains speed(UAV) = v for every UAV = id",
    "stream t contains heading(UAV) = h for every UAV = id",
    "stream t contains speed(RMAX) = v for every RMAX = id",
    "stream nowhere says nothing",
)
_S, _T = f"<{IRI}s.trdf>", f"<{IRI}t.trdf>"
_COUNT, _EACH = "(COUNT(?v) AS ?n)", "?o (MIN(?v) AS ?low) (MAX(?v) AS ?high)"
QUERIES = (
    f"SELECT {_COUNT} FROM STREAM {_S} [RANGE 3s STEP 1s] WHERE {{ ?o dyknow:speed ?v }}",
    f"SELECT {_EACH} FROM STREAM {_S} [RANGE 4s STEP 2s] WHERE {{ ?o dyknow:speed ?v }} "
    "GROUP BY ?o",
    f"SELECT ?o (AVG(?v) AS ?a) FROM STREAM {_S} [RANGE 3s STEP 1s] WHERE {{ ?o dyknow:speed ?v }} "
    "GROUP BY ?o HAVING (AVG(?v) > 2)",
    f"SELECT ?o ?v FROM STREAM {_S} [TRIPLES 3 STEP 2] WHERE {{ ?o dyknow:speed ?v }}",
    f"SELECT ?o ?v ?h FROM STREAM {_S} [RANGE 2s STEP 1s] FROM STREAM {_T} [RANGE 3s STEP 1s] "
    "WHERE { ?o dyknow:speed ?v . ?o dyknow:heading ?h }",
    f"SELECT ?p ?v FROM STREAM {_S} [RANGE 2s STEP 1s] "
    "WHERE { ?o (dyknow:speed|dyknow:heading) ?v . BIND (STR(?o) AS ?p) }",
    f"SELECT ?o (SUM(?v) AS ?sum) FROM STREAM {_S} [LANDMARK STEP 2s] "
    "WHERE { ?o dyknow:speed ?v } GROUP BY ?o",
    f"SELECT ?o (RAND() + ?v AS ?r) (STRUUID() AS ?u) FROM STREAM {_S} [RANGE 3s STEP 1s] "
    "WHERE { ?o dyknow:speed ?v }",
    f"SELECT ?o (STR(BNODE()) AS ?b) (STR(NOW()) AS ?n) FROM STREAM {_S} [RANGE 3s STEP 1s] "
    "WHERE { ?o dyknow:speed ?v }",
    f"CONSTRUCT {{ ?o dyknow:speed ?w }} FROM <{IRI}ontology.rdf> FROM STREAM {_S} "
    "[RANGE 2s STEP 1s] WHERE { ?o a dyknow:UAV . ?o dyknow:speed ?v . BIND (?v * 2 AS ?w) }",
    f"SELECT ?o ?v FROM STREAM {_S} [RANGE 2s STEP 1s] WHERE {{ ?o dyknow:speed ?v }} "
    "ORDER BY DESC(?v) ?o LIMIT 2",
    f"SELECT ?o ?v FROM STREAM {_S} [RANGE 2s STEP 1s] WHERE {{ ?o dyknow:speed+ ?v }}",
    f"SELECT (GROUP_CONCAT(?n; SEPARATOR=' ') AS ?all) FROM STREAM {_S} [RANGE 2s STEP 1s] "
    "WHERE { ?o dyknow:speed ?v BIND (CONCAT(STR(?o), STR(?v)) AS ?n) }",
    "SELECT ?o (MAX(?v) AS ?m) WHERE { ?o dyknow:speed ?v } GROUP BY ?o WINDOW [RANGE 2s STEP 1s]",
    f"SELECT ?x WHERE {{ ?x dyknow:speed }} FROM STREAM {_S}",
    f"SELECT ?o FROM STREAM <{IRI}nowhere.trdf> [RANGE 2s STEP 1s] WHERE {{ ?o dyknow:speed ?v }}",
)
ISTREAM = (
    f"REGISTER ISTREAM <news> AS SELECT ?o ?v FROM NAMED WINDOW <{IRI}w> ON {_S} "
    f"[RANGE PT3S STEP PT1S] WHERE {{ WINDOW <{IRI}w> {{ ?o dyknow:speed ?v }} }}"
)
KPL = (
    "source float k\nstrmgen g = k\nstream slow = g with sample every 2s, max delay 1s",
    "stream ordered = g with monotone order, max delay 2s",
    "source float k\nstrmgen g = k\nstream ordered = g with sample change 2, max delay 1s",
    "stream nothing = nowhere",
)
POLICIES = ("", "sample every 1s", "monotone order, max delay 1s", "any order", "no policy")


def life(random: Random, length: int) -> list[c.Command]:
    """``length`` commands for a new engine, after those that make its streams."""
    made = _Life(random)
    return [*made.beginning(), *(made.next() for _ in range(length)), *made.ending()]


class _Life:
    def __init__(self, random: Random) -> None:
        self._random = random
        self._now = 0
        self._stamped = {"s": False, "t": random.random() < 0.3}
        self._last = 0

    def beginning(self) -> list[c.Command]:
        idle = self._random.choice((None, 2 * SECOND))
        return [
            c.LoadOntology(SORTS, f"{IRI}objects"),
            self._declare(),
            c.DeclareStream(StreamDeclaration("t", FIELDS, 0, idle=idle)),
            c.Annotate(ANNOTATIONS[0]),
            c.Annotate(ANNOTATIONS[2]),
            c.RegisterTemplate(FAST),
            c.RegisterTemplate(TURN),
        ]

    def _declare(self) -> c.Command:
        """Also while it is in use: then it keeps more or less from now on."""
        pick = self._random
        age = pick.choice((None, 20 * SECOND))
        kept = Retention(pick.choice((5, 100_000)), age, pick.choice((None, None, 900)))
        return c.DeclareStream(StreamDeclaration("s", FIELDS, 2 * SECOND, kept))

    def ending(self) -> list[c.Command]:
        return [self._batch("s"), self._batch("t"), c.Tick(self._now + 20 * SECOND)]

    def next(self) -> c.Command:
        pick = self._random
        makers = (
            *(lambda: self._batch(pick.choice("sst")),) * 6,
            *(self._tick,) * 2,
            *(self._request,) * 2,
            self._query,
            self._query,
            lambda: c.RemoveQuery(f"q{pick.randrange(len(QUERIES))}"),
            lambda: c.RemoveQuery(f"dyknow_reserved{pick.randrange(1, 6)}"),
            lambda: c.CancelEvent(f"event{pick.randrange(1, 6)}"),
            lambda: c.Subscribe(
                pick.choice(("s", "t", "s_late", "q0", "nowhere")),
                pick.choice(POLICIES),
                since=self._since(),
            ),
            lambda: c.SubscribeToFeature(
                "dyknow:speed",
                sort="dyknow:UAV",
                strategy=pick.choice(("fast", "quality")),
                since=self._since(),
            ),
            lambda: c.Unsubscribe(f"subscription{pick.randrange(1, 5)}"),
            lambda: c.AddKpl(pick.choice(KPL)),
            self._values,
            lambda: c.RemoveKpl(pick.choice(("slow", "ordered")), pick.random() < 0.5),
            lambda: c.Annotate(pick.choice(ANNOTATIONS)),
            lambda: c.OpenStream(pick.choice(("s_late", "t_late", "slow_violations"))),
            self._declare,
            lambda: c.SetQuality("s", pick.choice((0.2, 0.9))),
            lambda: c.EndStream(pick.choice("st")),
            lambda: c.RegisterTemplate(FAST, replace=pick.random() < 0.5),
            lambda: c.LoadOntology(SORTS + "dyknow:uav3 a dyknow:UAV .", f"{IRI}objects"),
            lambda: c.RemoveOntology(f"{IRI}objects"),
        )
        return pick.choice(makers)()

    def _tick(self) -> c.Command:
        self._now += self._random.choice((10**8, SECOND, 3 * SECOND))
        return c.Tick(self._now)

    def _request(self) -> c.Command:
        pick = self._random
        one = pick.choice(("?o", *(f"dyknow:{name}" for name in OBJECTS)))
        text = pick.choice(
            (
                f"dyknow:FastEvent({one}, dyknow:UAV, {pick.choice((1, 2.5))})",
                f"dyknow:FastEvent({one}, dyknow:RMAX, 1)",
                f"dyknow:TurnEvent({one}, {pick.choice((1, 3))})",
                "dyknow:NoEvent(?o)",
            )
        )
        return c.RequestEvent(text, since=self._since())

    def _query(self) -> c.Command:
        number = self._random.randrange(len(QUERIES) + 1)
        if number == len(QUERIES):
            return c.RegisterQuery(ISTREAM)
        # Without a name the system gives it one.
        head = self._random.choice(("REGISTER STREAM q{} AS ", "REGISTER QUERY q{} AS ", ""))
        text = head.format(number) + QUERIES[number]
        return c.RegisterQuery(text, since=self._since())

    def _since(self) -> str:
        pick = self._random
        ago = self._last - pick.choice((0, SECOND, 5 * SECOND))
        return pick.choice((*Since, *Since, str(max(ago, 0)), "2s", "1ms"))

    def _values(self) -> c.Command:
        """For the source of KPL."""
        self._last += SECOND
        row = {"valid": self._last, "available": self._last, "value": float(self._last % 7)}
        return c.Publish("k", "ndjson", json.dumps(row).encode(), self._now)

    def _batch(self, stream: str) -> c.Command:
        pick = self._random
        rows = []
        for _ in range(pick.randrange(1, 5)):
            self._last += pick.choice((10**7, 3 * 10**8, SECOND))
            row = {
                "valid": self._last,
                "id": pick.choice(OBJECTS),
                "v": float(pick.randrange(6)),
                "h": pick.choice((None, float(pick.randrange(6)))),
            }
            if not self._stamped[stream]:
                row["available"] = self._last - pick.choice((0, 0, 0, SECOND, 4 * SECOND))
            rows.append(row)
        self._now = max(self._now, self._last)
        body = "\n".join(map(json.dumps, rows)).encode()
        key = pick.choice((None, None, None, "again"))
        return c.Publish(stream, "ndjson", body, self._now, key)


def state(engine) -> dict[str, object]:
    """All that can be seen of an engine, in the forms in which it is shown."""
    streams = {}
    for view in engine.streams():
        stream = engine.generator(view.name).stream
        batch = stream.all()
        streams[view.name] = (
            repr(view),
            stream.first_number,
            list(batch.rows()),
            engine.rdf_of(view.name, batch),
        )
    return {
        "epoch": engine.epoch,
        "streams": streams,
        "requests": [repr(view) for view in engine.events()],
        "subscriptions": [repr(view) for view in engine.subscriptions()],
        "queries": [repr(view) for view in engine.queries.views()],
        "windows": {
            view.name: [
                (result.end, [str(row) for row in result.solutions.rows()])
                for result in engine.queries.results(view.name)
                if hasattr(result.solutions, "rows")
            ]
            for view in engine.queries.views()
            if engine.queries.has(view.name)
        },
        "kpl": engine.kpl_text(),
        "specification": engine.current_specification(),
        "templates": [repr(view) for view in engine.templates()],
        "annotations": [repr(each) for each in engine.annotations()],
    }
