"""What a case must give: a fresh Oxigraph store a window, and windows from their definition.

Written from SPEC sections 1 and 5 and docs/explanation/semantics.md (Windows, Bag and set), without
the product's code. Over 400 lines: windows, a window's store and the comparison are one definition.
"""

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from operator import itemgetter
from pathlib import Path as FilePath
from typing import Any

from differential_cases import BASE, Case, Element, WindowOf
from differential_queries import DEFAULT, Aggregate, Ask, parts_of
from differential_texts import Oracle, Product
from pyoxigraph import (
    BlankNode,
    DefaultGraph,
    Literal,
    NamedNode,
    Quad,
    QueryBoolean,
    QueryTriples,
    Store,
)
from standard_values import ANY, Called, Term, boolean, number

import dyknow

PROLOGUE = f"PREFIX : <{BASE}> PREFIX rdf: <http://www.w3.org/1999/02/22-rdf-syntax-ns#> "
Key = tuple[Any, ...]
Row = tuple[tuple[str, Key], ...]
Rows = Counter[Row]


# The product's answer.


def text_of(case: Case) -> str:
    head, where, rest = Product().head_and_where(case.query)
    every = f" COMPUTE EVERY {case.every // 1_000_000}ms" if case.every else ""
    kind = "QUERY" if head.startswith(("SELECT", "ASK")) else "STREAM"
    name = f"{kind} q" if case.operator == "RSTREAM" else f"{case.operator} :q"
    clauses = " ".join(map(clause_of, case.windows))
    return f"{PROLOGUE}REGISTER {name}{every} AS {head} {clauses} WHERE {where}{rest}"


def clause_of(window: WindowOf) -> str:
    length, step = window.range // 1_000_000, window.step // 1_000_000
    size = f"[RANGE {length}ms STEP {step}ms]"
    if not window.name:
        return f"FROM STREAM :s{window.stream} {size}"
    return f"FROM NAMED WINDOW {window.name} ON :s{window.stream} {size}"


@dataclass(frozen=True)
class Answer:
    """The rows by the end of their window, and the elements dropped as late.

    ``open``: the windows of an expected answer whose rows the standard leaves open.
    """

    windows: Mapping[int, Rows]
    late: Counter[tuple[int, Term, Term, Term]]
    open: frozenset[int] = frozenset()


def product_answer(case: Case, folder: FilePath) -> Answer:
    streams: dict[str, list[tuple[int, Any, Any, Any]]] = {
        f"{BASE}s{window.stream}": [] for window in case.windows
    }
    for element in case.elements:
        timed = (element.time, element.subject, element.predicate, element.object)
        streams[f"{BASE}s{element.stream}"].append(timed)
    static = []
    if case.static:
        file = folder / "static.nt"
        file.write_text("".join(f"{s} {p} {o} .\n" for s, p, o in case.static))
        static.append(file)
    late: list[Any] = []
    given: dict[str, Any] = dict(streams)
    if case.lateness is not None:
        given = {iri: iter(elements) for iri, elements in streams.items()}
    found = dyknow.evaluate(
        text_of(case),
        streams=given,
        static=static,
        semantics=case.semantics or None,
        bounds=case.bounds,
        origin=case.origin or None,
        lateness=case.lateness,
        report=case.report,
        late=late.append,
    )
    windows = {window.end: rows_of(window.solutions) for window in found}
    return Answer(windows, Counter(map(tuple, late)))


def rows_of(solutions: Any) -> Rows:
    if isinstance(solutions, bool):
        return Counter([()] if solutions else [])
    rows: Rows = Counter()
    for solution in solutions:
        if isinstance(solution, dict):
            bound = {name: term for name, term in solution.items() if term is not None}
        else:
            bound = dict(zip("spo", solution, strict=True))
        rows[row_of(bound)] += 1
    return rows


def row_of(bound: Mapping[str, Term]) -> Row:
    return tuple(sorted((name, key_of(term)) for name, term in bound.items()))


def key_of(term: Term) -> Key:
    """A term as its value: numbers by datatype and value, parts of GROUP_CONCAT in any order."""
    if isinstance(term, NamedNode):
        return ("iri", term.value)
    if isinstance(term, BlankNode):
        return ("blank",)
    found = number(term)
    if found is not None:
        value = found.value
        return ("number", found.kind, "NaN" if value != value else value)
    text = ";".join(sorted(term.value.split(";"))) if ";" in term.value else term.value
    return ("literal", text, term.datatype.value, term.language or "")


OPEN = key_of(ANY)


# The expected answer.


Contents = dict[WindowOf, list[Element]]


def expected_answer(case: Case) -> Answer:
    kept, late = without_late(case)
    windows: dict[int, Rows] = {}
    unknown: set[int] = set()
    before: Rows = Counter()
    open_before = False
    oracle = oracle_of(case)
    text = oracle_text(case, oracle)
    for end, contents in evaluations(case, kept):
        rows, is_open = solutions(case, oracle, text, contents)
        if case.operator == "RSTREAM":
            windows[end] = rows
        else:
            windows[end] = rows - before if case.operator == "ISTREAM" else before - rows
            is_open, open_before = is_open or open_before, is_open
            before = rows
        if is_open:
            unknown.add(end)
    return Answer(windows, late, frozenset(unknown))


