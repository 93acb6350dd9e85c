"""Chronicles over samples: those of [DyKnow10 §2, §7] and SPEC §8, each clause, and refusals."""

from __future__ import annotations

import pytest
from chronicle_definition import Sample, Value
from chronicle_worlds import SORTS, Evaluation
from vocabularies import vocabulary_of

from dyknow.languages.chronicle import (
    check_chronicle,
    check_chronicle_template,
    parse_chronicle,
    parse_chronicle_template,
    with_arguments,
)
from dyknow.languages.errors import LanguageError
from dyknow.languages.mtl.checked import Constant, Kind
from dyknow.rdf.namespaces import DYKNOW
from dyknow.reasoning.patterns.compilation.chronicle_plans import chronicle_query
from dyknow.reasoning.patterns.compilation.chronicle_sources import chronicle_sources
from dyknow.reasoning.patterns.plans.query import Argument, PatternQuery

ONTOLOGY = """
dyknow:Thing a owl:Class .
dyknow:Car a owl:Class ; rdfs:subClassOf dyknow:Thing .
dyknow:Taxi a owl:Class ; rdfs:subClassOf dyknow:Car , dyknow:Thing .
dyknow:behind a dyknow-o:Feature ; rdfs:range xsd:boolean .
dyknow:beside a dyknow-o:Feature ; rdfs:range xsd:boolean .
dyknow:inFront a dyknow-o:Feature ; rdfs:range xsd:boolean .
dyknow:close a dyknow-o:Feature ; rdfs:range xsd:boolean .
dyknow:on a dyknow-o:Feature ; rdfs:range xsd:boolean .
dyknow:lane a dyknow-o:Feature ; rdfs:range xsd:string .
dyknow:speed a dyknow-o:Feature ; dyknow-o:hasUnit "km.h-1" .
dyknow:stopped a dyknow-o:Event .
dyknow:alarm a dyknow-o:Event .
"""
OVERTAKE = """chronicle RecklessOvertake(?a, ?b) {
  event(behind[?a, ?b]:(false, true), t1); event(beside[?a, ?b]:(false, true), t2);
  event(inFront[?a, ?b]:(false, true), t3);
  noevent(stopped[?b], (t1, t3)); t2 - t1 in [0s, 8s]; t3 - t2 in [0s, 5s];
  when recognized { emit event(RecklessOvertake[?a, ?b], t3); }
}"""


VOCABULARY = vocabulary_of(ONTOLOGY)
S = 10**9


def query(text: str) -> PatternQuery:
    checked = check_chronicle(parse_chronicle(text), text, VOCABULARY)
    return chronicle_query(checked, text, VOCABULARY)


def samples(lines: str) -> list[Sample]:
    """``3 behind a b true``: time (s), feature, objects, value."""
    found = []
    for number, line in enumerate(lines.strip().splitlines()):
        time, concept, *objects, text = line.split()
        value: Value = {"true": True, "false": False}.get(text, text)
        if text[0].isdigit():
            value = float(text)
        iris = tuple(DYKNOW + each for each in objects)
        found.append(Sample(number, DYKNOW + concept, iris, value, int(float(time) * S)))
    return found


def found(text: str | PatternQuery, lines: str) -> list[tuple[float, ...]]:
    """The matches as (valid, end, objects and values of the head)."""
    evaluation = Evaluation(query(text) if isinstance(text, str) else text, SORTS)
    matches = evaluation.push(samples(lines)) + evaluation.end()
    return [
        (each.valid / S, each.end / S, *(str(v).removeprefix(DYKNOW) for v in each.head))
        for each in matches
    ]


OVERTAKING = """
0 behind a b false
0 beside a b false
0 inFront a b false
2 behind a b true
4 behind a b true
6 beside a b true
6 behind a b false
9 inFront a b true
"""


def test_a_reckless_overtake_is_found_once() -> None:
    assert found(OVERTAKE, OVERTAKING) == [(9, 9, "a", "b")]


@pytest.mark.parametrize(
    ("line", "by"),
    [
        ("6 beside a b true", "11 beside a b true"),  # later than 8 s after
        ("9 inFront a b true", "12 inFront a b true"),  # later than 5 s after
        ("9 inFront a b true", "9 inFront b a true"),
        ("0 beside a b false", "0 beside a b true"),  # no change
        ("0 beside a b false", ""),  # the first sample changes from no value
        ("4 behind a b true", "4 stopped b 1"),
    ],
)
def test_no_reckless_overtake(line: str, by: str) -> None:
    changed = OVERTAKING.replace(line + "\n", by + "\n" if by else "")
    lines = sorted(changed.strip().splitlines(), key=lambda each: float(each.split()[0]))
    assert changed != OVERTAKING
    assert found(OVERTAKE, "\n".join(lines)) == []


