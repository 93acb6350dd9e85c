"""How fast the matches of a pattern are found: events a second of processor time.

    python bench/reasoning/patterns.py [TEXT …]

Only rows whose name has one of the texts are run. Events of five kinds come one a second
(tests/support/worlds/pattern_data.py), in batches of 1,000 unless a row says otherwise; the rows of
matches are written, decoding is not included. Each row takes the least of three runs; where there
is a program written by hand for the one pattern, the last column has the ratio to it.
"""

from __future__ import annotations

import sys
import time
from collections import defaultdict, deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "tests" / "support" / "worlds")]

from pattern_data import KINDS, WITHIN, S, batches, chronicle, data, rising, sequence  # noqa: E402

from dyknow.reasoning.patterns.evaluation.all_rows import AllRows  # noqa: E402
from dyknow.reasoning.patterns.plans.plan import (  # noqa: E402
    Aggregate,
    Condition,
    Function,
    Output,
    PatternPlan,
    Position,
    Selection,
    Trend,
    Value,
)
from dyknow.reasoning.patterns.plans.rows import Rows  # noqa: E402
from dyknow.reasoning.patterns.recognition.choice import evaluator_of  # noqa: E402
from dyknow.streams import jit  # noqa: E402

jit.PATIENCE = 0.0  # loops are compiled from the first call on

RUNS = 3


@dataclass(frozen=True)
class Case:
    """A line of the table."""

    name: str
    plan: PatternPlan
    keys: int
    events: int = 100_000
    batch: int = 1000
    is_ordered: bool = True
    by_hand: Callable[[Rows], int] | None = None


def by_python(rows: Rows) -> int:
    """SEQ(A, B, C) by deques of each key; it counts matches and writes none."""
    starts: dict[int, deque[int]] = defaultdict(deque)
    middles: dict[int, deque[tuple[int, list[int]]]] = defaultdict(deque)
    found = 0
    for end, kind, key in zip(
        rows.end.tolist(), rows.kind.tolist(), rows.columns["x"].tolist(), strict=True
    ):
        if kind == 0:
            starts[key].append(end)
        elif kind == 1:
            queue = starts[key]
            while queue and queue[0] < end - WITHIN:
                queue.popleft()
            middles[key].append((end, list(queue)))
        elif kind == 2:
            pairs = middles[key]
            while pairs and pairs[0][0] < end - WITHIN:
                pairs.popleft()
            for _, firsts in pairs:
                found += sum(first >= end - WITHIN for first in firsts)
    return found


def by_python_next(rows: Rows) -> int:
    """SEQ(A, B, C) of the next match by two lists of each key; it counts matches."""
    starts: dict[int, list[int]] = defaultdict(list)
    middles: dict[int, list[int]] = defaultdict(list)
    found = 0
    for end, kind, key in zip(
        rows.end.tolist(), rows.kind.tolist(), rows.columns["x"].tolist(), strict=True
    ):
        if kind == 0:
            starts[key].append(end)
        elif kind == 1:
            middles[key] += [first for first in starts.pop(key, []) if first >= end - WITHIN]
        elif kind == 2:
            found += sum(first >= end - WITHIN for first in middles.pop(key, []))
    return found


def by_numpy(rows: Rows) -> int:
    """SEQ(A, B, C) by searches over the whole recording, in order of key and time."""
    span = int(rows.end[-1]) + 2 * WITHIN + 2
    key = rows.columns["x"]
    code = key * span + rows.end
    a, b, c = (np.flatnonzero(rows.kind == kind) for kind in range(3))
    a, b = a[np.argsort(code[a], kind="stable")], b[np.argsort(code[b], kind="stable")]
    last, middle = _pairs(code[b], np.maximum(code[c] - WITHIN, key[c] * span), code[c])
    middles, lasts = b[middle], c[last]
    low = np.maximum(code[lasts] - WITHIN, key[lasts] * span)
    pair, first = _pairs(code[a], low, code[middles])
    return len(np.stack([a[first], middles[pair], lasts[pair]], axis=1))


