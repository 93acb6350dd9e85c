"""Registered queries that share one computation (DESIGN §3 "Sharing"): they read the same streams
in the same windows and differ in constants only (`continuous.sharing.similar_queries`).

Sharing begins when there are enough such queries; more are needed where the shared computation is
estimated to cost more. Constants on which the queries agree stay constants of the shared plan: a
plan with more parameters would cost more, for queries that may never be registered.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field

from ...continuous.algebra.constant_lifting import Pattern, generalize, match_constants
from ...continuous.sharing.similar_queries import Form, Unshared
from ...rdf.dictionary import Term
from ..units.base import ComputationalUnit
from ..units.sharing.shared_query import TemplateUnit

MIN_SHARED = 4
"""The number of queries that differ in constants from which on they are evaluated as one."""


@dataclass(frozen=True, slots=True)
class FormInstance:
    """A query as its inputs (``streams``), its ``form`` and the ``constants`` taken out of it."""

    streams: Hashable
    form: Form
    constants: tuple[Term, ...]

    @property
    def key(self) -> Hashable:
        """Equal for queries that differ in constants only."""
        return self.streams, self.form


@dataclass(slots=True)
class _FormQueries:
    """Queries with one key: the constants of those evaluated ``alone``, by name, and the patterns
    of the ``shared`` computations."""

    alone: dict[str, tuple[Term, ...]] = field(default_factory=dict)
    shared: list[Pattern] = field(default_factory=list)
    break_even: dict[Pattern, int] = field(default_factory=dict)
    """The number of queries from which on sharing a pattern is cheaper."""


class QuerySharing:
    """Decides which computation a registered query shares, and counts the queries that share none.
    ``running`` returns the unit of a key, if there is one.
    """

    def __init__(self, running: Callable[[Hashable], ComputationalUnit | None]) -> None:
        self._running = running
        self._by_key: dict[Hashable, _FormQueries] = {}

    def pattern(self, instance: FormInstance, break_even: Callable[[Pattern], int]) -> Pattern:
        """Return the pattern of the shared computation for a query; raise `Unshared`, with the
        reason, if it has to be evaluated alone. ``break_even`` estimates the number of queries from
        which on sharing a pattern is cheaper. Cost: O(queries evaluated alone), and once a plan."""
        queries = self._by_key.get(instance.key, _FormQueries())
        queries.shared = [one for one in queries.shared if self._runs(instance, one)]
        for pattern in queries.shared:
            if match_constants(pattern, instance.constants) is not None:
                unit = self._running(shared_key(instance, pattern))
                if isinstance(unit, TemplateUnit) and not unit.accepts_timely_samples:
                    # A member that joined now would miss the windows that are closed already.
                    raise Unshared("the shared windows have closed further than its streams are")
                return pattern
        if len(queries.alone) + 1 < MIN_SHARED:
            raise Unshared(
                f"fewer than {MIN_SHARED} queries of its form ran when it was registered"
            )
        pattern = generalize([*queries.alone.values(), instance.constants])
        if pattern not in queries.break_even:
            queries.break_even = {pattern: break_even(pattern)}
        least = queries.break_even[pattern]
        if len(queries.alone) + 1 < least:
            raise Unshared(f"sharing is estimated to cost as much as {least} separate queries")
        queries.shared.append(pattern)
        self._by_key[instance.key] = queries
        return pattern

    def add_alone(self, name: str, instance: FormInstance) -> None:
        """Record a query that is evaluated alone."""
        self._by_key.setdefault(instance.key, _FormQueries()).alone[name] = instance.constants

    def remove(self, name: str, instance: FormInstance) -> None:
        """Forget a query that has ended."""
        queries = self._by_key.get(instance.key)
        if queries is None:
            return
        queries.alone.pop(name, None)
        if not queries.alone and not any(
            self._runs(instance, pattern) for pattern in queries.shared
        ):
            del self._by_key[instance.key]

    def _runs(self, instance: FormInstance, pattern: Pattern) -> bool:
        return self._running(shared_key(instance, pattern)) is not None


def shared_key(instance: FormInstance, pattern: Pattern) -> Hashable:
    """Return the key of the unit that evaluates the queries of a pattern."""
    return instance.key, pattern
