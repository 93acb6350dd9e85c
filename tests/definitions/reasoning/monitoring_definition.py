"""The definition of a monitor's report over samples (SPEC §8): states by `state_definition`, their
verdicts by `progression_definition`, put together in plain lists. Slow on purpose."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

from progression_definition import END, Progression, Trace, bound_all
from state_definition import Moment, State, StateDefinition


@dataclass
class TickedStates(StateDefinition):
    """States that may also leave at the ``ticks`` of a clock. With ``reach``, the samples are some
    of those of ``reach``, and the states leave when those of that would."""

    ticks: list[int] = field(default_factory=list)
    reach: TickedStates | None = None

    def __post_init__(self) -> None:
        self._reached: dict[Moment, int] = {}
        self._moments: list[Moment] | None = None
        self._left: dict[int, Moment | None] = {}

    def moments(self) -> list[Moment]:
        if self.reach is not None:
            return self.reach.moments()
        if self._moments is None:
            self._moments = sorted({*super().moments(), *((tick, 0) for tick in self.ticks)})
        return self._moments

    def left(self, t: int) -> Moment | None:
        if self.reach is not None:
            return self.reach.left(t)
        if t not in self._left:
            self._left[t] = super().left(t)
        return self._left[t]

    def reached(self, moment: Moment) -> int:
        if self.reach is not None:
            return self.reach.reached(moment)
        if moment not in self._reached:
            self._reached[moment] = super().reached(moment)
        return self._reached[moment]

    def of(self, iri: str) -> TickedStates:
        """The states of an object by itself."""
        own = [s for s in self.samples if s.objects == (iri,)]
        return TickedStates(**{**vars_of(self), "samples": own, "reach": self})


def vars_of(states: TickedStates) -> dict:
    return {name: getattr(states, name) for name in states.__dataclass_fields__}


class Placed(str):
    """An object in place of a variable of ``sort``."""

    sort: str

    def __new__(cls, iri: str, sort: str) -> Placed:
        made = super().__new__(cls, iri)
        made.sort = sort
        return made


@dataclass(frozen=True)
class Verdict:
    """Of a binding ``objects`` and the start at valid time ``start``; in a report of changes that
    of a run, up to the start ``last``."""

    available: int
    objects: tuple[str, ...]
    start: int
    value: int
    decided: int
    last: int
    at_end: bool = field(default=False, compare=False)
    """Whether the end of the streams decides it; such come after others of one time."""


@dataclass
class MonitoringDefinition:
    """``moment``: when all streams have ended; None: they have not."""

    monitor: object
    states: TickedStates
    has_own_states: bool
    moment: int | None

    def reported(self) -> list[Verdict]:
        """What is reported, in order."""
        found: list[Verdict] = []
        for states in self.timelines():
            verdicts = Timeline(self, states).verdicts()
            match str(self.monitor.report):
                case "violations":
                    found += [v for row in verdicts.values() for v in row if v and v.value == 0]
                case "verdicts":
                    found += [v for row in verdicts.values() for v in row if v]
                case "changes":
                    for row in verdicts.values():
                        found += runs(row, self.moment, is_single=self.monitor.once)
        return sorted(found, key=lambda v: (v.available, v.at_end, v.objects, v.start))

    def timelines(self) -> list[TickedStates]:
        if not self.has_own_states:
            return [self.states]
        return [self.states.of(iri) for (iri,) in sorted({s.objects for s in self.states.samples})]


class Timeline:
    """Verdicts over some states."""

    def __init__(self, whole: MonitoringDefinition, states: TickedStates) -> None:
        self.monitor, self.moment = whole.monitor, whole.moment
        self.definition = states
        self.states = states.states()
        self.before_end = len(self.states)
        if self.moment is not None:
            self.states += states.last_states(self.moment)
        period = states.period
        self.horizon = [s.valid + (period or 1) - 1 for s in self.states]
        self.found: dict[tuple[tuple[str, ...], int], Verdict] = {}
        """By binding and index of the start."""

    def verdicts(self) -> dict[tuple[str, ...], list[Verdict | None]]:
        """Of each binding, in order of start; None: not decided yet."""
        for tick in self.definition.ticks:
            moment = (tick, 0)
            count = sum(s.moment <= moment for s in self.states[: self.before_end])
            self.decide(count, None)
            if count:
                # By the clock, and no state, later states are known to be later.
                self.horizon[count - 1] = max(
                    self.horizon[count - 1], self.definition.reached(moment) - 1
                )
                self.decide(count, tick)
        self.decide(len(self.states), None)
        if self.states and self.moment is not None:
            self.horizon[-1] = END
            self.decide(len(self.states), self.moment)
        rows: dict[tuple[str, ...], list[Verdict | None]] = {}
        for objects, start in self.starts(len(self.states)):
            rows.setdefault(objects, []).append(self.found.get((objects, start)))
        return rows

    def starts(self, count: int) -> list[tuple[tuple[str, ...], int]]:
        sorts = [sort for _, sort in self.monitor.parameters]
        return [
            (tuple(map(str, objects)), i)
            for i in range(min(count, 1) if self.monitor.once else count)
            for objects in itertools.product(*(objects_of(self.states[i], s) for s in sorts))
        ]

    def decide(self, count: int, moment: int | None) -> None:
        """Add what the first ``count`` states decide, at ``moment`` or when these left."""
        states = self.states[:count]
        sorts = {sort for s in states for sort, _ in s.present}
        sorts |= {sort for _, sort in self.monitor.parameters} | quantified(self.monitor.formula)
        trace = Trace(
            [s.valid for s in states],
            self.horizon[:count],
            lambda reading, i: value_of(reading, states[i]),
            [{sort: objects_of(s, sort) for sort in sorts} for s in states],
        )
        progression = Progression(trace)
        for objects, start in self.starts(count):
            if (objects, start) in self.found:
                continue
            parameters = self.monitor.parameters
            placed = [Placed(o, sort) for o, (_, sort) in zip(objects, parameters, strict=True)]
            closed = bound_all(self.monitor.formula, parameters, placed)
            verdict = progression.verdict(closed, start)
            if verdict is not None:
                value, at = verdict
                left = states[at].left if moment is None else moment
                valid = states[start].valid
                self.found[objects, start] = Verdict(
                    left,
                    objects,
                    valid,
                    value,
                    states[at].valid,
                    valid,
                    at >= self.before_end or self.horizon[at] == END,
                )


def objects_of(state: State, sort: str) -> list[Placed]:
    return sorted(Placed(iri, sort) for each, iri in state.present if each == sort)


def value_of(reading, state: State) -> object:
    iris = tuple(a.iri for a in reading.arguments)
    arguments = tuple(i.sort if isinstance(i, Placed) else f"<{i}>" for i in iris)
    return state.values.get(((reading.feature, arguments), iris))


def quantified(formula) -> set[str]:
    """The sorts of quantifiers."""
    parts = [getattr(formula, name) for name in getattr(formula, "__dataclass_fields__", ())]
    found = {formula.sort} if hasattr(formula, "variable") else set()
    return found.union(*(quantified(part) for part in parts))


def runs(row: list[Verdict | None], moment: int | None, *, is_single: bool) -> list[Verdict]:
    """The longest runs of equal verdicts of a binding. Each is known with the verdict that differs,
    when all before that are known too; with a single start at once; else at the end."""
    known = list(itertools.takewhile(lambda v: v is not None, row))
    if is_single:
        return known
    found = []
    for value, group in itertools.groupby(range(len(known)), lambda i: known[i].value):
        places = list(group)
        first, after = known[places[0]], places[-1] + 1
        if after < len(known):
            available = max(v.available for v in known[: after + 1])
            at_end = any(v.at_end for v in known[: after + 1])
        elif moment is not None:
            available, at_end = moment, True
        else:
            continue
        decided = max(known[i].decided for i in places)
        last = known[places[-1]].start
        found.append(Verdict(available, first.objects, first.start, value, decided, last, at_end))
    return found
