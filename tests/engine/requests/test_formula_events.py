"""Formulas as templates: requested like any event, read by other events, and reading them."""

import pytest
from feeding import feed, samples

from dyknow.engine.model.errors import BadArguments, Conflict, NoPlan, Refused
from dyknow.engine.model.views import StreamDeclaration
from dyknow.languages.errors import LanguageError
from dyknow.streams.sample import Field, FieldType

RECKLESS = (
    "REGISTER TEMPLATE dyknow:Reckless(?x, ?limit) AS\n"
    "always [0s, 10s] (speed(?x) > ?limit -> eventually [0s, 2s] speed(?x) < 90)"
    " with max delay 0s"
)
FAST = "REGISTER TEMPLATE Fast(?o in UAV) AS speed(?o) > 100 with report verdicts, max delay 0s"
HIGH = """REGISTER TEMPLATE dyknow:High(?o, ?type) COMPUTE EVERY 1s AS
PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
CONSTRUCT { ?o dyknow:speed ?m } WHERE { ?o a ?type . ?o dyknow:speed ?s }
AGGREGATE {(?m, MAX, {?s}) FILTER (?m > 100)} WINDOW [RANGE 1s STEP 1s]"""


@pytest.fixture
def flying(engine):
    engine.annotate("stream speeds contains speed(UAV) = spd [km.h-1] for every UAV = id")
    return engine


def fly(engine):
    """uav1 is above 100 km/h for four seconds, uav2 for one."""
    rows = []
    for t in range(1, 13):
        rows.append((t, {"id": "uav1", "spd": 120.0 if 3 <= t < 7 else 80.0}))
        rows.append((t, {"id": "uav2", "spd": 120.0 if t == 5 else 80.0}))
    feed(engine, "speeds", rows)
    engine.end("speeds")


def ask(engine, text):
    return engine.request_event(engine.parse_request(text))


def told(engine, view):
    return [
        (values["x"], int(start), values["verdict"])
        for start, values in samples(engine, view.stream)
    ]


def test_its_events_are_violations(flying):
    flying.register_template(RECKLESS)
    view = ask(flying, "Reckless(?car, 100)")
    assert view.event.endswith("Reckless")
    assert [unit.transformation for unit in view.plan.units] == ["mtl"]
    assert "request=Reckless(?car, 100)" in view.plan.text
    fly(flying)
    # The speed of 3 s falls below 90 at 7 s only. Starts up to ten seconds before see it.
    assert told(flying, view) == [("uav1", start, "false") for start in (1, 2, 3, 4)]
    assert "4 false" in flying.explain_running(view.id)


def test_an_object_and_a_threshold_are_arguments(flying):
    flying.register_template(RECKLESS)
    views = [ask(flying, f"Reckless(dyknow:{name}, 70)") for name in ("uav1", "uav2")]
    other = ask(flying, "Reckless(dyknow:uav1, 130)")
    assert ask(flying, "Reckless(dyknow:uav1, 70)").stream == views[0].stream
    fly(flying)
    assert {name for name, _, _ in told(flying, views[0])} == {"uav1"}
    assert told(flying, views[1]) == []
    assert told(flying, other) == []


def test_its_events_have_their_robustness(flying):
    flying.register_template(RECKLESS + ", robustness")
    view = ask(flying, "Reckless(?car, 100)")
    assert "reported are violations, with their robustness" in flying.explain_running(view.id)
    fly(flying)
    # The speed is 20 km/h above the limit, and 30 above what it should come down to.
    assert [s["robustness"] for _, s in samples(flying, view.stream)] == [-20.0] * 4


def test_streams_of_its_events_are_found(flying):
    flying.register_template(FAST)
    view = ask(flying, "Fast(?o)")
    assert f"stream {view.stream} : Fast for every UAV = o" in str(flying.match("Fast", sort="UAV"))
    text = 'monitor was(?x in UAV) = once [0s, 3s] Fast(?x) = "true" with report changes'
    flying.queries.register(text)
    assert flying.explain_running("was").count("chosen: stream") == 1


@pytest.mark.parametrize(
    "text",
    [
        'monitor slow(?x in UAV) = Fast(?x) = "false" with report violations',
        'monitor slow = forall ?x in UAV Fast(?x) = "false" with report violations',
        'monitor slow = Fast(uav1) = "false" with report violations',
    ],
)
def test_a_formula_builds_on_events_of_a_formula(flying, text):
    """Nobody has requested the event: matching finds its template."""
    flying.register_template(FAST)
    flying.queries.register(text)
    fly(flying)
    starts = {int(start) for start, _ in samples(flying, "slow")}
    assert starts == {3, 4, 5, 6}