def _pairs(codes: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The places of intervals and of the codes in each."""
    begin, end = np.searchsorted(codes, low), np.searchsorted(codes, high)
    counts = np.maximum(end - begin, 0)
    left = np.repeat(np.arange(len(counts)), counts)
    return left, np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts - begin, counts)


NEXT = sequence("ABC", selection=Selection.NEXT_MATCH)
KLEENE = sequence(
    "AB+C",
    selection=Selection.NEXT_MATCH,
    outputs=tuple(Output(f, Aggregate(f, 1, "v")) for f in (Function.SUM, Function.AVG)),
)
TOTALS = (Trend("n", Function.COUNT), Trend("s", Function.SUM, 1, "v"))
TRENDS = sequence("AB+C", trends=TOTALS[:1])
STEP = Condition(">", Value(1, "v"), Value(1, "v", Position.PREVIOUS))
CASES = (
    *(
        Case(f"any A;B;C, {keys:,} keys, to {name}", sequence("ABC"), keys, by_hand=by_hand)
        for keys in (10, 100, 10_000)
        for name, by_hand in (("Python by hand", by_python), ("numpy on all events", by_numpy))
    ),
    Case("any A;B;C, 100 keys, any order of arrival", sequence("ABC"), 100, is_ordered=False),
    Case("any A;B;C, a.v < b.v < c.v, 100 keys", sequence("ABC", conditions=rising(3)), 100),
    Case("any A;~D;C, 100 keys", sequence("A~DC"), 100),
    Case("any A;B;~D, waits, 100 keys", sequence("AB~D"), 100),
    Case("any ~D;A;B, 100 keys", sequence("~DAB"), 100),
    *(
        Case(f"chronicle, 5 events{more}, {keys} objects", chronicle(has_probes=probes), keys)
        for keys in (30, 100)
        for more, probes in (("", False), (" + noevent + occurs", True))
    ),
    *(
        Case(f"next A;B;C, {keys:,} keys, to Python by hand", NEXT, keys, by_hand=by_python_next)
        for keys in (10, 100, 10_000)
    ),
    Case("next A;B;C, a.v < b.v < c.v, 100 keys", replace(NEXT, conditions=rising(3)), 100),
    Case("next A;B+;C, sum and avg of b.v, 100 keys", KLEENE, 100),
    Case("next A;B+;C, b[i].v > b[i-1].v, 100 keys", replace(KLEENE, conditions=(STEP,)), 100),
    Case("next A;~D;C, 100 keys", sequence("A~DC", selection=Selection.NEXT_MATCH), 100),
    Case("next A;B;~D, waits, 100 keys", sequence("AB~D", selection=Selection.NEXT_MATCH), 100),
    *(
        Case(f"{selection} A;B;C, 100 keys", sequence("ABC", selection=selection), 100)
        for selection in (Selection.PARTITION_CONTIGUITY, Selection.STRICT_CONTIGUITY)
    ),
    Case("any A;B+;C, at most 10 a row, 100 keys", sequence("AB+C", max_matches=10), 100),
    *(
        Case(f"trends of A;B+;C, COUNT(*), {keys:,} keys", TRENDS, keys)
        for keys in (10, 100, 10_000)
    ),
    Case("trends of A;B+;C, COUNT(*), SUM, 10 keys", replace(TRENDS, trends=TOTALS), 10),
    Case("trends of A;B+;C, b[i].v > b[i-1].v, 10 keys", replace(TRENDS, conditions=(STEP,)), 10),
    Case(
        "trends of A;B+;C, COUNT(*), 10 keys, WITHIN 10,000 s",
        replace(TRENDS, within=10 * WITHIN),
        10,
    ),
    Case("trends of A;B+;C, an event a batch, 10 keys", TRENDS, 10, 20_000, 1),
    Case("next A;B;C, an event a batch, 100 keys", NEXT, 100, 20_000, 1),
    Case("any A;B;C, an event a batch, 100 keys", sequence("ABC"), 100, 20_000, 1),
    Case("any A;~D;C, an event a batch, 100 keys", sequence("A~DC"), 100, 20_000, 1),
)


def run(case: Case) -> None:
    """Measure one case and print its line."""
    rows = data(case.events, case.keys)
    parts = list(batches(rows, case.batch))
    _taken(case, parts[:2])
    ours, found = _least(lambda: _taken(case, parts))
    rate, results = case.events / ours / 1e6, found / ours / 1e6
    line = f"{case.name:54} {rate:7.2f} M events/s {results:8.2f} M matches/s {found:10,} matches"
    if case.batch == 1:
        line += f" {ours / case.events * 1e6:6.1f} µs an event"
    if case.by_hand is not None:
        by_hand = case.by_hand
        theirs, counted = _least(lambda: by_hand(rows))
        line += f"  {theirs / ours:5.1f} ×" + ("" if counted == found else f" but {counted:,}")
    print(line, flush=True)


def _taken(case: Case, parts: list[Rows]) -> int:
    running = evaluator_of(case.plan, is_ordered=case.is_ordered)
    found = 0
    for part in parts:
        found += len(running.push(part))
        if not case.is_ordered:
            running.advance(int(part.end[-1]))
    return found


def _least(work: Callable[[], int]) -> tuple[float, int]:
    least, found = float("inf"), 0
    for _ in range(RUNS):
        begun = time.process_time()
        found = work()
        least = min(least, time.process_time() - begun)
    return least, found


def memory() -> None:
    """Bytes of all arrays by live rows, and whether they grow."""
    rows = data(400_000, 1_000)
    # A match never comes, as no E is given: rows of two kinds are kept for 100,000 s.
    plan = replace(sequence("ABE"), within=100_000 * S)
    rows = replace(rows, kind=np.where(rows.kind == KINDS.index("E"), 3, rows.kind))
    running = AllRows(plan)
    sizes = []
    for i, part in enumerate(batches(rows, 1000)):
        running.push(part)
        if i % 100 == 99:
            sizes.append(running.size)
    live = int((np.isin(rows.kind, [0, 1]) & (rows.end >= rows.end[-1] - plan.within)).sum())
    told = ", ".join(f"{size / 1e6:.1f}" for size in sizes)
    print(f"memory: {sizes[-1] / live:.0f} B a live row of {live:,}, candidates included", end="")
    print(f"; MB after each 100,000 events: {told}")


def main() -> None:
    texts = sys.argv[1:]
    for case in CASES:
        if not texts or any(text in case.name for text in texts):
            run(case)
    if not texts or any(text in "memory" for text in texts):
        memory()


if __name__ == "__main__":
    main()
