"""Subscriptions to a stream under a policy, also into its past ([DyKnow10 Def. 4.8, 5.35])."""

from __future__ import annotations

from dataclasses import dataclass

from ..languages.kpl import format_policy, parse_policy
from ..streams.generator import StreamGenerator
from ..streams.policy import Policy
from ..streams.sample import Schema
from .configuration import POLICY, Configuration
from .errors import UnknownRequest
from .stream_units import AdaptationUnit, counts_of
from .views import Since, SubscriptionView


@dataclass(frozen=True, slots=True, eq=False)
class _Subscription:
    id: str
    source: StreamGenerator
    policy: Policy
    since: Since
    unit: AdaptationUnit | None


class Subscriptions:
    """The subscriptions that run. Equal ones share one adapted stream.

    A subscription without constraints is to the stream as it is.
    """

    def __init__(self, configuration: Configuration) -> None:
        self._configuration = configuration
        self._subscriptions: dict[str, _Subscription] = {}
        self._number = 0

    def start(
        self, stream: str, policy: str, unit: str = "ms", since: Since = Since.NOW
    ) -> SubscriptionView:
        """Subscribe; ``policy`` is text as after ``with`` in KPL, integers in ``unit``.

        With ``Since.START`` it begins with the kept history, as if it had always been there. Raises
        `UnknownStream` and `LanguageError`.
        """
        source = self._configuration.stream(stream)
        parsed = parse_policy(policy, unit)
        adapted = None
        if not parsed.is_default:
            made = self._configuration.share(
                (source, parsed, since), lambda: self._build(source, parsed, since)
            )
            assert isinstance(made, AdaptationUnit)
            made.users += 1
            adapted = made
        self._number += 1
        id = f"subscription{self._number}"
        self._subscriptions[id] = _Subscription(id, source, parsed, since, adapted)
        return self.view(id)

    def cancel(self, id: str) -> None:
        """Give a subscription up; raises `UnknownRequest`."""
        subscription = self._get(id)
        del self._subscriptions[id]
        unit = subscription.unit
        if unit is not None and self._configuration.units.get(unit.output.name) is unit:
            self._configuration.release(unit)

    def views(self) -> tuple[SubscriptionView, ...]:
        """The subscriptions that run, oldest first."""
        return tuple(self.view(id) for id in self._subscriptions)

    def view(self, id: str) -> SubscriptionView:
        """One subscription; raises `UnknownRequest`."""
        found = self._get(id)
        unit = found.unit
        counters: dict[str, object] = {}
        violations = None
        if unit is not None:
            counters = counts_of(unit)
            violations = None if unit.violations is None else unit.violations.name
        return SubscriptionView(
            id=id,
            source=found.source.name,
            policy=format_policy(found.policy),
            since=str(found.since),
            stream=found.source.name if unit is None else unit.output.name,
            counters=counters,
            violations=violations,
        )

    def _get(self, id: str) -> _Subscription:
        found = self._subscriptions.get(id)
        if found is None:
            raise UnknownRequest(
                f"there is no subscription {id!r}", "GET /subscriptions lists those that run"
            )
        return found

    def _build(self, source: StreamGenerator, policy: Policy, since: Since) -> AdaptationUnit:
        name = self._configuration.reserved_name()
        output = self._configuration.add_stream(
            name,
            Schema(()) if source.is_open else source.schema,
            retention=source.stream.retention,
            namespace=self._configuration.namespaces[source.name],
            pools=source.stream.pools,
        )

        text = f"{source.name} with {format_policy(policy)}"
        unit = AdaptationUnit(
            *self._configuration.identity(POLICY, [source], output, {"term": text}),
            policy=policy,
            violations=self._configuration.violations(name, source.stream.retention),
        )
        self._configuration.start(unit, since, text)
        return unit
