"""Requests that leave arguments out, or name them."""

import pytest
from feeding import feed, samples

from dyknow.engine.durability.commands import Annotate, RegisterTemplate, RequestEvent
from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.engine.model.errors import BadArguments
from dyknow.journal.durability import Durability
from dyknow.languages.errors import LanguageError

HEAD = "REGISTER TEMPLATE Fast(?o{sort}, ?limit = 100)"
TEMPLATES = {
    "C-SPARQL": HEAD.format(sort="")
    + """ COMPUTE EVERY 1s AS
    CONSTRUCT { ?o dyknow:speed ?top } WHERE { ?o a dyknow:UAV ; dyknow:speed ?s }
    AGGREGATE {(?top, MAX, {?s}) FILTER (?top > ?limit)} WINDOW [RANGE 1s STEP 1s]""",
    "formula": HEAD.format(sort=" in UAV")
    + " AS speed(?o) < ?limit [km.h-1] with max delay 0s, report violations",
    "chronicle": HEAD.format(sort=" in UAV")
    + " AS chronicle fast(?o) { event(speed[?o]:(?, > ?limit), t); }",
    "SASE+": "REGISTER TEMPLATE Fast(?o in UAV, ?limit = 100) AS PATTERN SEQ(speed a, speed b) "
    "WHERE [id = ?o] AND b.v > ?limit WITHIN 1 second RETURN a.id AS id",
    "EP-SPARQL": "REGISTER TEMPLATE Fast(?o, ?limit = 100) AS SELECT ?o WHERE "
    "{ ?o dyknow:speed ?v } SEQ { ?o dyknow:speed ?w FILTER (?w > ?limit) } WITHIN 1 s",
}


@pytest.fixture
def flying(engine):
    engine.annotate("stream speeds contains speed(UAV) = v [km.h-1] for every UAV = id")
    return engine


def ask(engine, text):
    return engine.request_event(engine.parse_request(text))


@pytest.mark.parametrize("language", TEMPLATES)
def test_a_request_without_an_argument_is_the_one_with_the_default(flying, language):
    flying.register_template(TEMPLATES[language])
    texts = ("Fast(?o)", "Fast(?o, 100)", "Fast(?o, ?limit = 100)", "Fast(?limit = 100, ?o = ?x)")
    views = [ask(flying, text) for text in texts]
    other = ask(flying, "Fast(?o, ?limit = 200)")
    assert len({view.stream for view in views}) == 1
    assert other.stream != views[0].stream
    assert {view.arguments[1] for view in views} == {"100"}
    rows = [(t, {"id": "uav1", "v": 150.0}) for t in range(1, 6)]
    feed(flying, "speeds", rows)
    flying.end("speeds")
    assert samples(flying, views[0].stream)
    assert samples(flying, other.stream) == []
    made = flying.make_request("dyknow:Fast", ["?o", "?limit = 100"])
    assert flying.request_event(made).stream == views[0].stream


def test_an_object_may_be_free_by_default(flying):
    flying.register_template(TEMPLATES["formula"].replace("?o in UAV", "?o in UAV = ?o"))
    assert ask(flying, "Fast()").stream == ask(flying, "Fast(?x, 100)").stream
    chosen = ask(flying, "Fast(dyknow:uav1)")
    assert chosen.arguments == ("dyknow:uav1", "100")
    flying.register_template(
        "REGISTER TEMPLATE Near(?a in UAV, ?b in UAV = ?b) AS speed(?a) < speed(?b)"
    )
    # The free default is not the variable that the request gives.
    assert len(set(ask(flying, "Near(?b)").arguments)) == 2


@pytest.mark.parametrize(
    ("request_text", "message", "hint"),
    [
        ("Fast()", "dyknow:Fast takes 1 to 2 arguments, not 0", "Fast(?o, ?limit = 100)"),
        ("Fast(?o, 1, 2)", "takes 1 to 2 arguments, not 3", "Fast(?o, ?limit = 100)"),
        ("Fast(?limit = 1)", "?o has no argument, and it has no default", "Fast(?o, ?limit = 100)"),
        ("Fast(?o, ?limt = 1)", "no parameter is called ?limt", "Fast(?o, ?limit = 100)"),
        ("Fast(?o, 1, ?limit = 1)", "?limit is given twice", "leave one"),
        ("Fast(?o, ?limit = ?x)", "it must be given", "give a number"),
    ],
)
def test_wrong_arguments_are_refused(flying, request_text, message, hint):
    flying.register_template(TEMPLATES["formula"])
    with pytest.raises(BadArguments) as error:
        ask(flying, request_text)
    assert message in str(error.value)
    assert hint in error.value.hint


@pytest.mark.parametrize(
    ("language", "default", "message"),
    [
        ("C-SPARQL", "dyknow:UAV", "is not a literal"),
        ("C-SPARQL", "?free", "must be given"),
        ("formula", '"fast"', "is not a number"),
        ("formula", "?free", "it must be given"),
        ("chronicle", "true", "is not a number"),
        ("SASE+", "true", "is not a number"),
        ("EP-SPARQL", "dyknow:uav1", "it is a number in the template"),
    ],
)
def test_a_default_of_another_kind_is_refused_where_it_stands(flying, language, default, message):
    text = TEMPLATES[language].replace("= 100", f"= {default}")
    with pytest.raises(LanguageError) as error:
        flying.register_template(text)
    assert "the default of `?limit`: " in error.value.message
    assert message in error.value.message
    assert text[error.value.span.start : error.value.span.end] == default
    assert flying.templates() == ()


def test_a_default_of_an_unknown_sort_is_refused(flying):
    with pytest.raises(LanguageError, match="dyknow:Unknown is not a known sort"):
        flying.register_template(
            "REGISTER TEMPLATE Any(?o, ?type = dyknow:Unknown) AS CONSTRUCT { ?o dyknow:speed ?s } "
            "WHERE { ?o a ?type ; dyknow:speed ?s } WINDOW [RANGE 1s STEP 1s]"
        )


def test_an_explanation_has_the_default(flying):
    flying.register_template(TEMPLATES["C-SPARQL"])
    text = flying.explain(event="Fast(?o)")
    assert "100" in text.partition("-- query")[2] or "> 100" in text
    assert "parameters: ?o, ?limit = 100" in flying.explain(template="Fast")


def test_defaults_survive_a_restart(tmp_path):
    text = TEMPLATES["formula"]
    speeds = "stream speeds contains speed(UAV) = v [km.h-1] for every UAV = id"
    first = RecordedEngine(tmp_path, now=0, durability=Durability.WRITE)
    first.do(Annotate(speeds), 0)
    first.do(RegisterTemplate(text), 0)
    made = first.do(RequestEvent("Fast(?o)"), 0)
    first.close()
    second = RecordedEngine(tmp_path, now=0, durability=Durability.WRITE)
    assert second.engine.event(made.id).arguments == ("?o", "100")
    (template,) = second.engine.templates()
    assert [use.default for use in template.uses] == [None, "100"]
    second.close()
