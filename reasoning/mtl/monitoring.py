"""A monitor over samples: its states, their verdicts, and what is reported of them (SPEC §8)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...languages.mtl.ast import Report
from ...languages.mtl.checked import CheckedMonitor, ObjectVariable
from ...streams.sample import Times
from ..states.departures import Departures, Steps
from ..states.state_maker import MadeStates, Rows, StateMaker, variables_of
from ..states.states import States, Term
from .evaluator import MonitorEvaluator, StateKeeper, Verdicts
from .formulas import bound_sorts, readings_of

VERDICT, DECIDED, WITNESS = "verdict", "decided", "witness"
LAST, ROBUSTNESS = "last", "robustness"
RESULT_FIELDS: Final = (VERDICT, DECIDED, WITNESS, LAST, ROBUSTNESS)
"""The fields of a stream of verdicts beside the objects; `LAST` only where runs are reported, and
`ROBUSTNESS` only where it is asked for."""
WORDS: Final = {1: "true", 0: "false", -1: "unknown"}
"""The word for each verdict."""


@dataclass(frozen=True, slots=True, eq=False)
class Reported:
    """Verdicts to report, in order of available time, then of objects, then of start.

    Shape ``(n,)``: ``valid`` is the valid time of the start (of a run: of its first), ``decided``
    that of the deciding state, ``last`` that of the last start of a run, ``witness`` that of the
    state that bears witness to the (first) verdict, `TIME_MIN` for none. ``objects``: the IRIs of
    each parameter's objects, shape ``(parameters, n)``.
    """

    available: Times
    valid: Times
    decided: Times
    last: Times
    value: NDArray[np.int8]
    objects: NDArray[Any]
    witness: Times
    robustness: NDArray[np.float64] | None = None

    def __len__(self) -> int:
        return len(self.valid)

    def take(self, rows: Any) -> Reported:
        return Reported(
            self.available[rows],
            self.valid[rows],
            self.decided[rows],
            self.last[rows],
            self.value[rows],
            self.objects[:, rows],
            self.witness[rows],
            None if self.robustness is None else self.robustness[rows],
        )


class Monitoring:
    """The verdicts of a monitor over samples of ``sources`` streams, numbered from 0.

    Without a grid, a formula of one parameter and no quantifier, whose features are all of the
    parameter, has states of its own for each object: at the samples of that object. Otherwise all
    objects share the states. ``wider`` as for `StateMaker`.

    Law (tests/laws/reasoning): the verdicts do not depend on batch cuts. Cost: that of
    `MonitorEvaluator`; with states of its own, once for each object that has samples.
    """

    def __init__(
        self,
        monitor: CheckedMonitor,
        sources: int,
        wider: Mapping[str, Sequence[str]] | None = None,
        *,
        decides: bool = True,
        grid: int | None = None,
        only: Sequence[str] | None = None,
    ) -> None:
        """``decides``: whether there are verdicts; otherwise all states are kept. ``grid``: a time
        (ns) of the grid of ``sample every``; None: as for `StateMaker`. ``only``: objects (IRIs);
        others have no states of their own."""
        self.monitor = monitor
        self._wider = wider or {}
        self._evaluator = MonitorEvaluator if decides else StateKeeper
        self._grid = grid
        self._only = only
        self.terms: tuple[Term, ...] = tuple(sorted(MonitorEvaluator(monitor).terms))
        self.has_own_states = _has_own_states(monitor)
        self._departures = Departures(monitor.policy.max_delay, sources)
        self._timelines: dict[str, _Timeline] = {}
        self._shared = None if self.has_own_states else self._timeline()
        self._queued: dict[_Timeline, None] = {}
        """Objects with states of their own that have not left, or samples for these."""
        self.late = 0
        """Samples that came after the state of their valid time had left."""
        self._verdicts = dict.fromkeys(WORDS, 0)
        # A single start is a run by itself.
        has_runs = monitor.report is Report.CHANGES and not monitor.once
        self._runs = _Runs() if has_runs else None

    @property
    def grid(self) -> int | None:
        """A time (ns) of the grid, once it has begun."""
        return None if self._shared is None else self._shared.maker.grid

    @property
    def states(self) -> int:
        """The number of states by now."""
        return sum(each.states for each in self._all())

    @property
    def retained(self) -> int:
        """The number of samples and states in memory."""
        return sum(each.maker.retained + each.evaluator.pending for each in self._all())

    @property
    def verdicts(self) -> Mapping[str, int]:
        """The number of verdicts by now, by their word."""
        return {WORDS[value]: count for value, count in self._verdicts.items()}

    @property
    def has_open(self) -> bool:
        """Whether a state has no verdict yet."""
        return any(each.evaluator.is_open for each in self._all())

    @property
    def is_over(self) -> bool:
        """Whether a monitor of a single start has its verdict. With states of its own each object
        has a start, and further objects may come."""
        shared = self._shared
        has_begun = self.monitor.once and shared is not None and shared.states > 0
        return has_begun and not self.has_open

    def add(
        self, source: int, term: Term, available: Times, valid: Times, objects: NDArray[Any],
        values: NDArray[Any],
    ) -> None:  # fmt: skip
        """Take samples of a term from a stream, in order of available time. ``objects``: the IRI of
        each variable argument, shape ``(n, variables)``. `came` must tell of them, too."""
        sorts = variables_of(term)
        if self._shared is not None:
            maker = self._shared.maker
            columns = [
                np.array([maker.place(sort, iri) for iri in objects[:, i]], np.int64)
                for i, sort in enumerate(sorts)
            ]
            places = np.stack(columns, axis=1) if columns else np.empty((len(valid), 0), np.int64)
            maker.add(term, source, Rows(available, valid, places, values))
            return
        if self._only is not None:
            named = np.isin(objects[:, 0], self._only)
            available, valid, values = available[named], valid[named], values[named]
            objects = objects[named]
        rows_of: dict[str, list[int]] = {}
        for row, iri in enumerate(objects[:, 0]):
            rows_of.setdefault(iri, []).append(row)
        for iri, rows in rows_of.items():
            timeline = self._timelines.get(iri)
            if timeline is None:
                timeline = self._timelines[iri] = self._timeline()
                timeline.maker.place(sorts[0], iri)
            self._queued[timeline] = None
            mine = np.array(rows)
            none = np.zeros((len(mine), 1), np.int64)
            timeline.maker.add(term, source, Rows(available[mine], valid[mine], none, values[mine]))

    def came(self, source: int, available: Times, valid: Times) -> None:
        """Take the times of all samples of a stream, in order of available time."""
        self._departures.add(source, available, valid)

    def ended(self, source: int, moment: int) -> None:
        """Wait for a stream no longer after the available time ``moment``, when it ended."""
        self._departures.end(source, moment)

    def set_idle(self, sources: Iterable[int]) -> None:
        """Wait for these streams no longer, until they have samples again."""
        self._departures.idle = frozenset(sources)

    def advance(self, watermark: int, *, by_clock: bool = False) -> Reported:
        """Return what the samples available before ``watermark`` decide. Contract: all of them were
        added. ``by_clock``: the clock, and no sample, has brought the watermark, so all states to
        come are later."""
        steps = self._departures.advance(watermark, by_clock=by_clock)
        tick = watermark if by_clock else None
        # The clock decides starts of all objects, samples those of their own.
        advanced = self._all() if by_clock or self._shared is not None else list(self._queued)
        found: list[Reported] = []
        for each in advanced:
            before = each.maker.late
            found += each.advance(steps, tick)
            self.late += each.maker.late - before
        self._queued = {each: None for each in advanced if each.maker.is_waiting}
        return self._report(found, advanced)

    def finish(self, moment: int) -> Reported:
        """Return the verdicts at the end of all streams, which is at ``moment``."""
        found = [part for each in self._all() for part in each.finish(moment)]
        reported = self._report(found, self._all())
        if self._runs is None:
            return reported
        parts = [reported, self._runs.rest(moment)]
        return _in_order(_joined(parts, len(self.monitor.parameters)))

    def states_of(self, objects: Sequence[str]) -> States | None:
        """The states in memory for the verdicts of these objects; None if there are none yet."""
        timeline = self._shared or self._timelines.get(objects[0])
        return None if timeline is None else timeline.evaluator.states

    def _timeline(self) -> _Timeline:
        maker = StateMaker(
            self.terms,
            self.monitor.policy,
            present_for=self.monitor.present_for,
            wider=self._wider,
            grid=self._grid,
        )
        return _Timeline(self.monitor, maker, self._evaluator(self.monitor))

    def _all(self) -> Sequence[_Timeline]:
        return [self._shared] if self._shared is not None else list(self._timelines.values())

    def _report(self, found: Sequence[Reported], advanced: Iterable[_Timeline]) -> Reported:
        """What to report of the verdicts found, which are those of timelines that ``advanced``."""
        joined = _in_order(_joined(found, len(self.monitor.parameters)))
        for value in WORDS:
            self._verdicts[value] += int(np.count_nonzero(joined.value == value))
        if self.monitor.report is Report.VIOLATIONS:
            return joined.take(joined.value == 0)
        if self._runs is not None:
            begun = [each for each in advanced if each.states]
            settled = [(each.objects, each.evaluator.settled()) for each in begun]
            return self._runs.take(joined, settled)
        return joined


class _Timeline:
    """States, and their verdicts."""

    def __init__(
        self, monitor: CheckedMonitor, maker: StateMaker, evaluator: MonitorEvaluator
    ) -> None:
        self.maker = maker
        self.evaluator = evaluator
        self._sorts = [sort for _, sort in monitor.parameters]
        self.states = 0
        self.objects: list[NDArray[Any]] = [np.empty(0, object) for _ in self._sorts]
        """The IRIs of each parameter's objects, by their places."""
        self._left: Times = np.empty(0, np.int64)
        """When the states at and after `_first` left; the last one stays."""
        self._first = 0

    def advance(self, steps: Steps, tick: int | None) -> Iterator[Reported]:
        for made in self.maker.advance(steps):
            yield self._push(made)
        if tick is not None and self.states and self.evaluator.is_open:
            found = self.evaluator.advance(steps.latest - 1)
            if len(found):
                yield self._reported(found, tick)

    def finish(self, moment: int) -> Iterator[Reported]:
        for made in self.maker.end(moment):
            yield self._push(made)
        if self.states:
            yield self._reported(self.evaluator.end(), moment)

    def _push(self, made: MadeStates) -> Reported:
        keep = self._left[-1:]
        self._first = self.states - len(keep)
        self._left = np.concatenate([keep, made.left])
        self.states += len(made.left)
        self.objects = [np.array(made.states.objects[sort], object) for sort in self._sorts]
        return self._reported(self.evaluator.push(made.states), None)

    def _reported(self, found: Verdicts, moment: int | None) -> Reported:
        """The verdicts at ``moment``, or when their deciding states left."""
        available = (
            self._left[found.decided - self._first]
            if moment is None
            else np.full(len(found), moment, np.int64)
        )
        columns = [names[found.binding[:, i]] for i, names in enumerate(self.objects)]
        objects = np.stack(columns) if columns else np.empty((0, len(found)), object)
        start = found.start_time
        return Reported(
            available,
            start,
            found.decided_time,
            start,
            found.value,
            objects,
            found.witness_time,
            found.robustness,
        )