def test_a_query_builds_on_events_of_a_formula(flying):
    flying.register_template(FAST)
    flying.queries.register(
        "REGISTER STREAM q AS PREFIX dyknow: <http://www.ida.liu.se/dyknow/>\n"
        'SELECT ?o WHERE { ?o dyknow:Fast ?v . FILTER (STR(?v) = "true") } '
        "WINDOW [RANGE 1s STEP 1s]"
    )
    fly(flying)
    assert {values["o"] for _, values in samples(flying, "q")} == {"uav1", "uav2"}


def test_a_formula_builds_on_events_of_a_query(flying):
    flying.register_template(HIGH)
    flying.register_template("REGISTER TEMPLATE VeryHigh(?x in UAV, ?m) AS High(?x) < ?m")
    view = ask(flying, "VeryHigh(?x, 110)")
    assert [unit.transformation for unit in view.plan.units] == ["cSparql", "mtl"]
    fly(flying)
    assert {name for name, _, _ in told(flying, view)} == {"uav1", "uav2"}


def test_what_is_missing(flying):
    flying.register_template("REGISTER TEMPLATE Low(?x in UAV) AS altitude(?x) < 3")
    with pytest.raises(NoPlan) as refused:
        ask(flying, "Low(?x)")
    assert any("altitude" in each for each in refused.value.missing)


@pytest.mark.parametrize(
    ("request_text", "message", "hint"),
    [
        ("Reckless(?c)", "takes 2 arguments, not 1", "Reckless(?x, ?limit)"),
        ("Reckless(?c, ?d)", "argument 2 (?limit): it must be given", "a number"),
        ('Reckless(?c, "fast")', '"fast" is not a number', "such as 100"),
        ("Reckless(?c, 1e999)", "1e999 is not finite", "such as 100"),
        ("Reckless(?c, dyknow:uav1)", "it is a number in the template", "a number"),
        ("Reckless(100, 100)", "argument 1 (?x): it stands for an object", "dyknow:uav1"),
    ],
)
def test_wrong_arguments(flying, request_text, message, hint):
    flying.register_template(RECKLESS)
    with pytest.raises(BadArguments) as refused:
        ask(flying, request_text)
    assert message in refused.value.detail
    assert hint in refused.value.hint


def test_a_variable_for_two_arguments(flying):
    flying.register_template(
        "REGISTER TEMPLATE Beside(?a in UAV, ?b in UAV) AS speed(?a) > speed(?b)"
    )
    with pytest.raises(BadArguments, match="used for two arguments"):
        ask(flying, "Beside(?x, ?x)")


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("REGISTER TEMPLATE Fast(?x) AS sped(?x) > 3", LanguageError, "no feature `sped`"),
        ("REGISTER TEMPLATE speed(?x) AS speed(?x) > 3", Refused, "is a feature"),
        ("REGISTER TEMPLATE Fast(?verdict) AS speed(?verdict) > 3", Refused, "'verdict'"),
        ("REGISTER TEMPLATE Fast(?x in UAV) AS wind > 3", LanguageError, "`wind`"),
    ],
)
def test_templates_that_are_refused(flying, text, error, message):
    with pytest.raises(error, match=message):
        flying.register_template(text)
    assert flying.templates() == ()


def test_an_event_never_needs_itself(flying):
    flying.register_template("REGISTER TEMPLATE One(?x in UAV) AS speed(?x) > 3")
    flying.register_template('REGISTER TEMPLATE Two(?x in UAV) AS One(?x) = "true"')
    with pytest.raises(Refused, match="One would need itself: dyknow:One needs dyknow:Two needs"):
        flying.register_template(
            'REGISTER TEMPLATE One(?x in UAV) AS Two(?x) = "true"', replace=True
        )


def test_it_is_removed_when_its_requests_are_cancelled(flying):
    flying.register_template(FAST)
    view = ask(flying, "Fast(?o)")
    with pytest.raises(Conflict):
        flying.remove_template("Fast")
    flying.cancel_event(view.id)
    flying.remove_template("Fast")
    assert flying.units() == ()


@pytest.mark.parametrize(
    ("text", "lacks"),
    [
        (RECKLESS, "?limit must be given"),
        ("REGISTER TEMPLATE Two(?x, ?y) AS speed(?x) > speed(?y)", "no event of a single object"),
    ],
)
def test_matching_says_why_it_cannot_use_one(flying, text, lacks):
    view = flying.register_template(text)
    assert lacks in str(flying.match(view.local_name, sort="UAV"))