def evaluations(case: Case, elements: list[Element]) -> Iterator[tuple[int, Contents]]:
    """The ends at which the query gives a result (docs/explanation/semantics.md, Report), and the
    contents.

    They begin with the first content. When the last has left, that is one more change, and one
    more evaluation for ISTREAM and DSTREAM.
    """
    found = [
        (end, {window: content(case, window, elements, end) for window in case.windows})
        for end in ends(case, elements)
    ]
    filled = [place for place, (_, contents) in enumerate(found) if any(contents.values())]
    if not filled:
        return
    first, last = filled[0], filled[-1]
    for place in range(first, last + 2):
        end, contents = found[place]
        silent = case.report == "non-empty" or (case.report == "close" and place > last)
        if case.operator == "RSTREAM" and silent and not any(contents.values()):
            continue
        if case.report == "change" and place > first and contents == found[place - 1][1]:
            continue
        yield end, contents


def without_late(case: Case) -> tuple[list[Element], Counter[tuple[int, Term, Term, Term]]]:
    """An element more than the lateness behind the greatest time of its stream is dropped."""
    if case.lateness is None:
        return list(case.elements), Counter()
    greatest: dict[int, int] = {}
    kept: list[Element] = []
    late: Counter[tuple[int, Term, Term, Term]] = Counter()
    for element in case.elements:
        newest = greatest.get(element.stream, element.time)
        if element.time < newest - case.lateness:
            late[element.time, element.subject, element.predicate, element.object] += 1
        else:
            kept.append(element)
        greatest[element.stream] = max(newest, element.time)
    return kept, late


def ends(case: Case, elements: list[Element]) -> Iterable[int]:
    """Multiples of the period around all elements, an empty one at each side."""
    if not elements:
        return ()
    period = max(case.every, min(window.step for window in case.windows))
    times = [element.time for element in elements]
    longest = max(window.range + window.step for window in case.windows)
    first = (min(times) - case.origin) // period - 1
    last = (max(times) + longest - case.origin) // period + 2
    return (case.origin + place * period for place in range(first, last))


def content(case: Case, window: WindowOf, elements: list[Element], now: int) -> list[Element]:
    """The elements in the latest scope of the window that has ended by now."""
    end = case.origin + (now - case.origin) // window.step * window.step
    start = end - window.range
    mine = (element for element in elements if element.stream == window.stream)
    if case.bounds == "(]":
        return [element for element in mine if start < element.time <= end]
    return [element for element in mine if start <= element.time < end]


def solutions(case: Case, oracle: Oracle, text: str, contents: Contents) -> tuple[Rows, bool]:
    """What Oxigraph says of the windows' content, and if the standard leaves it open."""
    store = Store()
    store.extend(timed_quads(case, contents) if case.timed else quads(case, contents))

    def exists(place: int, *values: Term) -> Literal:
        found = store.query(
            PROLOGUE + oracle.asked(place, values), custom_functions=called.functions
        )
        return boolean(bool(found))

    inner = {f"exists {place}": partial(exists, place) for place in range(len(oracle.inner))}
    called = Called(inner)
    found = store.query(
        text, custom_functions=called.functions, custom_aggregate_functions=called.aggregates
    )
    if isinstance(found, QueryBoolean):
        rows = rows_of(bool(found))
    elif isinstance(found, QueryTriples):
        # A graph: equal triples once.
        rows = Counter(set(rows_of(tuple(triple) for triple in found)))
    else:
        names = [variable.value for variable in found.variables]
        rows = rows_of(dict(zip(names, solution, strict=True)) for solution in found)
    # Whether a row with an open term was there before is open, too.
    is_open = case.operator != "RSTREAM" and any(key == OPEN for row in rows for _, key in row)
    return rows, is_open or called.is_open


def graph(name: str) -> NamedNode:
    return NamedNode(BASE + name.removeprefix(":"))


def copy_name(name: str, place: int) -> NamedNode:
    return NamedNode(f"urn:copy:{name}:{place}")


def oracle_of(case: Case) -> Oracle:
    copies: dict[str, tuple[str, ...]] = {}
    if case.bag:
        most = range(most_copies(case))
        names = ["", *(window.name for window in case.windows)]
        copies = {name: tuple(str(copy_name(name, place)) for place in most) for name in names}
    windows = tuple(window.name for window in case.windows if window.name)
    return Oracle(copies, windows, case.exact, timed=case.timed)


def oracle_text(case: Case, oracle: Oracle) -> str:
    head, where, rest = oracle.head_and_where(case.query)
    return PROLOGUE + (
        f"ASK {where}" if isinstance(case.query, Ask) else f"{head} WHERE {where}{rest}"
    )