class _Start(NamedTuple):
    """The verdict of a start that waits for an earlier one."""

    valid: int
    value: int
    decided: int
    available: int
    witness: int


class _Run(NamedTuple):
    """A run of equal verdicts; ``witness``: that of the first one."""

    first: int
    last: int
    value: int
    decided: int
    available: int
    witness: int


class _Runs:
    """Runs of equal verdicts of one binding, each reported once the verdict after it is known."""

    def __init__(self) -> None:
        self._held: dict[tuple[str, ...], list[_Start]] = {}
        """By objects."""
        self._open: dict[tuple[str, ...], _Run] = {}
        """By objects: the run that may go on."""

    def take(
        self, found: Reported, settled: Iterable[tuple[Sequence[NDArray[Any]], NDArray[np.int64]]]
    ) -> Reported:
        """Take verdicts; ``settled``: by the places of objects, the valid time before which no
        start of a binding is without a verdict."""
        columns = found.valid, found.value, found.decided, found.available, found.witness
        for i, row in enumerate(zip(*(column.tolist() for column in columns), strict=True)):
            self._held.setdefault(tuple(found.objects[:, i]), []).append(_Start(*row))
        ended: list[tuple[tuple[str, ...], _Run]] = []
        for names, before in settled:
            for place in np.ndindex(before.shape):
                binding = tuple(own[at] for own, at in zip(names, place, strict=True))
                ended += self._release(binding, int(before[place]))
        return _of_runs(ended, len(found.objects))

    def rest(self, moment: int) -> Reported:
        """End the open runs at ``moment``. Contract: each start has its verdict."""
        ended = [(binding, run._replace(available=moment)) for binding, run in self._open.items()]
        self._open = {}
        return _of_runs(ended, len(ended[0][0]) if ended else 0)

    def _release(
        self, binding: tuple[str, ...], before: int
    ) -> Iterator[tuple[tuple[str, ...], _Run]]:
        held = sorted(self._held.get(binding, ()))
        count = len([start for start in held if start.valid < before])
        for start in held[:count]:
            run = self._open.get(binding)
            if run is not None and run.value == start.value:
                self._open[binding] = run._replace(
                    last=start.valid,
                    decided=max(run.decided, start.decided),
                    available=max(run.available, start.available),
                )
                continue
            available = start.available
            if run is not None:
                # It is known to be over since the verdict that differs, and where the next one
                # begins since it is over.
                available = max(run.available, available)
                yield binding, run._replace(available=available)
            self._open[binding] = _Run(
                start.valid, start.valid, start.value, start.decided, available, start.witness
            )
        if held[count:]:
            self._held[binding] = held[count:]
        else:
            self._held.pop(binding, None)


