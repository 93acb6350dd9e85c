"""Texts of chronicles: what they say, what is refused, and at no cost beyond their length."""

from __future__ import annotations

import pytest
from ending_soon import ends_within

from dyknow.languages.chronicle import (
    ast,
    is_chronicle,
    parse_chronicle,
    parse_chronicle_template,
)
from dyknow.languages.chronicle.parser import MOST_CLAUSES
from dyknow.languages.errors import LanguageError
from dyknow.languages.mtl import is_formula_template, is_monitor

S = 10**9


def distance(text: str) -> tuple[str, str, float | None, float | None]:
    """The distance that a clause says, in seconds; the bound of ``<`` is 1 ns off."""
    clause = parse_chronicle(f"chronicle N {{ {text} }}").clauses[0]
    assert isinstance(clause, ast.Distance)
    bounds = (None if x is None else x / S for x in (clause.least, clause.most))
    return clause.first.name, clause.second.name, *bounds


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("t2 - t1 in [0s, 8s]", ("t1", "t2", 0, 8)),
        ("t2 - t1 in [-1 minute, 500 ms];", ("t1", "t2", -60, 0.5)),
        ('t2 - t1 in [-oo, "PT1M"^^xsd:duration];', ("t1", "t2", None, 60)),
        ("t2 - t1 <= 5s", ("t1", "t2", None, 5)),
        ("t2 - t1 > 5s", ("t1", "t2", 5 + 1e-9, None)),
        ("t2 - t1 = 0", ("t1", "t2", 0, 0)),
        ("t1 < t2", ("t1", "t2", 1e-9, None)),
        ("t1 >= t2", ("t2", "t1", 0, None)),
        ("t1 = t2 + 3s", ("t1", "t2", -3, -3)),
        ("t1 + 3s <= t2 - 1s", ("t1", "t2", 4, None)),
        ("t1 - 3s > t2 + 1s", ("t2", "t1", 4 + 1e-9, None)),
    ],
)
def test_times(text: str, expected: tuple[str, str, float | None, float | None]) -> None:
    assert distance(text) == expected


@pytest.mark.parametrize(
    ("clause", "message", "hint"),
    [
        ("t1 != t2", "times that differ", "`<` or `>`"),
        ("t1 + t2 < 5s", "times are not added", "`t1 - t2`"),
        ("t2 - t1 < 5", "`5` has no unit", "`5s`"),
        ("t2 - t1 < 5 parsecs", "not allowed here", "expected"),
        ("t2 - t1 < 5y", "`5y` is not a duration", "ns, us"),
        ("t2 - t1 < 40000d", "exceeds 36 years", "oo"),
        ("t2 - t1 < oo", "`oo` is no duration", "leave the clause out"),
        ("t2 - t1 in [5s, 3s]", "ends before it begins", "smaller bound"),
        ("t2 - t1 in [oo, oo]", "ends before it begins", "smaller bound"),
        ("t1 < t2 < t3", "`<` is not allowed", "write two clauses"),
        ("event(P[?x]:true, t1)", "a single value is a state", "`(?, true)`"),
        ("noevent(P[?x]:> 3, (t1, t2))", "a single value is a state", "`(?, > 3)`"),
        ("hold(P[?x], (t1, t2))", "needs a value", "`hold(stopped[?x]:true"),
        ("hold(P[?x]:(1, 2), (t1, t2))", "needs a value", "`hold(stopped[?x]:true"),
        ("occurs((3, 2), P[?x], (t1, t2))", "smaller than the least", "`(2, 3)`"),
        ("occurs((1.5, 2), P[?x], (t1, t2))", "no number of times", "`(1, oo)`"),
        ("occurs((oo, 2), P[?x], (t1, t2))", "`oo` is not allowed", "a number"),
        ("event(P[?x]:(?, 1e999), t1)", "exceeds a double", "1.7e308"),
        ("event(P[?x]:(?, 3 [m/s]), t1)", "`/` is not allowed", "`m.s-1`"),
        ("evnt(P[?x], t1)", "`(` is not allowed", "expected"),
        ("?x == ?y", "`=` is not allowed", ""),
        ("event(P[?x], t1) event(P[?x], t2)", "`event` is not allowed", "`;`"),
        ("event(P[?x], 2021-10-07T19:12:53Z)", "not allowed here", "a name"),
        ("?x < 2021-99-07T19:12:53Z", "month must be", ""),
        (", ", "`,` is not allowed", "a clause is `event(…)`"),
    ],
)
def test_what_is_refused(clause: str, message: str, hint: str) -> None:
    with pytest.raises(LanguageError) as caught:
        parse_chronicle(f"chronicle N(?x) {{\n  {clause} }}")
    error = caught.value
    assert message in error.message
    assert hint in error.hint
    assert (error.line, error.column > 2) == (2, True)