def most_copies(case: Case) -> int:
    triples = Counter((e.subject, e.predicate, e.object) for e in case.elements)
    triples.update(case.static)
    return max(triples.values(), default=1)


def quads(case: Case, contents: Contents) -> Iterator[Quad]:
    seen: defaultdict[tuple[str, Term, Term, Term], int] = defaultdict(int)
    elements = [("", *triple) for triple in case.static]
    for window, content in contents.items():
        elements += [(window.name, e.subject, e.predicate, e.object) for e in content]
    for name, subject, predicate, value in elements:
        triple = (subject, predicate, value)
        yield Quad(*triple, graph(name) if name else DefaultGraph())
        if case.bag:
            place = seen[name, *triple]
            seen[name, *triple] += 1
            yield Quad(*triple, copy_name(name, place))


def timed_quads(case: Case, contents: Contents) -> Iterator[Quad]:
    """Each element in a graph of its own; under set semantics the latest of equal ones."""
    elements = [("", triple, -1) for triple in case.static]
    for window, content in contents.items():
        elements += [(window.name, (e.subject, e.predicate, e.object), e.time) for e in content]
    elements.sort(key=itemgetter(2))
    if not case.bag:
        latest = {(name, triple): time for name, triple, time in elements}
        elements = [(name, triple, time) for (name, triple), time in latest.items()]
    for place, (name, triple, time) in enumerate(elements):
        yield Quad(
            *triple, NamedNode(f"urn:time:{name or DEFAULT}:{place}:{'' if time < 0 else time}")
        )


# The comparison.


@dataclass(frozen=True)
class Difference:
    """``end``: of the window, or none where the late elements differ."""

    end: int | None
    expected: str
    found: str

    @property
    def kind(self) -> str:
        """What stays the same while a case is made small: the error that was raised, if any."""
        return self.found.partition(":")[0] if self.end is None else "rows"

    def __str__(self) -> str:
        place = "late" if self.end is None else f"window {self.end}"
        return f"{place}: expected {self.expected}, got {self.found}"


def differences(case: Case, expected: Answer, found: Answer) -> Iterator[Difference]:
    """The windows that differ, but for rows that the standard leaves open."""
    if expected.late != found.late:
        yield Difference(None, str(expected.late), str(found.late))
    any_kind = has_extreme(case) and not case.exact
    for end in sorted(set(expected.windows) | set(found.windows)):
        given, wanted = found.windows.get(end), expected.windows.get(end)
        if case.operator == "RSTREAM" and (given is None or wanted is None):
            same = False
        else:
            same = end in expected.open or alike(wanted or Counter(), given or Counter(), any_kind)
        if not same:
            yield Difference(end, show(wanted), show(given))


def has_extreme(case: Case) -> bool:
    """Oxigraph's own MIN and MAX of equal numbers of two datatypes give either; `standard_values`,
    which are asked where a case is exact, give the first kind, as the product does."""
    return any(
        isinstance(part, Aggregate) and part.name in ("MIN", "MAX") for part in parts_of(case.query)
    )


def show(rows: Rows | None) -> str:
    if rows is None:
        return "no window"
    return "; ".join(sorted(f"{count} x {dict(row)}" for row, count in rows.items())) or "no rows"


def alike(wanted: Rows, given: Rows, any_kind: bool) -> bool:
    if wanted == given:
        return True
    missing, extra = list((wanted - given).elements()), list((given - wanted).elements())
    if len(missing) != len(extra):
        return False
    for row in missing:
        partner = next((other for other in extra if same_row(row, other, any_kind)), None)
        if partner is None:
            return False
        extra.remove(partner)
    return True


def same_row(row: Row, other: Row, any_kind: bool) -> bool:
    wanted, given = dict(row), dict(other)
    return wanted.keys() == given.keys() and all(
        same_key(wanted[name], given[name], any_kind) for name in wanted
    )


def same_key(wanted: Key, given: Key, any_kind: bool) -> bool:
    """Equal, up to rounding of what cannot be exact; ``any_kind``: numbers of two datatypes, too.
    `ANY` is like every term."""
    if wanted in (given, OPEN):
        return True
    if wanted[0] != "number" or given[0] != "number" or "NaN" in (wanted[2], given[2]):
        return False
    if wanted[1] != given[1] and not any_kind:
        return False
    if any(isinstance(key[2], float) and math.isinf(key[2]) for key in (wanted, given)):
        return bool(wanted[2] == given[2])
    relative = max(ROUNDING[wanted[1]], ROUNDING[given[1]])
    a, b = Fraction(wanted[2]), Fraction(given[2])
    places = Fraction(1, 10**17) if wanted[1] == "decimal" else 0
    return abs(a - b) <= max(max(abs(a), abs(b)) * relative, places)


# How far a number may be from the exact one: quotients (cut by the oracle behind the 18th place),
# xsd:float in double precision, sums.
ROUNDING = {
    "integer": Fraction(0),
    "decimal": Fraction(1, 10**14),
    "float": Fraction(1, 10**6),
    "double": Fraction(1, 10**12),
}
