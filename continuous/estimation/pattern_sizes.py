"""Rows of the patterns of a plan: on the static side a count, in windows a rate times a length."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import assert_never

import numpy as np

from ...languages.csparql.ast import CountWindow
from ...rdf.namespaces import RDF_TYPE
from ...streams.time import SECOND
from ..algebra.expressions import Const, Var
from ..algebra.plan import AnyPattern, AnyScan, Position, Scan, TypeScan
from ..columns.relation import key_codes
from ..operators.executor import execute
from ..operators.sources import EmptyWindows, StaticSide
from ..windows.grid import InputWindow, Schedule
from .input_rates import NOTHING_KNOWN, SILENCE, Flow, PredicateRate

UNKNOWN_V = 10.0
"""V of objects that were not counted, such as numbers."""
ASSUMED_LANDMARK = 3600.0
"""Seconds in a window since a landmark, where its stream has not been read."""


@dataclass(frozen=True, slots=True)
class Known:
    """The data to estimate from: ``flows`` by input; ``distinct``: equal triples count once."""

    schedule: Schedule
    static: StaticSide
    flows: Mapping[str, Flow]
    distinct: bool = False


@dataclass(frozen=True, slots=True)
class Size:
    """The estimated rows of a relation and V, its distinct values by variable."""

    rows: float
    distinct: Mapping[str, float]

    def v(self, name: str) -> float:
        return self.distinct.get(name, self.rows)


NOTHING = Size(0.0, {})


class PatternSizes:
    """The estimated sizes of patterns."""

    def __init__(self, known: Known) -> None:
        self._known = known
        self._named = known.schedule.named
        self._source = EmptyWindows(known.static, self._named, False, None)

    def of(self, scan: AnyPattern) -> Size:
        """The size in a window together with the static side."""
        return either((self._static(scan), self._in_windows(scan)))

    def step(self, scan: AnyPattern) -> float:
        """The rows of a pattern that come between two evaluations."""
        ends = self._known.schedule.ends
        assert ends is not None
        return self._in_windows(scan, ends.step / SECOND).rows

    def _static(self, scan: AnyPattern) -> Size:
        """Count the rows of a pattern on the static side."""
        if scan.graph in self._named:
            return NOTHING
        terms = self._known.static.terms
        found = execute(scan, self._source, terms)
        v = {}
        for name, column in found.columns.items():
            present = column.take(column.present)
            codes = key_codes([[present]], terms.dictionary)[0]
            v[name] = float(len(np.unique(codes)))
        return Size(float(found.rows), v)

    def _in_windows(self, scan: AnyPattern, seconds: float | None = None) -> Size:
        """The rows of a pattern in the windows (None), or in ``seconds`` of their streams."""
        found = NOTHING
        for window in self._known.schedule.windows:
            if window.graph == scan.graph:
                found = self._of_window(found, scan, window, seconds)
        return found

    def _of_window(
        self, before: Size, scan: AnyPattern, window: InputWindow, seconds: float | None
    ) -> Size:
        flow = self._known.flows.get(window.input, NOTHING_KNOWN)
        matching, length = self._matching(scan, flow), _seconds(window, flow)
        rows = matching.rate * (length if seconds is None else min(seconds, length))
        if isinstance(window.window, CountWindow):
            all_rows = flow.any.rate
            share = matching.rate / all_rows if all_rows else 0.0
            rows = window.window.size * min(share, 1.0)
        subjects = min(matching.subjects, rows)
        objects = UNKNOWN_V if matching.objects is None else matching.objects
        once = self._known.distinct and matching.objects is not None
        if once or isinstance(scan, TypeScan):
            rows = min(rows, subjects * objects)
        v = {}
        if isinstance(scan, AnyScan):
            v[scan.predicate.name] = float(len(flow.predicates)) if flow.predicates else 1.0
        object = scan.sort if isinstance(scan, TypeScan) else scan.object
        if isinstance(scan.subject, Const):
            rows /= max(subjects, 1.0)
        if isinstance(object, Const):
            rows /= max(objects, 1.0)
        if isinstance(scan.subject, Var) and scan.subject == object:
            rows /= max(subjects, 1.0)
        v |= named_in(object, objects)
        v |= named_in(scan.subject, subjects)
        if not isinstance(scan, TypeScan):
            v |= dict.fromkeys(scan.times.names, rows)
        # Streams of one graph are assumed to have the same objects.
        v = {name: max(value, before.distinct.get(name, 0.0)) for name, value in v.items()}
        rows += before.rows
        return Size(rows, {name: min(value, rows) for name, value in v.items()})

    def _matching(self, scan: AnyPattern, flow: Flow) -> PredicateRate:
        """The triples of a stream that could match."""
        match scan:
            case AnyScan() if flow.predicates is not None:
                every = flow.predicates.values()
                known = [one.objects for one in every if one.objects is not None]
                objects = sum(known) if len(known) == len(every) else None
                return PredicateRate(sum(one.rate for one in every), flow.any.subjects, objects)
            case AnyScan():
                return flow.any
            case Scan(_, predicate):
                # The stream is assumed to have the predicates that the static side has not.
                if flow.predicates is None and self._known.static.background.has(predicate):
                    return SILENCE
                return flow.rate_of(predicate.value)
            case TypeScan():
                if flow.predicates is None and self._static(scan).rows:
                    return SILENCE
                if flow.predicates is None:
                    return PredicateRate(flow.any.rate, flow.any.subjects, 1.0)
                return flow.rate_of(RDF_TYPE.value)
            case _:
                assert_never(scan)


def _seconds(window: InputWindow, flow: Flow) -> float:
    if window.range is not None:
        return window.range / SECOND
    return ASSUMED_LANDMARK if flow.seconds is None else flow.seconds


def named_in(position: Position, v: float) -> dict[str, float]:
    return {position.name: v} if isinstance(position, Var) else {}


def either(parts: Sequence[Size]) -> Size:
    names = dict.fromkeys(name for part in parts for name in part.distinct)
    v = {name: sum(part.distinct.get(name, 0.0) for part in parts) for name in names}
    return Size(sum(part.rows for part in parts), v)
