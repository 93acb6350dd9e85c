"""Random continuous queries against a fresh Oxigraph store a window.

`differential_drawing` draws a case from a seed, `differential_oracle` says what each of its windows
must give, from SPEC and SPARQL 1.1 alone. ``DYKNOW_QUERY_WINDOWS`` (10,000) is how many windows
are compared, ``DYKNOW_QUERY_SEED`` (0) where the seeds begin; ``make soak`` compares 200,000 of new
seeds. A failure prints the seed, for `draw`, and the case made small.

**Listed differences** (`LISTED`) are explained, each with a narrow condition and a case that has
it: the test of the table fails when an entry applies no more.
**Corrections** (`CORRECTED`) are what Oxigraph has wrong; there the oracle's text goes another way.
"""

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path as FilePath

import pytest
from differential_cases import BASE, HUGE, SECOND, Case, Element, WindowOf, typed
from differential_drawing import draw
from differential_oracle import (
    Answer,
    Difference,
    differences,
    expected_answer,
    oracle_of,
    oracle_text,
    product_answer,
    text_of,
)  # fmt: skip
from differential_queries import (
    Aggregate,
    Ask,
    Bind,
    Call,
    Construct,
    Exists,
    Expression,
    Filter,
    Group,
    InWindow,
    Minus,
    Optional,
    Path,
    Select,
    Term,
    Triple,
    Union,
    Values,
    parts_of,
)  # fmt: skip
from differential_shrinking import shrink
from pyoxigraph import Literal, NamedNode, RdfFormat, Store
from standard_values import XSD
from standard_values import Term as RdfTerm

WINDOWS = int(os.environ.get("DYKNOW_QUERY_WINDOWS", "10000"))
FIRST = int(os.environ.get("DYKNOW_QUERY_SEED", "0"))
PARTS = 16


@pytest.mark.parametrize("part", range(PARTS))
def test_windows_are_as_a_fresh_store_says(part: int, tmp_path: FilePath) -> None:
    compared, seed = 0, FIRST + part * 1_000_000
    while compared < WINDOWS / PARTS:
        case = draw(seed)
        expected = expected_answer(case)
        compared += len(expected.windows)
        failure = first_failure(case, expected, tmp_path)
        if failure is not None:
            pytest.fail(described(seed, case, failure, tmp_path))
        seed += 1


def first_failure(case: Case, expected: Answer, folder: FilePath) -> Difference | None:
    """The first difference that is not listed."""
    return next((d for d in all_of(case, expected, folder) if not listed(case, d)), None)


def all_of(case: Case, expected: Answer, folder: FilePath) -> Iterator[Difference]:
    """The differences; that the product raises over a right text is one, too."""
    try:
        found = product_answer(case, folder)
    except Exception as error:  # noqa: BLE001
        yield Difference(None, "an answer", f"{type(error).__name__}: {error}")
    else:
        yield from differences(case, expected, found)


def listed(case: Case, difference: Difference) -> bool:
    return any(entry.applies(case, difference) for entry in LISTED)


def described(seed: int, case: Case, failure: Difference, folder: FilePath) -> str:
    def fails(smaller: Case) -> bool:
        try:
            found = first_failure(smaller, expected_answer(smaller), folder)
        except SyntaxError:
            return False  # what was taken away was needed
        return found is not None and found.kind == failure.kind

    small = shrink(case, fails)
    return "\n".join(
        [
            f"seed {seed}: {first_failure(small, expected_answer(small), folder)}",
            text_of(small),
            f"oracle: {oracle_text(small, oracle_of(small))}",
            *(f"static: {' '.join(map(str, triple))}" for triple in small.static),
            *(
                f"s{e.stream} {e.time}: {e.subject} {e.predicate} {e.object}"
                for e in small.elements
            ),
            f"{small.bounds} semantics={small.semantics or None} origin={small.origin} "
            f"lateness={small.lateness}",
        ]
    )


# What is listed.


@dataclass(frozen=True)
class Listed:
    """A difference that is explained: when it applies, and a case that has it."""

    reason: str
    applies: Callable[[Case, Difference], bool]
    example: Case

    def __str__(self) -> str:
        return self.reason


def example(
    select: tuple[tuple[str, Expression | None], ...], *where: object, values: list[Literal]
) -> Case:
    """One window with ``:a :p`` each of the values; ``where`` follows ``?a :p ?v``."""
    subject, predicate = NamedNode(BASE + "a"), NamedNode(BASE + "p")
    pattern = Triple("?a", Path(":p"), "?v")
    return Case(
        query=Select(False, select, Group((pattern, *where))),  # type: ignore[arg-type]
        windows=(WindowOf("", 0, SECOND, SECOND),),
        elements=tuple(Element(0, SECOND, subject, predicate, value) for value in values),
    )


