"""How many rows the patterns of a plan have: on the static side, counted, and in the windows, a
rate times their length.
"""

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
from .input_rates import NOTHING_KNOWN, SILENCE, Flow, Said

UNKNOWN_V = 10.0
"""V of objects that nobody has counted, such as numbers."""
ASSUMED_LANDMARK = 3600.0
"""How long (s) a window since a landmark is, where its stream has not been read."""


@dataclass(frozen=True, slots=True)
class Known:
    """What is known of the data: ``flows`` by input; ``distinct``: equal triples count once."""

    schedule: Schedule
    static: StaticSide
    flows: Mapping[str, Flow]
    distinct: bool = False


@dataclass(frozen=True, slots=True)
class Size:
    """A relation as far as it is known: its rows and V, the distinct values by variable."""

    rows: float
    distinct: Mapping[str, float]

    def v(self, name: str) -> float:
        return self.distinct.get(name, self.rows)


NOTHING = Size(0.0, {})


class PatternSizes:
    """The sizes of patterns over what is known."""

    def __init__(self, known: Known) -> None:
        self._known = known
        self._named = known.schedule.named
        self._source = EmptyWindows(known.static, self._named, False, None)

    def of(self, scan: AnyPattern) -> Size:
        """In a window, the static side with it."""
        return either((self._static(scan), self._told(scan)))

    def step(self, scan: AnyPattern) -> float:
        """The rows of a pattern that come from one evaluation to the next."""
        ends = self._known.schedule.ends
        assert ends is not None
        return self._told(scan, ends.step / SECOND).rows

    def _static(self, scan: AnyPattern) -> Size:
        """What a pattern has of the static side: counted."""
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

    def _told(self, scan: AnyPattern, seconds: float | None = None) -> Size:
        """What a pattern has of the windows (None), or of so many seconds of their streams."""
        found = NOTHING
        for window in self._known.schedule.windows:
            if window.graph == scan.graph:
                found = self._of_window(found, scan, window, seconds)
        return found

    def _of_window(
        self, before: Size, scan: AnyPattern, window: InputWindow, seconds: float | None
    ) -> Size:
        flow = self._known.flows.get(window.input, NOTHING_KNOWN)
        said, length = self._said(scan, flow), _seconds(window, flow)
        rows = said.rate * (length if seconds is None else min(seconds, length))
        if isinstance(window.window, CountWindow):
            all_said = flow.any.rate
            share = said.rate / all_said if all_said else 0.0
            rows = window.window.size * min(share, 1.0)
        subjects = min(said.subjects, rows)
        objects = UNKNOWN_V if said.objects is None else said.objects
        once = self._known.distinct and said.objects is not None
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
        # Streams of one graph speak of the same objects, so far as anybody knows.
        v = {name: max(value, before.distinct.get(name, 0.0)) for name, value in v.items()}
        rows += before.rows
        return Size(rows, {name: min(value, rows) for name, value in v.items()})

    def _said(self, scan: AnyPattern, flow: Flow) -> Said:
        """What a stream says that could match."""
        match scan:
            case AnyScan() if flow.predicates is not None:
                every = flow.predicates.values()
                known = [one.objects for one in every if one.objects is not None]
                objects = sum(known) if len(known) == len(every) else None
                return Said(sum(one.rate for one in every), flow.any.subjects, objects)
            case AnyScan():
                return flow.any
            case Scan(_, predicate):
                # A pattern that the static side knows nothing of is the one the stream is for.
                if flow.predicates is None and self._known.static.background.has(predicate):
                    return SILENCE
                return flow.said(predicate.value)
            case TypeScan():
                if flow.predicates is None and self._static(scan).rows:
                    return SILENCE
                if flow.predicates is None:
                    return Said(flow.any.rate, flow.any.subjects, 1.0)
                return flow.said(RDF_TYPE.value)
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
