"""Results of a pattern query whose plans are put together: alternatives, optional parts, tests of
outputs (SPEC §8).

The results of all plans are a bag. A branch with an *absence* gives a match only if no match of
another plan has the same rows (`query.Absence`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ....streams.time import TIME_MAX, TIME_MIN
from ..evaluation.all_rows import AllRows
from ..evaluation.store import SMALLEST
from ..plans.limits import DEFAULT_LIMITS, Counters, Limits
from ..plans.network import minimal_network
from ..plans.plan import PatternPlan, PlanError
from ..plans.query import Absence, AllOf, Branch, StaticJoin
from ..plans.rows import Matches, Rows
from .output_tests import hold, print_test, values_of

NO_ROW: Final = -1
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class CombinedMatches(Matches):
    """Results in the order in which they were decided. ``plan`` has the number of the plan of each,
    shape ``(m,)``; ``rows`` is padded with `NO_ROW`. ``outputs`` are those that all plans have
    whose matches are results."""

    plan: Integers


StaticSolutions: TypeAlias = Callable[
    [StaticJoin, Mapping[str, NDArray[Any]], int], tuple[Integers, Mapping[str, NDArray[Any]]]
]
"""Returns the solutions of a static join for so many rows of values, by variable: the number of the
row of each, and their results and values, by output."""


class CombinedRows:
    """The results of several plans over the same rows; the face of `AllRows`.

    Law (tests/laws/reasoning/patterns/test_epsparql.py): the results are those of the definition,
    each once, in order of (time of decision, last row, plan), however the rows are cut into
    batches. So a result that waited comes before those of the row that decides it.

    Without absences the rows may come in any order, as in `AllRows`. ``static`` answers the static
    joins of the branches, as of the time when a result is decided.

    Cost: that of the plans; besides, for plans with absences, Python operations for each of their
    matches and for each match of the other plans. Memory: an entry for each of the latter, for as
    long as a match with its rows may be completed.

    Raises `PlanError`.
    """

    def __init__(
        self,
        plans: Sequence[PatternPlan],
        branches: Sequence[Branch] = (),
        *,
        is_ordered: bool = True,
        limits: Limits = DEFAULT_LIMITS,
        capacity: int = SMALLEST,
        static: StaticSolutions | None = None,
    ) -> None:
        branches = branches or [Branch()] * len(plans)
        if not is_ordered and any(branch.absences for branch in branches):
            raise PlanError(
                "an optional part needs rows in order of time", "sort them, or declare a max delay"
            )
        if static is None and any(branch.static is not None for branch in branches):
            raise PlanError("the pattern has static triples", "tell where they are answered")
        self._is_ordered = is_ordered
        self._static = static
        self._limits = limits
        shown = [
            [output.name for output in plan.outputs]
            for plan, branch in zip(plans, branches, strict=True)
            if branch.is_given
        ]
        self._outputs = [name for name in shown[0] if all(name in each for each in shown)]
        self._width = max(len(plan.elements) for plan in plans)
        self._parts: list[_Part] = [
            _Part(
                number,
                branch,
                AllRows(plan, is_ordered=is_ordered, limits=limits, capacity=capacity),
                [_Found(each, minimal_network(plan).span) for each in branch.absences],
            )
            for number, (plan, branch) in enumerate(zip(plans, branches, strict=True))
        ]
        self._is_plain = list(branches) == [Branch()]
        self._watermark = TIME_MIN
        self._unawaited = 0
        self._nothing = self._in_order(
            [(part, part.waiting) for part in self._parts if part.branch.is_given]
        )

    # -- rows and time -----------------------------------------------------------------------

    def push(self, rows: Rows) -> CombinedMatches:
        """Take rows and return what they decide."""
        made = [part.rows.push(rows) for part in self._parts]
        if len(rows) and self._is_ordered:
            self._watermark = max(self._watermark, int(rows.end.max()))
        return self._decided(made)

    def advance(self, watermark: int) -> CombinedMatches:
        """Promise that no row ends before ``watermark`` any more; return what that decides."""
        made = [part.rows.advance(watermark) for part in self._parts]
        self._watermark = max(self._watermark, watermark)
        return self._decided(made)

    def end(self) -> CombinedMatches:
        """Promise that no row comes any more; return what that decides."""
        return self.advance(TIME_MAX)

    def next_due(self) -> int | None:
        """The watermark at which the next match that waits is decided, or None."""
        dues = [each.rows.next_due() for each in self._parts]
        dues += [int(each.waiting.due.min()) for each in self._parts if len(each.waiting)]
        return min((due for due in dues if due is not None), default=None)

    # -- state -------------------------------------------------------------------------------

    @property
    def counters(self) -> Counters:
        """What the evaluations of all plans have done, added up; ``rows`` are counted once."""
        each = [part.rows.counters for part in self._parts]
        sums = {one.name: sum(getattr(c, one.name) for c in each) for one in fields(Counters)}
        sums["rows"] = each[0].rows
        sums["unawaited"] += self._unawaited
        return Counters(**sums)

    @property
    def watermark(self) -> int:
        """The time (ns) before which no row comes any more."""
        return self._watermark

    @property
    def pending(self) -> int:
        """The number of matches that wait."""
        return sum(part.rows.pending + len(part.waiting) for part in self._parts)

    @property
    def kept(self) -> int:
        """The number of rows and of matches of other plans that are kept."""
        return sum(
            part.rows.kept + sum(len(found.until) for found in part.found) for part in self._parts
        )

    def given(self) -> list[tuple[int, AllRows]]:
        """The evaluations whose matches may be results, with the numbers of their plans."""
        return [(part.number, part.rows) for part in self._parts if part.branch.is_given]

    def state(self) -> tuple[Any, ...]:
        """Everything that `restore` needs; it can be pickled and does not change later."""
        parts = [
            (part.rows.state(), part.waiting, [found.state() for found in part.found])
            for part in self._parts
        ]
        return self._watermark, self._unawaited, parts

    def restore(self, state: tuple[Any, ...]) -> None:
        """Continue where the evaluator of the same plans was that gave this state."""
        self._watermark, self._unawaited, parts = state
        for part, (rows, waiting, founds) in zip(self._parts, parts, strict=True):
            part.waiting = waiting
            part.rows.restore(rows)
            for found, known in zip(part.found, founds, strict=True):
                found.restore(known)

    def explain(self) -> str:
        """Return all plans and how they are put together as text."""
        lines: list[str] = []
        for part in self._parts:
            lines.append(f"plan {part.number}" + ("" if part.branch.is_given else ", for others"))
            lines += [f"  {line}" for line in part.rows.explain().splitlines()]
            join = part.branch.static
            tests = (*part.branch.tests, *(() if join is None else join.tests))
            lines += [f"  test {print_test(test)}" for test in tests]
            for absence in part.branch.absences:
                pairs = ", ".join(f"{own} = {other}" for own, other in absence.rows)
                wait = "" if absence.until is None else f", known after {absence.until}"
                lines.append(f"  unless plan {absence.other} has the same events ({pairs}){wait}")
        return "\n".join(lines)

    # -- the way of a batch ------------------------------------------------------------------

    def _decided(self, made: list[Matches]) -> CombinedMatches:
        if self._is_plain:
            (only,) = made
            plan = np.zeros(len(only), np.int64)
            return CombinedMatches(only.rows, only.decided, only.outputs, only.last, plan)
        final: list[_Candidates] = []
        for part, matches in zip(self._parts, made, strict=True):
            found = part.decide(matches, self._watermark, final, self._limits)
            self._unawaited += part.lost
            join = part.branch.static
            if join is not None and self._static is not None:
                values = {name: found.outputs[output] for name, output, _ in join.variables}
                rows, results = self._static(join, values, len(found))
                found = found[rows]
                found.outputs.update(results)
                if join.tests:
                    found = found[hold(AllOf(join.tests), found.outputs, len(found))]
                for output, term in join.calculated:
                    found.outputs[output] = values_of(term, found.outputs)
            final.append(found)
        for part in self._parts:
            for each in part.found:
                each.forget(self._watermark)
        given = [
            (part, found)
            for part, found in zip(self._parts, final, strict=True)
            if part.branch.is_given
        ]
        return self._in_order(given) if any(len(each) for _, each in given) else self._nothing

    def _in_order(self, given: list[tuple[_Part, _Candidates]]) -> CombinedMatches:
        rows = np.concatenate([_padded(each.rows, self._width) for _, each in given])
        due = np.concatenate([each.due for _, each in given])
        plan = np.concatenate([np.full(len(each), part.number, np.int64) for part, each in given])
        outputs = {
            name: np.concatenate([each.outputs[name] for _, each in given])
            for name in self._outputs
        }
        last = rows.max(axis=1, initial=NO_ROW)
        if len(given) == 1 and not given[0][0].found:
            return CombinedMatches(rows, due, outputs, last, plan)
        keys = [plan, last]
        if self._is_ordered:
            keys.append(due)
        # Stable: what one row completes in one plan keeps its order.
        order = np.lexsort(keys)
        return CombinedMatches(
            rows[order],
            due[order],
            {name: values[order] for name, values in outputs.items()},
            last[order],
            plan[order],
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Candidates:
    """Matches of one plan: ``own`` is the time at which they were completed, ``due`` the time from
    which on no new row makes another match that excludes them."""

    rows: Integers
    own: Integers
    due: Integers
    outputs: dict[str, NDArray[Any]]

    def __len__(self) -> int:
        return len(self.due)

    def __getitem__(self, chosen: Flags | Integers) -> _Candidates:
        outputs = {name: values[chosen] for name, values in self.outputs.items()}
        return _Candidates(self.rows[chosen], self.own[chosen], self.due[chosen], outputs)

    def followed(self, other: _Candidates) -> _Candidates:
        """Return both, these first."""
        return _Candidates(
            np.concatenate([self.rows, other.rows]),
            np.concatenate([self.own, other.own]),
            np.concatenate([self.due, other.due]),
            {
                name: np.concatenate([values, other.outputs[name]])
                for name, values in self.outputs.items()
            },
        )


@dataclass(slots=True, eq=False)
class _Part:
    """One plan at work."""

    number: int
    branch: Branch
    rows: AllRows
    found: list[_Found]
    waiting: _Candidates = field(init=False)
    lost: int = 0
    """The matches of the last step that could not wait."""

    def __post_init__(self) -> None:
        nothing = self.rows.advance(TIME_MIN)
        self.waiting = _Candidates(
            nothing.rows, nothing.decided, nothing.decided, {**nothing.outputs}
        )

    def decide(
        self, matches: Matches, watermark: int, final: list[_Candidates], limits: Limits
    ) -> _Candidates:
        """Return the matches that are decided by the watermark; ``final`` are those of the earlier
        plans."""
        self.lost = 0
        for each in self.found:
            each.learn(final[each.absence.other])
        if not len(matches) and not len(self.waiting):
            return self.waiting
        due = matches.decided
        outputs = {**matches.outputs}
        for absence in self.branch.absences:
            if absence.until is not None:
                due = np.maximum(due, outputs[absence.until] + 1)
        new = _Candidates(matches.rows, matches.decided, due, outputs)
        if self.branch.tests:
            new = new[hold(AllOf(self.branch.tests), new.outputs, len(new))]
        if not self.found:
            return new
        is_open = new.due > watermark
        room = max(0, limits.waiting - len(self.waiting))
        is_late = is_open & (np.cumsum(is_open) > room)
        self.lost = int(np.count_nonzero(is_late))
        is_over = self.waiting.due <= watermark
        decided = self.waiting[is_over].followed(new[~is_open])
        self.waiting = self.waiting[~is_over].followed(new[is_open & ~is_late])
        for each in self.found:
            decided = decided[each.is_absent(decided)]
        return decided


@dataclass(slots=True, eq=False)
class _Found:
    """The rows of another plan's matches, for as long as a match of this plan, whose events last at
    most ``span``, may have the same."""

    absence: Absence
    span: int
    rows: dict[tuple[int, ...], int] = field(default_factory=dict)
    """Rows to the time up to which they are kept."""
    until: deque[tuple[int, tuple[int, ...]]] = field(default_factory=deque)
    """(time, rows), in order of time."""

    def learn(self, others: _Candidates) -> None:
        """Take new matches of the other plan."""
        if not len(others):
            return
        theirs = [other for _, other in self.absence.rows]
        for rows, due in zip(others.rows[:, theirs].tolist(), others.due.tolist(), strict=True):
            key = tuple(rows)
            until = due + self.span + 1
            if self.rows.get(key, TIME_MIN) < until:
                self.rows[key] = until
                self.until.append((until, key))

    def is_absent(self, own: _Candidates) -> Flags:
        """Which matches of this plan have rows that no match of the other one has."""
        mine = [element for element, _ in self.absence.rows]
        keys = map(tuple, own.rows[:, mine].tolist())
        return np.array([key not in self.rows for key in keys], np.bool_)

    def forget(self, watermark: int) -> None:
        """Drop what no match can have any more."""
        while self.until and self.until[0][0] < watermark:
            until, key = self.until.popleft()
            if self.rows.get(key) == until:
                del self.rows[key]

    def state(self) -> tuple[Any, ...]:
        return dict(self.rows), tuple(self.until)

    def restore(self, state: tuple[Any, ...]) -> None:
        rows, until = state
        self.rows, self.until = dict(rows), deque(until)


def _padded(rows: Integers, width: int) -> Integers:
    return np.pad(rows, ((0, 0), (0, width - rows.shape[1])), constant_values=NO_ROW)
