"""Values and aggregates that once came out wrong."""

from __future__ import annotations

import pytest
from pyoxigraph import Literal, NamedNode

from dyknow.continuous.evaluate import evaluate
from dyknow.continuous.values.literals import canonical
from dyknow.rdf.namespaces import DYKNOW, XSD

X = "http://d.example/x"
ONE, SPEED, ALT = (NamedNode(DYKNOW + name) for name in ("uav1", "speed", "alt"))


def typed(text: str, name: str) -> Literal:
    return Literal(text, datatype=NamedNode(XSD + name))


def windows(body: str, *elements, static=()) -> list[list[dict[str, str]]]:
    head, where = body.split("WHERE", 1)
    text = (
        f"REGISTER QUERY q AS PREFIX d: <{DYKNOW}> PREFIX xsd: <{XSD}> {head} "
        f"FROM STREAM <{X}> [RANGE 10ns STEP 10ns] WHERE {where}"
    )
    found = evaluate(text, {X: list(elements)}, static)
    return [[{k: v.value for k, v in row.items()} for row in w.solutions] for w in found]


def test_one_aggregate_under_two_names() -> None:
    body = "SELECT (AVG(?v) AS ?a) (AVG(?v) AS ?b) (COUNT(*) AS ?n) WHERE { ?o d:speed ?v }"
    assert windows(body, (1, ONE, SPEED, Literal(4))) == [[{"a": "4", "b": "4", "n": "1"}]]


@pytest.mark.parametrize("function", ["COUNT", "SUM", "AVG", "MIN"])
@pytest.mark.parametrize("where", ["{ ?o d:speed ?v }", "{ ?o d:speed ?v OPTIONAL { ?o d:x ?y } }"])
def test_an_aggregate_over_nothing_gives_no_row(function: str, where: str) -> None:
    body = f"SELECT ?a WHERE {where} AGGREGATE {{ (?a, {function}, {{?v}}) }}"
    assert windows(body, (1, ONE, ALT, Literal(4))) == [[]]
    assert len(windows(body, (1, ONE, SPEED, Literal(4)))[0]) == 1


@pytest.mark.parametrize(
    ("given", "other"),
    [
        (typed("1e2", "double"), typed("100", "double")),
        (typed("1.0E300", "double"), typed("1e300", "double")),
        (typed("3.00", "decimal"), typed("3", "decimal")),
        (typed("007", "integer"), typed("7", "int")),
        (typed("1", "boolean"), typed("true", "boolean")),
    ],
)
def test_a_value_joins_however_it_is_spelled(given: Literal, other: Literal, tmp_path) -> None:
    """The static side comes out of a store in its spelling; a stream's terms did not."""
    assert canonical(given) == canonical(other)
    path = tmp_path / "static.nt"
    path.write_text(f"{ONE} {ALT} {other} .\n")
    text = canonical(given).value
    for more in ("", "OPTIONAL { ?o d:none ?n }"):
        body = f"SELECT ?v WHERE {{ ?o d:speed ?v . ?o d:alt ?v {more} }}"
        assert windows(body, (1, ONE, SPEED, given), static=[path]) == [[{"v": text}]]
    constant = f'SELECT ?o WHERE {{ ?o d:speed "{other.value}"^^<{other.datatype.value}> }}'
    assert len(windows(constant, (1, ONE, SPEED, given))[0]) == 1


@pytest.mark.parametrize("text", ["1_0", " 1", "١", ""])
def test_what_is_no_number_of_xsd_has_no_value(text: str) -> None:
    body = "SELECT (SUM(?v) AS ?n) WHERE { ?o d:speed ?v }"
    for name in ("integer", "double"):
        assert windows(body, (1, ONE, SPEED, typed(text, name))) == [[{}]]


def test_a_static_side_that_needs_oxigraph_needs_it_in_every_window(tmp_path) -> None:
    """The second window used to take the static side for empty."""
    path = tmp_path / "static.nt"
    path.write_text(f"{ONE} {SPEED} {Literal(3)} .\n")
    body = (
        "SELECT ?o (MIN(?v) AS ?n) WHERE { ?o d:speed ?v "
        "FILTER (?o != '2020-01-01T00:00:00Z'^^xsd:dateTime) } GROUP BY ?o"
    )
    found = windows(body, (1, ONE, ALT, Literal(1)), (11, ONE, ALT, Literal(1)), static=[path])
    assert found == [[{"o": ONE.value, "n": "3"}]] * 2


def test_negative_zero_among_other_kinds_keeps_its_sign() -> None:
    """Objects of several kinds become terms, and 0 and -0 are two of them."""
    values = [Literal(0.0), Literal(-0.0), Literal("x")]
    subjects = [NamedNode(f"{DYKNOW}o{i}") for i in range(len(values))]
    elements = [(1, subject, SPEED, value) for subject, value in zip(subjects, values, strict=True)]
    elements += [(1, subject, ALT, Literal(1)) for subject in subjects]
    (rows,) = windows("SELECT ?v WHERE { ?o d:speed ?v . ?o d:alt ?h }", *elements)
    assert sorted(row["v"] for row in rows) == ["-0", "0", "x"]
