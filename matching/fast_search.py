"""The strategy *fast*: the first valid plan that depth-first search finds ([Introspection15 §4.3]).

Definition: the search tries the answers of a goal in order, and takes the first whose needs all
have answers in turn. A goal stands once on a path. It keeps its answer, so that a unit that two
others need is made once.

`solve` finds the same without repeating failures. A goal may fail only because a goal above it is
still open. Such a failure is remembered while that goal is open (the strongly connected components
of Tarjan 1972, as in tabled logic programs).
"""

from __future__ import annotations

from collections.abc import Iterator
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field

from .goal import Answer, Goal, Offer
from .goals import Goals

_FREE = 1 << 62
"""The depth of a failure that depends on no goal above."""


@dataclass(slots=True, eq=False)
class _Frame:
    goal: Goal
    answers: Iterator[Answer]
    answer: Answer | None = None
    lowest: int = _FREE
    """Depth of the highest goal in progress on which the failures so far depend."""
    failures: list[Goal] = field(default_factory=list)
    """Goals that failed below this one, depending on goals in progress."""


class FastSearch:
    """Answers goals one after another, and keeps the answers for the next. ``blocked`` goals have
    no answer.

    Law (tests/laws): the same answers as the definition's. Cost: one look at each answer for each
    goal that gets an answer while it is open, in practice one look; no recursion.
    """

    def __init__(self, goals: Goals, blocked: AbstractSet[Goal] = frozenset()) -> None:
        self.goals = goals
        self.chosen: dict[Goal, Answer] = {}
        self._failed: set[Goal] = set(blocked)
        self._tentative: dict[Goal, int] = {}
        self._depths: dict[Goal, int] = {}
        self._stack: list[_Frame] = []

    def solve(self, goal: Goal) -> bool:
        """Answer ``goal``: `chosen` then has it with all its needs. False: it has no answer."""
        if goal in self.chosen:
            return True
        if goal in self._failed:
            return False
        self._push(goal)
        while self._stack:
            self._step(self._stack[-1])
        return goal in self.chosen

    def _push(self, goal: Goal) -> None:
        self._depths[goal] = len(self._stack)
        self._stack.append(_Frame(goal, self.goals.answers(goal)))

    def _step(self, frame: _Frame) -> None:
        """Look at the next need of the topmost goal."""
        if frame.answer is None:
            frame.answer = next(frame.answers, None)
            if frame.answer is None:
                self._fail(frame)
                return
        needs = () if isinstance(frame.answer, Offer) else frame.answer.needs
        for need in needs:
            if need in self.chosen:
                continue
            depends = self._dependence(need)
            if depends is None:
                self._push(need)
                return
            # The need has failed, or stands on this path already, so the answer is of no use.
            frame.lowest = min(frame.lowest, depends)
            frame.answer = None
            return
        self._succeed(frame)

    def _dependence(self, need: Goal) -> int | None:
        """The depth that a failure of ``need`` depends on; None: it was not tried yet."""
        if need in self._failed:
            return _FREE
        return self._depths.get(need, self._tentative.get(need))

    def _pop(self) -> _Frame:
        frame = self._stack.pop()
        del self._depths[frame.goal]
        return frame

    def _succeed(self, frame: _Frame) -> None:
        assert frame.answer is not None
        self._pop()
        self.chosen[frame.goal] = frame.answer
        # Goals that failed because this goal was open may have an answer now.
        for goal in frame.failures:
            self._tentative.pop(goal, None)

    def _fail(self, frame: _Frame) -> None:
        depth = self._depths[frame.goal]
        self._pop()
        if frame.lowest >= depth:
            # It depends on itself at most: no goal of this component has an answer.
            self._failed.add(frame.goal)
            self._failed.update(frame.failures)
            for goal in frame.failures:
                self._tentative.pop(goal, None)
            return
        above = self._stack[-1]
        # Depths of closed goals no longer count: all now depend on the same goal as this one.
        self._tentative[frame.goal] = frame.lowest
        for goal in frame.failures:
            self._tentative[goal] = min(self._tentative[goal], frame.lowest)
        above.failures += (*frame.failures, frame.goal)
        above.lowest = min(above.lowest, frame.lowest)
