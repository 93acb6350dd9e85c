"""A monitor over samples: its states, their verdicts, and what is reported of them (SPEC §8)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...languages.mtl.ast import Report
from ...languages.mtl.checked import CheckedMonitor, ObjectConstant
from ...streams.sample import Times
from ...streams.time import TIME_MIN
from ..states.departures import Departures
from ..states.kept_samples import Rows
from ..states.part_states import CommonSteps, PartStates
from ..states.state_maker import MadeStates, StateMaker, variables_of
from ..states.states import States, Term
from .bits.evaluator import SlicedEvaluator, is_sliced
from .evaluator import Constants, MonitorEvaluator, StateKeeper, Verdicts
from .formulas import compares_objects, objects_have_states
from .parts.evaluator import PartEvaluator

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


_Binding: TypeAlias = tuple[Any, ...]
"""The objects of the parameters."""


class Monitoring:
    """The verdicts of a monitor over samples of ``sources`` streams, numbered from 0.

    Without a grid, a formula of one parameter and no quantifier, whose features are all of the
    parameter, has states of its own for each object: at the samples of that object. Otherwise all
    objects share the states. ``wider`` as for `StateMaker`.

    Law (tests/laws/reasoning): the verdicts do not depend on batch cuts. Cost: that of
    its evaluator (docs/explanation/design/0011-formulas.md).
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
        without: Set[str] = frozenset(),
        has_own_states: bool | None = None,
    ) -> None:
        """``decides``: whether there are verdicts; otherwise all states are kept. ``grid``: a time
        (ns) of the grid of ``sample every``; None: as for `StateMaker`. ``only``: objects (IRIs);
        others have no states of their own, nor have those in ``without``.
        ``has_own_states``: whether each object has; None: as above."""
        self.monitor = monitor
        self._only = only
        self._without = without
        if has_own_states is None:
            has_own_states = objects_have_states(monitor)
        self.has_own_states = has_own_states
        self._evaluator = self._made_evaluator(decides)
        self.terms: tuple[Term, ...] = tuple(sorted(self._evaluator.terms))
        self._departures = Departures(monitor.policy.max_delay, sources)
        self._greatest = [TIME_MIN] * sources
        """The greatest valid time of each stream's samples."""
        policy, present_for = monitor.policy, monitor.present_for
        # One of both has samples.
        self._own = PartStates(self.terms, policy, present_for=present_for)
        self._shared = StateMaker(
            self.terms, policy, present_for=present_for, wider=wider, grid=grid
        )
        self._parts: dict[str, int] = {}
        """The parts of objects that have states of their own, by IRI."""
        self._names: NDArray[Any] = np.empty(0, object)
        """The IRIs of the objects that have states of their own, by their parts."""
        self._objects: list[NDArray[Any]] = [np.empty(0, object) for _ in monitor.parameters]
        """The IRIs of each parameter's objects, by their places, where states are shared."""
        self._nothing = _joined((), len(monitor.parameters))
        self._verdicts = dict.fromkeys(WORDS, 0)
        # A single start is a run by itself.
        has_runs = monitor.report is Report.CHANGES and not monitor.once
        self._runs = _Runs() if has_runs else None

    def _made_evaluator(self, decides: bool) -> MonitorEvaluator | SlicedEvaluator | PartEvaluator:
        if not decides:
            return StateKeeper(self.monitor)
        if self.has_own_states:
            return PartEvaluator(self.monitor)
        return (SlicedEvaluator if is_sliced(self.monitor) else MonitorEvaluator)(self.monitor)

    @property
    def way(self) -> str:
        """How verdicts are made, for people."""
        if isinstance(self._evaluator, SlicedEvaluator):
            return "over tables of bits, 64 objects at a time"
        each = "each object's own states" if self.has_own_states else "the states of all objects"
        return f"by moments, over {each}"

    @property
    def grid(self) -> int | None:
        """A time (ns) of the grid, once it has begun."""
        return None if self.has_own_states else self._shared.grid

    @property
    def states(self) -> int:
        """The number of states by now."""
        return self._evaluator.seen

    @property
    def started(self) -> frozenset[str]:
        """The objects (IRIs) that have states of their own by now."""
        if not isinstance(self._evaluator, PartEvaluator):
            return frozenset()
        states_of = self._evaluator.states_of
        return frozenset(iri for iri, part in self._parts.items() if states_of[part])

    @property
    def late(self) -> int:
        """Samples that came after the state of their valid time had left."""
        return int(self._own.late_of.sum()) + self._shared.late

    @property
    def retained(self) -> int:
        """The number of samples and states in memory."""
        return self._own.retained + self._shared.retained + self._evaluator.pending

    @property
    def verdicts(self) -> Mapping[str, int]:
        """The number of verdicts by now, by their word."""
        return {WORDS[value]: count for value, count in self._verdicts.items()}

    @property
    def has_open(self) -> bool:
        """Whether a state has no verdict yet."""
        return self._evaluator.is_open

    @property
    def is_over(self) -> bool:
        """Whether a monitor of a single start has its verdict. With states of its own each object
        has a start, and further objects may come."""
        has_begun = self.monitor.once and not self.has_own_states and self.states > 0
        return has_begun and not self.has_open

    def place(self, term: Term, variable: int, iri: str) -> int:
        """Return the number of an object for `add`, as a variable argument of a term; -1 where the
        monitor is not about it."""
        if not self.has_own_states:
            return self._shared.place(variables_of(term)[variable], iri)
        is_left_out = iri in self._without or (self._only is not None and iri not in self._only)
        return -1 if is_left_out else self._part(iri)

    def add(
        self, source: int, term: Term, available: Times, valid: Times,
        places: NDArray[np.int64], values: NDArray[Any],
    ) -> None:  # fmt: skip
        """Take samples of a term from a stream, in order of available time. ``places``: the `place`
        of each variable argument, shape ``(n, variables)``. `came` must tell of them, too."""
        if not self.has_own_states:
            self._shared.add(term, source, Rows(available, valid, places, values))
            return
        part = places[:, 0]
        if self._only is not None or self._without:
            own = part >= 0
            available, valid, part, values = available[own], valid[own], part[own], values[own]
        self._own.add(term, source, available, valid, part, values)

    def came(self, source: int, available: Times, valid: Times) -> None:
        """Take the times of all samples of a stream, in order of available time."""
        self._departures.add(source, available, valid)
        self._greatest[source] = int(valid.max(initial=self._greatest[source]))

    def ended(self, source: int, moment: int) -> None:
        """Wait for a stream no longer after the available time ``moment``, when it ended; its
        objects have gone then, and after its last sample."""
        self._departures.end(source, moment)
        self._shared.ended(source, max(moment, self._greatest[source]))

    def set_idle(self, sources: Iterable[int]) -> None:
        """Wait for these streams no longer, until they have samples again."""
        self._departures.idle = frozenset(sources)

    def advance(self, watermark: int, *, by_clock: bool = False) -> Reported:
        """Return what the samples available before ``watermark`` decide. Contract: all of them were
        added. ``by_clock``: the clock, and no sample, has brought the watermark, so all states to
        come are later."""
        steps = self._departures.advance(watermark, by_clock=by_clock)
        if self.has_own_states:
            made = self._own.advance(watermark, CommonSteps(steps))
        else:
            made = self._shared.advance(steps)
        return self._report(self._decided(made, steps.latest, watermark if by_clock else None))

    def finish(self, moment: int) -> Reported:
        """Return the verdicts at the end of all streams, which is at ``moment``."""
        made = self._own.end(moment) if self.has_own_states else self._shared.end(moment)
        found = [*map(self._push, made), self._reported(self._evaluator.end(), moment)]
        reported = self._report(found)
        if self._runs is None:
            return reported
        parts = [reported, self._runs.rest(moment)]
        return _in_order(_joined(parts, len(self.monitor.parameters)))

    def states_of(self, objects: Sequence[str]) -> States | None:
        """The states in memory for the verdicts of these objects; None if there are none yet.
        Contract: where objects have states of their own, no other object was taken."""
        states = self._evaluator.states
        if states is None or not self.has_own_states:
            return states
        return replace(states, objects=dict.fromkeys(states.objects, tuple(objects)))

    def _part(self, iri: str) -> int:
        if iri not in self._parts:
            part = self._parts[iri] = len(self._parts)
            if part == len(self._names):
                self._names = np.concatenate([self._names, np.empty(max(16, part), object)])
            self._names[part] = iri
            self._begin_part(part, iri, {})
        return self._parts[iri]

    def _begin_part(self, part: int, iri: str, values: Constants) -> None:
        """Let there be a part for an object, with its ``values`` of the formula's parameters."""
        self._own.make_room_for(part + 1)
        if not isinstance(self._evaluator, PartEvaluator):
            return  # an explanation, of one object
        self._evaluator.make_room_for(part + 1)
        if compares_objects(self.monitor.formula):
            values = {**values, self.monitor.parameters[0][0]: ObjectConstant(iri)}
        self._evaluator.set_values(part, values)

    def _decided(
        self, made: Iterator[MadeStates], latest: int | Times, tick: int | None
    ) -> list[Reported]:
        """What states decide that leave, and then the time ``latest``, which the clock has
        reached at ``tick``."""
        found = [*map(self._push, made)]
        if tick is not None:
            if isinstance(self._evaluator, PartEvaluator):
                verdicts = self._evaluator.advance(latest - 1)
            else:
                verdicts = self._evaluator.advance(int(latest) - 1)
            found.append(self._reported(verdicts, tick))
        return found

    def _push(self, made: MadeStates) -> Reported:
        if not self.has_own_states:
            sorts = [sort for _, sort in self.monitor.parameters]
            self._objects = [np.array(made.states.objects[sort], object) for sort in sorts]
        if isinstance(self._evaluator, PartEvaluator):
            found = self._evaluator.push(made.states, made.left, made.part)
        else:
            found = self._evaluator.push(made.states, made.left)
        return self._reported(found, None)

    def _reported(self, found: Verdicts, moment: int | None) -> Reported:
        """The verdicts at ``moment``, or when their deciding states left."""
        for value, count in found.unreported.items():
            self._verdicts[value] += count
        if not len(found):
            return self._nothing
        available = found.left if moment is None else np.full(len(found), moment, np.int64)
        start = found.start_time
        return Reported(
            available,
            start,
            found.decided_time,
            start,
            found.value,
            self._objects_of(found),
            found.witness_time,
            found.robustness,
        )

    def _objects_of(self, found: Verdicts) -> NDArray[Any]:
        """The IRIs of each parameter's objects, shape ``(parameters, n)``."""
        if self.has_own_states:
            return self._names[found.part].reshape(1, -1)
        columns = [names[found.binding[:, i]] for i, names in enumerate(self._objects)]
        return np.stack(columns) if columns else np.empty((0, len(found)), object)

    def _place_of(self, binding: _Binding) -> tuple[int, ...]:
        """The place of a binding in what `settled` of the evaluator returns."""
        if self.has_own_states:
            return (self._parts[binding[0]],)
        sorts = [sort for _, sort in self.monitor.parameters]
        return tuple(map(self._shared.place, sorts, binding))

    def _report(self, found: Sequence[Reported]) -> Reported:
        found = [each for each in found if len(each)]
        if not found and self._runs is None:
            return self._nothing
        joined = _in_order(_joined(found, len(self.monitor.parameters)))
        for value in WORDS:
            self._verdicts[value] += int(np.count_nonzero(joined.value == value))
        if self.monitor.report is Report.VIOLATIONS:
            return joined.take(joined.value == 0)
        if self._runs is not None and self.states:
            settled = self._evaluator.settled()
            return self._runs.take(joined, lambda binding: int(settled[self._place_of(binding)]))
        return joined


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
        self._held: dict[_Binding, list[_Start]] = {}
        """By objects."""
        self._open: dict[_Binding, _Run] = {}
        """By objects: the run that may go on."""

    def take(self, found: Reported, before: Callable[[_Binding], int]) -> Reported:
        """Take verdicts. ``before``: the valid time before which no start of a binding is without
        a verdict."""
        columns = found.valid, found.value, found.decided, found.available, found.witness
        for i, row in enumerate(zip(*(column.tolist() for column in columns), strict=True)):
            self._held.setdefault(tuple(found.objects[:, i]), []).append(_Start(*row))
        ended: list[tuple[_Binding, _Run]] = []
        for binding in list(self._held):
            ended += self._release(binding, before(binding))
        return _of_runs(ended, len(found.objects))

    def rest(self, moment: int) -> Reported:
        """End the open runs at ``moment``. Contract: each start has its verdict."""
        ended = [(binding, run._replace(available=moment)) for binding, run in self._open.items()]
        self._open = {}
        return _of_runs(ended, len(ended[0][0]) if ended else 0)

    def drop(self, binding: _Binding) -> None:
        """Forget the verdicts of a binding."""
        self._held.pop(binding, None)
        self._open.pop(binding, None)

    def _release(self, binding: _Binding, before: int) -> Iterator[tuple[_Binding, _Run]]:
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


def _of_runs(runs: Sequence[tuple[_Binding, _Run]], parameters: int) -> Reported:
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