def has_floats(case: Case, difference: Difference) -> bool:
    """A term of the query or of the data is an xsd:float."""
    texts = [part for part in parts_of(case.query) if isinstance(part, str)]
    texts += [str(element.object) for element in case.elements]
    texts += [str(value) for _, _, value in case.static]
    return any(text.endswith(f"{XSD}float>") for text in texts)


V = Term("?v")
LISTED: tuple[Listed, ...] = (
    Listed(
        "docs/explanation/semantics.md, Values: xsd:float is computed in double precision",
        has_floats,
        example(
            (("?v", None),),
            Filter(Call("=", (V, Term(str(typed("integer", "16777217")[0]))))),
            values=typed("float", "16777216"),
        ),
    ),
)


@pytest.mark.parametrize("entry", LISTED, ids=str)
def test_a_listed_difference_is_still_there(entry: Listed, tmp_path: FilePath) -> None:
    there = list(all_of(entry.example, expected_answer(entry.example), tmp_path))
    assert there, "nothing differs any more: delete the entry"
    assert all(entry.applies(entry.example, difference) for difference in there)


# What Oxigraph has wrong.

PREFIX = f"PREFIX : <{BASE}> "


@dataclass(frozen=True)
class Corrected:
    """An ASK that Oxigraph answers wrongly over some triples: the standard's section, and why."""

    reason: str
    query: str
    right: bool
    data: str = ""

    def __str__(self) -> str:
        return self.reason


CORRECTED = (
    Corrected(
        "17.2.2: a text with a language is true unless empty", 'ASK { FILTER("a"@en) }', True
    ),
    Corrected("17.3: false < true", "ASK { FILTER(false < true) }", True),
    Corrected("17.3: IRIs have no order, nor have equal ones", "ASK { FILTER(:a <= :a) }", False),
    Corrected("17.3: no order of texts with a language", 'ASK { FILTER("a"@en < "b"@en) }', False),
    Corrected("SPEC: integers are exact", "ASK { FILTER(9223372036854775807 + 1 > 0) }", True),
    Corrected("XPath F&O 6.2.4: 0 / -1.5 is 0", "ASK { FILTER(0.0 / -1.5 = 0) }", True),
    Corrected(
        "18.5.1.2: COUNT leaves out what fails",
        "ASK { { SELECT (COUNT(1 + ?v) AS ?n) { VALUES ?v { 1 :a } } } FILTER(?n = 1) }",
        True,
    ),
    Corrected(
        "18.4: a path of no steps leads from each term to itself",
        "ASK { :z :p* ?x }",
        True,
        ":a :p :b .",
    ),
    Corrected(
        "18.4: alternatives of a path are a union",
        "ASK { { SELECT (COUNT(*) AS ?n) { ?a (:p|!:q) ?b } } FILTER(?n = 2) }",
        True,
        ":a :p :b .",
    ),
    Corrected(
        "18.6: EXISTS puts values in, so the sides of its MINUS share no variable",
        "ASK { ?a :p ?v FILTER EXISTS { ?a :p ?w MINUS { ?a :p ?b } } }",
        True,
        ":a :p 1 .",
    ),
)


@pytest.mark.parametrize("entry", CORRECTED, ids=str)
def test_a_correction_of_oxigraph_is_still_needed(entry: Corrected) -> None:
    store = Store()
    store.load(f"@prefix : <{BASE}> . {entry.data}".encode(), format=RdfFormat.TURTLE)
    assert bool(store.query(PREFIX + entry.query)) is not entry.right, "Oxigraph has it right now"


# The drawing.


def test_the_drawing_has_all_of_the_grammar() -> None:
    cases = [draw(seed) for seed in range(400)]
    parts = [part for case in cases for part in parts_of(case.query)]
    kinds = {type(part) for part in parts}
    assert kinds >= {
        Aggregate, Ask, Bind, Call, Construct, Exists, Filter, InWindow, Minus, Optional, Path,
        Select, Triple, Union, Values,
    }  # fmt: skip
    paths = {part.operator for part in parts if isinstance(part, Path)}
    assert paths >= set("/|^+*?!")
    calls = {part.name for part in parts if isinstance(part, Call)}
    assert calls >= {"&&", "||", "!", "IN", "IF", "COALESCE", "+", "/", "neg", "<", "=", "BOUND"}
    assert {case.operator for case in cases} == {"RSTREAM", "ISTREAM", "DSTREAM"}
    assert {case.bag for case in cases} == {True, False}
    assert {len(case.windows) for case in cases} == {1, 2}
    assert {part.having != () for part in parts if isinstance(part, Select)} == {True, False}
    objects: set[RdfTerm] = {element.object for case in cases for element in case.elements}
    assert objects >= set(HUGE)


def test_many_windows_have_rows() -> None:
    """Queries over which nothing is found would compare nothing."""
    windows = [
        rows for case in map(draw, range(120)) for rows in expected_answer(case).windows.values()
    ]
    assert sum(bool(rows) for rows in windows) > len(windows) / 5