def _of_runs(runs: Sequence[tuple[tuple[str, ...], _Run]], parameters: int) -> Reported:
    rows = np.array([run for _, run in runs], np.int64).reshape(len(runs), len(_Run._fields))
    objects = np.empty((parameters, len(runs)), object)
    for i, (binding, _) in enumerate(runs):
        objects[:, i] = binding
    first, last, value, decided, available, witness = rows.T
    found = Reported(available, first, decided, last, value.astype(np.int8), objects, witness)
    return _in_order(found)


def _in_order(found: Reported) -> Reported:
    if len(found) < 2:
        return found
    return found.take(np.lexsort((found.valid, *reversed(found.objects), found.available)))


def _joined(parts: Sequence[Reported], parameters: int) -> Reported:
    parts = [part for part in parts if len(part)]
    found = [part.robustness for part in parts if part.robustness is not None]
    if not parts:
        none = np.empty(0, np.int64)
        objects = np.empty((parameters, 0), object)
        return Reported(none, none, none, none, np.empty(0, np.int8), objects, none)
    return Reported(
        np.concatenate([part.available for part in parts]),
        np.concatenate([part.valid for part in parts]),
        np.concatenate([part.decided for part in parts]),
        np.concatenate([part.last for part in parts]),
        np.concatenate([part.value for part in parts]),
        np.concatenate([part.objects for part in parts], axis=1),
        np.concatenate([part.witness for part in parts]),
        np.concatenate(found) if found else None,
    )


def _has_own_states(monitor: CheckedMonitor) -> bool:
    if monitor.policy.period is not None or len(monitor.parameters) != 1:
        return False
    own = (ObjectVariable(monitor.parameters[0][0]),)
    is_own = all(reading.arguments == own for reading in readings_of(monitor.formula))
    return is_own and not bound_sorts(monitor.formula)