MODES = """@prefix dyknow: <http://www.ida.liu.se/dyknow/> .
@prefix o: <http://www.dyknow.eu/ontology#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
@prefix xsd: <http://www.w3.org/2001/XMLSchema#> .
dyknow:mode a o:UnaryFeature ; rdfs:range xsd:string .
dyknow:ready a o:UnaryFeature ; rdfs:range xsd:boolean .
dyknow:seen a o:UnaryFeature ; rdfs:range xsd:dateTime .
dyknow:leader a o:UnaryFeature ; rdfs:range dyknow:UAV ."""
FIELDS = {"mode": FieldType.STRING, "ready": FieldType.BOOLEAN, "seen": FieldType.STRING,
          "leader": FieldType.STRING}  # fmt: skip
NOON = "1970-01-01T12:00:00Z"
LITERALS = [
    ("mode", '"land"', "land", "fly"),
    ("ready", "true", True, False),
    (
        "seen",
        '"1970-01-01T00:00:05Z"^^xsd:dateTime',
        "1970-01-01T00:00:05Z",
        "1970-01-01T00:00:06Z",
    ),
    ("leader", "dyknow:uav2", "uav2", "uav3"),
]


@pytest.mark.parametrize(("feature", "argument", "same", "other"), LITERALS)
def test_values_of_every_kind_are_arguments(engine, feature, argument, same, other):
    engine.load_ontology(MODES, name="http://example.org/modes")
    fields = [Field("id", FieldType.STRING), Field("it", FIELDS[feature])]
    engine.declare(StreamDeclaration("m", tuple(fields)))
    engine.annotate(f"stream m contains {feature}(UAV) = it for every UAV = id")
    engine.register_template(f"REGISTER TEMPLATE Never(?x in UAV, ?it) AS not {feature}(?x) = ?it")
    view = ask(engine, f"Never(?x, {argument})")
    feed(engine, "m", [(t, {"id": "uav1", "it": same if t == 2 else other}) for t in (1, 2, 3)])
    engine.end("m")
    assert told(engine, view) == [("uav1", 2, "false")]
    with pytest.raises(BadArguments, match='and "7" is none'):
        ask(engine, "Never(?x, 7)")


def test_a_feature_needs_an_object(engine):
    wind = "<http://www.ida.liu.se/dyknow/wind> a <http://www.dyknow.eu/ontology#Feature> ."
    engine.load_ontology(wind, name="http://example.org/wind")
    with pytest.raises(BadArguments, match="`wind` names no object"):
        engine.queries.register("monitor m = wind > 3")
    with pytest.raises(Refused, match="`wind` names no object"):
        engine.register_template("REGISTER TEMPLATE Windy(?limit) AS wind > ?limit")


@pytest.mark.parametrize("policy", ["any change", "sample every 1s"])
@pytest.mark.parametrize("option", ["", ", robustness"])
def test_a_text_that_is_not_known_yet_is_not_compared(engine, policy, option):
    engine.annotate(
        "stream a contains callsign(UAV) = c, speed(UAV) = v [km.h-1] for every UAV = id"
    )
    view = engine.queries.register(
        'monitor m(?x in UAV) = callsign(?x) < "b" or speed(?x) > 3 '
        f"with {policy}, use most recent, report verdicts{option}"
    )
    rows = [(1, 2.0, None), (2, 5.0, None), (3, 2.0, "a"), (4, 2.0, "c")]
    feed(engine, "a", [(t, {"id": "u1", "v": v, "c": c}) for t, v, c in rows])
    engine.end("a")
    assert told(engine, view) == [
        ("u1", 1, "unknown"), ("u1", 2, "true"), ("u1", 3, "true"), ("u1", 4, "false")
    ]  # fmt: skip


@pytest.mark.parametrize("policy", ["any change", "sample every 1s"])
def test_after_its_last_state_no_sample_is_kept(engine, policy):
    engine.annotate("stream a contains speed(UAV) = v [km.h-1] for every UAV = id")
    view = engine.queries.register(
        f"monitor m(?x in UAV) = speed(?x) > 3 with {policy}, use most recent, "
        "from 1000 to 5000, report verdicts"
    )
    feed(engine, "a", [(t, {"id": "u1", "v": 9.0}) for t in range(1, 200)])
    assert engine.queries.unit("m").monitoring.retained < 5
    engine.end("a")
    assert told(engine, view) == [("u1", start, "true") for start in range(1, 6)]