def test_a_stop_at_an_end_of_an_open_interval_is_none_within_it() -> None:
    stops = "2 stopped b 1\n" + OVERTAKING.strip().split("\n", 3)[3] + "\n9 stopped b 1\n"
    start = "\n".join(OVERTAKING.strip().splitlines()[:3])
    assert found(OVERTAKE, f"{start}\n{stops}") == [(9, 9, "a", "b")]


def test_close_cars_on_a_road() -> None:
    """The relations of [DyKnow10 §2]: beside, close and on."""
    text = """chronicle Squeeze(?a, ?b) {
      event(close[?a, ?b]:(false, true), t1); event(beside[?a, ?b]:(false, true), t2);
      hold(on[?a, road1]:true, (t1, t2)); t2 - t1 in [0s, 3s]; ?a != ?b;
    }"""
    lines = """
0 on a road1 true
0 close a b false
0 beside a b false
1 close a b true
2 beside a b true
3 close a b false
4 close a b true
5 on a road1 false
6 beside a b false
6 beside a b true
"""
    assert found(text, lines) == [(2, 2, "a", "b")]


@pytest.mark.parametrize(
    ("clause", "times"),
    [
        ("noevent(alarm[?x], (t - 2s, t))", [1, 2, 6]),
        ("noevent(alarm[?x], (t, t + 2s))", [4, 5, 6]),
        ("noevent(alarm[?x], (t + 1s, t - 1s))", [1, 2, 3, 4, 5, 6]),
        ("occurs((1, 1), alarm[?x], (t - 3s, t))", [3, 5, 6]),
        ("occurs((2, oo), alarm[?x], (t - 4s, t + 1s))", [3, 4, 5]),
        ("occurs((1, oo), alarm[b], (t - 2s, t + 2s))", [3, 4, 5]),
        ("occurs((2, oo), alarm[?], (t - 4s, t + 1s))", [3, 4, 5, 6]),
        ('hold(lane[?x]:"left", (t - 1s, t))', [3, 4]),
        ('hold(lane[?x]:"left", (t, t + 1s))', [2, 3]),
        ('hold(lane[?x]:!= "left", (t, t))', [1, 5, 6]),
        ("hold(lane[?x]:?, (t - 2s, t))", [2, 3, 4, 5, 6]),
    ],
)
def test_what_is_asked_around_an_event(clause: str, times: list[int]) -> None:
    """The times (s) of the samples of speed that are matches."""
    text = f"chronicle N(?x) {{ event(speed[?x], t); {clause}; }}"
    lines = """
0 lane a right
1 speed a 5
2 lane a left
2 alarm a 1
2 speed a 5
3 speed a 5
3.5 alarm a 1
4 alarm b 1
4 speed a 5
5 lane a right
5 speed a 5
6 speed a 5
"""
    assert [row[0] for row in found(text, lines)] == times


def test_distinct_clauses_take_distinct_samples_of_one_time() -> None:
    text = "chronicle N(?v, ?w) { event(speed[?x]:(?, ?v), t); event(speed[?x]:(?, ?w), t); }"
    assert found(text, "1 speed a 5") == []
    both = found(text, "1 speed a 5\n1 speed a 6")
    assert both == [(1, 1, "5.0", "6.0"), (1, 1, "6.0", "5.0")]


def test_values_meet_in_the_unit_of_the_feature() -> None:
    text = "chronicle N(?v) { event(speed[?x]:(< 5 [m.s-1], ?v), t); ?v >= 10 [m.s-1]; }"
    lines = "0 speed a 17.9\n1 speed a 36\n2 speed a 18\n3 speed a 40\n4 speed a 17\n5 speed a 35"
    assert found(text, lines) == [(1, 1, "36.0")]


def test_the_time_of_a_match_is_that_of_its_last_event_or_the_one_emitted() -> None:
    body = "event(speed[?x], t1); event(alarm[?x], t2); t2 - t1 in [1s, 2s];"
    lines = "1 speed a 5\n2 alarm a 1"
    assert found(f"chronicle N {{ {body} }}", lines) == [(2, 2)]
    emitted = f"chronicle N {{ {body} when recognized {{ emit event(N, t1); }} }}"
    assert found(emitted, lines) == [(1, 2)]


def test_a_match_waits_until_nothing_may_happen_any_more() -> None:
    text = "chronicle N { event(speed[a], t); noevent(alarm[a], (t, t + 5s)); }"
    evaluation = Evaluation(query(text))
    assert not evaluation.push(samples("1 speed a 5\n5 speed a 5"))
    assert [each.valid for each in evaluation.push(samples("6 speed a 5"))] == [S]
    assert [each.valid for each in evaluation.end()] == [5 * S, 6 * S]


# -- sources ---------------------------------------------------------------------------------


def arguments(text: str) -> dict[str, list[str | None]]:
    """The sort or object of each argument of each source."""
    return {
        each.kind.removeprefix("dyknow:"): [
            (a.object or a.sort or "").removeprefix(DYKNOW) for a in each.arguments
        ]
        for each in query(text).sources
    }


