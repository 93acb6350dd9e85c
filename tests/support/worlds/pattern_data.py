"""Events of five kinds at one a second, and the plans whose matches over them are known.

The counts of matches are those of Esper 9 and of SASE's engine over the same events.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dyknow.reasoning.patterns.plans.plan import (
    OWN,
    Between,
    Bound,
    Column,
    ColumnType,
    Condition,
    CountProbe,
    Element,
    Output,
    PatternPlan,
    Point,
    Same,
    Selection,
    Trend,
    Value,
)
from dyknow.reasoning.patterns.plans.rows import Rows

S = 10**9
KINDS = ("A", "B", "C", "D", "E")
WITHIN = 1000 * S
COLUMNS = (
    Column("x", ColumnType.KEY),
    Column("y", ColumnType.KEY),
    Column("v", ColumnType.NUMBER),
)
ANY_MATCHES = {10: 4_002_582, 100: 39_655, 10_000: 1}
"""Matches of SEQ(A, B, C) over 100,000 events, by the number of keys."""
NEXT_MATCHES = {10: 20_086, 100: 11_786, 10_000: 1}
"""The same under skip_till_next_match."""
WITHOUT_D = 17_155
"""Matches of SEQ(A, ~D, C) over 100,000 events of 100 keys."""


def data(count: int, keys: int, seed: int = 1) -> Rows:
    """Draw events: kinds, keys and values are uniform."""
    draw = np.random.default_rng(seed)
    times = np.arange(count, dtype=np.int64) * S
    kind = draw.integers(0, len(KINDS), count)
    x, y = draw.integers(0, keys, (2, count))
    (v,) = draw.random((1, count)) * 100
    return Rows(KINDS, kind, times, times, {"x": x, "y": y, "v": v})


def batches(rows: Rows, size: int) -> Iterator[Rows]:
    """Cut rows into batches."""
    for start in range(0, len(rows), size):
        yield rows[start : start + size]


def sequence(
    text: str,
    *,
    within: int = WITHIN,
    conditions: tuple[Condition, ...] = (),
    selection: Selection = Selection.ANY_MATCH,
    outputs: tuple[Output, ...] = (),
    trends: tuple[Trend, ...] = (),
    max_matches: int | None = None,
) -> PatternPlan:
    """Plan ``SEQ(A, B+, ~D, C)``, written ``AB+~DC``, of events with one key x."""
    names: list[str] = []
    absent: list[tuple[int, str]] = []
    kleene: set[int] = set()
    for before, letter in zip(" " + text, text, strict=False):
        if before == "~":
            absent.append((len(names), letter))
        elif letter == "+":
            kleene.add(len(names) - 1)
        elif letter != "~":
            names.append(letter)
    last = len(names) - 1
    probes = []
    for place, kind in absent:
        low = Bound(Point(place - 1), 1) if place else Bound(Point(last), -within)
        high = Bound(Point(place), -1) if place <= last else Bound(Point(0), within)
        what = Element(f"not_{kind.lower()}", (kind,))
        probes.append(CountProbe(what, low, high, same=(Same(OWN, "x", 0, "x"),)))
    return PatternPlan(
        COLUMNS,
        tuple(
            Element(name.lower(), (name,), is_kleene=i in kleene) for i, name in enumerate(names)
        ),
        tuple(Between(Point(i), Point(i + 1, True), 1) for i in range(last)),
        tuple(Same(i, "x", i + 1, "x") for i in range(last)),
        conditions,
        tuple(probes),
        selection,
        within=within,
        outputs=outputs,
        trends=trends,
        partition=("x",) if selection is Selection.PARTITION_CONTIGUITY else (),
        max_matches=max_matches,
    )


def rising(count: int) -> tuple[Condition, ...]:
    """``a.v < b.v < c.v``."""
    return tuple(Condition("<", Value(i, "v"), Value(i + 1, "v")) for i in range(count - 1))


def chronicle(*, has_probes: bool = False) -> PatternPlan:
    """Plan five events and six constraints on their times, with two objects; with probes also one
    ``noevent`` and one ``occurs``."""
    bounds = [(0, 1, 0, 300), (1, 2, 0, 300), (2, 3, -100, 300)]
    bounds += [(2, 4, 0, 400), (0, 4, 10, 900), (3, 4, -200, 200)]
    probes = (
        CountProbe(
            Element("noevent", ("B",)),
            Bound(Point(1), 1),
            Bound(Point(2), -1),
            same=(Same(OWN, "x", 0, "x"),),
        ),
        CountProbe(
            Element("occurs", ("D",)),
            Bound(Point(0), 1),
            Bound(Point(1), -1),
            0,
            5,
            same=(Same(OWN, "x", 0, "x"),),
        ),
    )
    return PatternPlan(
        COLUMNS,
        tuple(Element(f"t{i + 1}", (kind,)) for i, kind in enumerate(KINDS)),
        tuple(Between(Point(i), Point(j), low * S, high * S) for i, j, low, high in bounds),
        (
            *(Same(0, "x", i, "x") for i in (1, 2, 3)),
            Same(0, "y", 2, "y"),
            Same(0, "y", 4, "x"),
        ),
        probes=probes if has_probes else (),
    )
