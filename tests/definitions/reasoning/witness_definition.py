"""The definition of witnesses: the state at which a part decides a verdict. Slow on purpose."""

from __future__ import annotations

from progression_definition import END, Progression, bound

from dyknow.languages.mtl.ast import Temporal
from dyknow.languages.mtl.checked import (
    And,
    Atom,
    Not,
    Or,
    Previous,
    Quantified,
    Truth,
    Until,
    Within,
)

NEVER = 2**62


class Witness:
    """Witnesses over a trace."""

    def __init__(self, progression: Progression) -> None:
        self.progression = progression
        self.known: dict = {}

    def moment(self, f, i: int, want: bool) -> int:
        """The state at which progression makes f true at state i (or false)."""
        if (f, i) not in self.known:
            self.known[f, i] = self.progression.verdict(f, i)
        verdict = self.known[f, i]
        return verdict[1] if verdict is not None and verdict[0] == want else NEVER

    def of(self, f, i: int, want: bool) -> int | None:
        """The state that bears witness to f being true (or false) at state i."""
        match f:
            case Truth() | Atom():
                return i
            case Not(g):
                return self.of(g, i, not want)
            case And(g, h) | Or(g, h):
                a, b = self.moment(g, i, want), self.moment(h, i, want)
                decides_alone = isinstance(f, Or) is want
                return self.of(g if (a <= b if decides_alone else a >= b) else h, i, want)
            case Previous(g):
                return self.of(g, i - 1, want) if i else None
            case Within(operator, interval, g):
                if (operator in (Temporal.EVENTUALLY, Temporal.ONCE)) is not want:
                    return None
                inside = self.interval(i, interval, operator.is_past)
                by = self.moment(f, i, want)
                return next((j for j in inside if self.moment(g, j, want) <= by < NEVER), None)
            case Until(is_past, interval, g, h):
                inside = self.interval(i, interval, is_past)
                found = self.until(f, i, inside, want)
                state = self.first(found)
                if state is None or want:
                    return state
                # Without this state: g is false throughout, and no more of it comes.
                over = [-1 if is_past else self.closed(i, interval)]
                over += [self.moment(h, j, False) for j in inside]
                return state if found[state] < max(over) else None
            case Quantified(is_universal, variable, sort, g):
                if is_universal is want:
                    return None
                parts = [bound(g, variable, iri) for iri in self.progression.trace.present[i][sort]]
                least = min((self.moment(part, i, want) for part in parts), default=NEVER)
                first = [part for part in parts if self.moment(part, i, want) == least < NEVER]
                states = {self.of(part, i, want) for part in first} - {None}
                return min(states, default=None)
        raise TypeError(f)

    def until(self, f: Until, i: int, inside: list[int], want: bool) -> dict[int, int]:
        """When each state up to the end of the interval decides, in order from the start on."""
        g, h, valid = f.left, f.right, self.progression.trace.valid
        walk = range(i, -1, -1) if f.is_past else range(i, len(valid))
        end = f.interval.end
        walk = [j for j in walk if end is None or abs(valid[j] - valid[i]) <= end]
        found = {}
        for place, j in enumerate(walk):
            before = walk[:place]
            if want and j in inside:
                held = [self.moment(g, k, True) for k in before]
                found[j] = max([self.moment(h, j, True), *held])
            if not want:
                ruled_out = [self.moment(h, k, False) for k in [*before, j] if k in inside]
                found[j] = max([self.moment(g, j, False), *ruled_out])
        return found

    def closed(self, i: int, interval) -> int:
        """From which state on no later state is in the interval; the end comes after all states."""
        trace = self.progression.trace
        if interval.end is None:
            return NEVER
        known = trace.valid[i] + interval.end
        later = range(i, len(trace.valid))
        return next((k for k in later if known <= trace.horizon[k] < END), NEVER)

    def first(self, moments: dict[int, int]) -> int | None:
        """The state with the least moment; of several the first."""
        least = min(moments.values(), default=NEVER)
        return None if least >= NEVER else next(j for j, m in moments.items() if m == least)

    def interval(self, i: int, interval, is_past: bool) -> list[int]:
        valid = self.progression.trace.valid
        if is_past:
            return self.progression.past(i, interval)
        end = interval.end
        return [
            j
            for j in range(i, len(valid))
            if valid[j] - valid[i] >= interval.start and (end is None or valid[j] - valid[i] <= end)
        ]