@pytest.mark.parametrize(
    "emitted", ["M[?x, ?y]", "N", "N[?y, ?x]", "N[?x, ?y]:(?, 1)", "N[?x, ?y]:true"]
)
def test_a_chronicle_emits_its_own_event(emitted: str) -> None:
    text = f"chronicle N(?x, ?y) {{ when recognized {{ emit event({emitted}, t) }} }}"
    with pytest.raises(LanguageError, match=r"its own event") as caught:
        parse_chronicle(text)
    assert caught.value.hint == "write `emit event(N[?x, ?y], t)`"
    right = text.replace(f"event({emitted}", "event(N[?x, ?y]")
    emitted_at = parse_chronicle(right).emitted
    assert emitted_at is not None
    assert emitted_at.name == "t"


def test_prefixes_may_stand_before_register_and_after_as() -> None:
    text = (
        "PREFIX : <http://a.org/> REGISTER STREAM s AS prefix e: <http://e.org/>\n"
        "chronicle N { event(e:E[:x, dyknow:uav1], t) }"
    )
    with pytest.raises(LanguageError, match=r"`:` is not allowed"):
        parse_chronicle(text)
    found = parse_chronicle(text.replace(":x", "e:x"))
    message = found.clauses[0].message
    assert message.concept.text == "<http://e.org/E>"
    assert [each.text for each in message.arguments] == ["<http://e.org/x>", "dyknow:uav1"]
    assert found.stream == "s"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("chronicle N { }", True),
        ("# a\n// b\nchronicle", True),
        ("PREFIX a: <b> prefix : <c>\nchronicle N(", True),
        ("register stream s as chronicle N", True),
        ("PREFIX a: <b> REGISTER STREAM s AS PREFIX c: <d> # e\n chronicle N", True),
        ("REGISTER TEMPLATE dyknow:R(?x in Car, ?d) AS chronicle N(?x) {", True),
        ("REGISTER TEMPLATE R(?x) AS chronicles(?x) > 3", False),
        ("REGISTER TEMPLATE R(?x) AS chronicle:x > 3", False),
        ("REGISTER STREAM s COMPUTE EVERY 1s AS SELECT", False),
        ("REGISTER STREAM s AS PATTERN SEQ(A a)", False),
        ("monitor chronicle = p", False),
        ("PREFIX chronicle: <b> SELECT", False),
        ("", False),
        # A text matches in one way: otherwise these would not end.
        ("#" * 40_000 + "\nx", False),
        ("PREFIX a: <x> " * 3_000, False),
        ("register template R(?x) as" + "\n#" * 20_000 + "a" * 20_000, False),
        ("register template " + "(" * 40_000, False),
        ("register stream " + " " * 40_000, False),
    ],
)
def test_the_first_words_tell_the_language(text: str, expected: bool) -> None:
    with ends_within(200):
        assert is_chronicle(text) is expected
    assert not (expected and (is_monitor(text) or is_formula_template(text)))


def test_a_template_has_each_parameter_once() -> None:
    text = "REGISTER TEMPLATE R(?x, ?x) AS chronicle N(?x) { event(E[?x], t) }"
    with pytest.raises(LanguageError, match=r"`\?x` is a parameter twice"):
        parse_chronicle_template(text)


@pytest.mark.parametrize(
    "text",
    [
        "chronicle N {" + "event(a[?x],t);" * 2_700 + "}",
        "chronicle N {" + "event(a[" * 5_000,
        "chronicle N(" + "?x," * 13_000,
        "chronicle N {event(a[" + "?," * 19_000 + "?],t)}",
        "chronicle N { t1 - " + "t" * 40_000 + " < 3s; }",
        "chronicle N { t1 < t2 + " + "9" * 40_000 + "s}",
        "chronicle N {event(a[?x]:(?," + "9" * 40_000 + "),t)}",
        "chronicle N {occurs((" + "9" * 40_000 + ", oo), a[?x], (t1, t2))}",
        "chronicle N {event(a[?x]:(?,3 [m" + "9" * 40_000 + "]),t)}",
        'chronicle N {event(a["' + "\\" * 40_000,
        "chronicle N {" + "(" * 40_000,
        "PREFIX a: <" * 4_000,
    ],
)
def test_hostile_texts_cost_little(text: str) -> None:
    with ends_within(600), pytest.raises(LanguageError):
        parse_chronicle(text)


def test_there_is_a_greatest_number_of_clauses() -> None:
    assert len(parse_chronicle("chronicle N {" + "t1 < t2;" * MOST_CLAUSES + "}").clauses)
    with pytest.raises(LanguageError, match=r"at most 256 clauses"):
        parse_chronicle("chronicle N {" + "t1 < t2;" * (MOST_CLAUSES + 1) + "}")