@pytest.mark.parametrize(
    ("clauses", "expected"),
    [
        ("event(on[?x, road1], t);", {"on": ["Car", "road1"]}),
        ("event(on[?x, ?y], t); ?y in Taxi;", {"on": ["Car", "Taxi"]}),
        ("event(on[?x, ?x], t);", {"on": ["Car", "Car"]}),
        (
            "event(close[?x, ?y], t); event(on[?x, ?], t);",
            {"close": ["Car", "Thing"], "on": ["Car", "Thing"]},
        ),
        # The widest of several sorts, if it contains the others.
        (
            "event(on[?x, a], t); event(on[?y, b], t); ?y in Taxi; event(speed[?y], t);",
            {"on": ["Car", "Thing"], "speed": ["Taxi"]},
        ),
        (
            "event(speed[?x], t); event(close[?x, b], t); event(alarm[?y], t);"
            "noevent(speed[?y], (t, t));",
            {"speed": ["Thing"], "close": ["Car", "b"], "alarm": ["Thing"]},
        ),
    ],
)
def test_sources(clauses: str, expected: dict[str, list[str]]) -> None:
    assert arguments(f"chronicle N(?x in Car) {{ {clauses} }}") == expected


def test_only_sources_of_changes_ask_for_the_value_before() -> None:
    text = "chronicle N { event(speed[a]:(?, > 3), t); event(on[a, b]:(false, ?), t); }"
    assert [each.has_changes for each in query(text).sources] == [False, True]


@pytest.mark.parametrize(
    ("text", "message", "hint"),
    [
        (
            "chronicle N {\n event(speed[?x], t1); event(alarm[?x], t2); t1 < t2 }",
            "kept for ever, as `t2` may come at any time after `t1`",
            "`t2 - t1 <= 1m`",
        ),
        (
            "chronicle N {\n event(speed[?x], t1); event(alarm[?x], t2); t1 < t2; t2 < t1 }",
            "the times of t1 and t2 contradict each other",
            "widen",
        ),
        (
            "chronicle N {" + "\n event(speed[?x], t);" * 17 + "}",
            "at most 16 are evaluated",
            "divide it",
        ),
        (
            "\nchronicle N { event(speed[?x], t);" + "hold(speed[?x]:3, (t, t));" * 24 + "}",
            "asks 48 things",
            "divide it",
        ),
        (
            "chronicle N(\n?x in Car, ?y in Taxi) { event(speed[?x], t); event(speed[?y], t); }",
            "no stream tells which `?y` is dyknow:Taxi",
            "one sort",
        ),
        (
            "chronicle N {\n?x in Car; event(speed[?x], t); noevent(speed[?], (t - 1s, t)); }",
            "no stream tells which `?x` is dyknow:Car",
            "one sort",
        ),
    ],
)
def test_what_is_refused(text: str, message: str, hint: str) -> None:
    with pytest.raises(LanguageError) as caught:
        query(text)
    assert message in caught.value.message
    assert hint in caught.value.hint
    assert caught.value.line == (18 if "17" in message or "16" in message else 2)


# -- templates -------------------------------------------------------------------------------

TEMPLATE = """REGISTER TEMPLATE Overtaken(?a in Car, ?limit, ?lane) AS chronicle N(?b, ?a) {
  event(beside[?a, ?b], t1); event(speed[?a]:(?, > ?limit [m.s-1]), t1);
  event(lane[?b]:(?, ?lane), t1);
}"""


def test_a_template_with_the_arguments_of_a_request() -> None:
    template = check_chronicle_template(parse_chronicle_template(TEMPLATE), VOCABULARY)
    read = chronicle_sources(template.chronicle, TEMPLATE, VOCABULARY)
    assert [each.arguments[0].sort for each in read] == [
        DYKNOW + "Car",
        DYKNOW + "Car",
        DYKNOW + "Thing",
    ]
    values = {"limit": Constant(10.0, Kind.NUMBER), "lane": Constant("left", Kind.TEXT)}
    lines = """
0 beside a b true
0 beside c b true
0 speed a 37
0 speed c 50
0 lane b left
1 beside a b true
1 speed a 35
1 lane b left
2 beside a b true
2 speed a 40
2 lane b right
"""
    every = with_arguments(template.chronicle, values, {})
    assert found(chronicle_query(every, TEMPLATE, VOCABULARY), lines) == [(0, 0, "b", "a")]
    one = with_arguments(template.chronicle, values, {"a": DYKNOW + "c"})
    compiled = chronicle_query(one, TEMPLATE, VOCABULARY)
    assert compiled.sources[0].arguments[0] == Argument(DYKNOW + "Car", DYKNOW + "c")
    assert found(compiled, lines) == [(0, 0, "b", "c")]
