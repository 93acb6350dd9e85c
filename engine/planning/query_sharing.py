"""Which registered queries one query can serve (DESIGN §3 "Sharing"): those that read the same
streams in the same windows and differ in constants only (`continuous.sharing.similar_queries`).

It is worth while from some of them on: from more than usual, where what is computed for all is
likely to cost more. What is shared then is what those had in common that are evaluated alone: the
constants on which they agreed stay in the plan, so that it does not grow for the sake of queries
that nobody registers.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field

from ...continuous.algebra.constant_lifting import Pattern, generalize, match_constants
from ...continuous.sharing.similar_queries import Form, Unshared
from ...rdf.dictionary import Term
from ..units.base import ComputationalUnit
from ..units.shared_query import TemplateUnit

ALIKE = 4
"""So many queries that differ in constants are evaluated as one."""


@dataclass(frozen=True, slots=True)
class Kin:
    """A query as one of its kind: ``streams`` says what is read, and what of it, ``form`` what the
    query is but for its ``constants``."""

    streams: Hashable
    form: Form
    constants: tuple[Term, ...]

    @property
    def key(self) -> Hashable:
        """What the whole kind has in common."""
        return self.streams, self.form


@dataclass(slots=True)
class _Kind:
    """The queries of a kind: the constants of those that are evaluated ``alone``, by name, and what
    others have ``shared``."""

    alone: dict[str, tuple[Term, ...]] = field(default_factory=dict)
    shared: list[Pattern] = field(default_factory=list)
    worth: dict[Pattern, int] = field(default_factory=dict)
    """From how many queries on it is worth while to share a pattern."""


class Alikes:
    """Says of a registered query with whom it shares, and remembers those who do not yet.

    ``running`` gives the unit for a key, if there is one.
    """

    def __init__(self, running: Callable[[Hashable], ComputationalUnit | None]) -> None:
        self._running = running
        self._kinds: dict[Hashable, _Kind] = {}

    def pattern(self, kin: Kin, break_even_count: Callable[[Pattern], int]) -> Pattern:
        """What the query has in common with those that it shares with; raises `Unshared` where it
        is evaluated alone. ``break_even_count`` returns how many queries cost what a shared plan
        does. Cost: O(queries that are alone), and that of planning what is to be shared first."""
        kind = self._kinds.get(kin.key, _Kind())
        kind.shared = [one for one in kind.shared if self._runs(kin, one)]
        for pattern in kind.shared:
            if match_constants(pattern, kin.constants) is not None:
                unit = self._running(shared_key(kin, pattern))
                if isinstance(unit, TemplateUnit) and not unit.accepts_timely_samples:
                    raise Unshared("others have closed windows for which its streams are in time")
                return pattern
        if len(kind.alone) + 1 < ALIKE:
            raise Unshared(f"it came before there were {ALIKE} that differ in constants")
        pattern = generalize([*kind.alone.values(), kin.constants])
        if pattern not in kind.worth:
            kind.worth = {pattern: break_even_count(pattern)}
        least = kind.worth[pattern]
        if len(kind.alone) + 1 < least:
            raise Unshared(f"together they are likely to cost what {least} cost by themselves")
        kind.shared.append(pattern)
        self._kinds[kin.key] = kind
        return pattern

    def began_alone(self, name: str, kin: Kin) -> None:
        """A query has windows of its own."""
        self._kinds.setdefault(kin.key, _Kind()).alone[name] = kin.constants

    def ended(self, name: str, kin: Kin) -> None:
        """A query has ended."""
        kind = self._kinds.get(kin.key)
        if kind is None:
            return
        kind.alone.pop(name, None)
        if not kind.alone and not any(self._runs(kin, pattern) for pattern in kind.shared):
            del self._kinds[kin.key]

    def _runs(self, kin: Kin, pattern: Pattern) -> bool:
        return self._running(shared_key(kin, pattern)) is not None


def shared_key(kin: Kin, pattern: Pattern) -> Hashable:
    """What the queries have in common that one unit serves."""
    return kin.key, pattern
