"""Subscriptions to a stream under a policy, also into its past ([DyKnow10 Def. 4.8, 5.35])."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from ...languages.kpl import format_policy, parse_policy
from ...streams.generator import StreamGenerator
from ...streams.policies.policy import Policy
from ...streams.sample import Schema
from ..configuration.configuration import POLICY, Configuration
from ..configuration.policy_keys import policy_keys
from ..model.beginning import Beginning, check_retained, resolve_duration
from ..model.errors import UnknownRequest
from ..model.views import AdaptiveView, Since, SubscriptionView
from ..units.merge import object_fields
from ..units.policy import AdaptationUnit, counts_of
from .adaptive_subscription import AdaptiveSubscription, Rematch, Wish
from .rematching import Rematching


@dataclass(frozen=True, slots=True, eq=False)
class _Subscription:
    id: str
    source: StreamGenerator
    policy: Policy
    since: Beginning
    unit: AdaptationUnit | None


class Subscriptions:
    """The subscriptions that run, to streams and to features. Equal ones to a stream share one
    adapted stream.

    A subscription without constraints is to the stream as it is.
    """

    def __init__(self, configuration: Configuration) -> None:
        self._configuration = configuration
        self._rematching: Rematching
        self._subscriptions: dict[str, _Subscription | AdaptiveSubscription] = {}
        self._number = 0

    def rematch_with(self, rematching: Rematching) -> None:
        """Who looks after the adaptive ones."""
        self._rematching = rematching

    def start(
        self,
        stream: str,
        policy: str,
        unit: str = "ms",
        since: Beginning = Since.NOW,
        *,
        keyed: bool = True,
    ) -> SubscriptionView:
        """Subscribe; ``policy`` is text as after ``with`` in KPL, integers in ``unit``. Unless it
        is not ``keyed``, it holds for each object by itself where `policy_keys` says so.

        With ``Since.START`` it begins with the kept history, as if it had always been there, and
        with a `Moment` there. Raises `UnknownStream`, `LanguageError` and `Forgotten`.
        """
        source = self._configuration.stream(stream)
        since = resolve_duration(since, [source.stream])
        parsed = parse_policy(policy, unit)
        check_retained(since, source.stream)
        keys = policy_keys(self._configuration, source) if keyed else ()
        adapted = None if parsed.is_default else self._adapted(source, parsed, since, keys)
        id = self._next_id()
        self._subscriptions[id] = _Subscription(id, source, parsed, since, adapted)
        return self.view(id)

    def start_adaptive(self, wish: Wish) -> SubscriptionView:
        """Subscribe to a feature ([Introspection15 §4.4]); what cannot be met now waits."""
        id = f"subscription{self._number + 1}"
        self._subscriptions[id] = self._rematching.start(id, wish)
        # What was refused leaves no number used: another version may not refuse it.
        self._number += 1
        return self.view(id)

    def adapted(self, source: StreamGenerator, wish: Wish) -> AdaptationUnit | None:
        """What keeps the policy of a wish, if it has one."""
        policy = wish.policy
        if policy.is_default:
            return None
        keys = object_fields(1 + len(wish.want.others)) if wish.is_keyed else ()
        return self._adapted(source, policy, Since.START, keys)

    def rematches(self, id: str) -> Sequence[Rematch]:
        """The switches of an adaptive subscription, oldest first; none of another."""
        found = self._get(id)
        return found.rematches if isinstance(found, AdaptiveSubscription) else ()

    def _next_id(self) -> str:
        self._number += 1
        return f"subscription{self._number}"

    @property
    def number(self) -> int:
        """That of the latest subscription, whether it runs or not."""
        return self._number

    def number_after(self, number: int) -> None:
        """The next subscription has a number after this one, and after those there are."""
        self._number = max(self._number, number)

    def cancel(self, id: str) -> None:
        """Give a subscription up; raises `UnknownRequest`."""
        subscription = self._get(id)
        del self._subscriptions[id]
        if isinstance(subscription, AdaptiveSubscription):
            self._rematching.cancel(id)
            return
        unit = subscription.unit
        if unit is not None and self._configuration.units.get(unit.output.name) is unit:
            self._configuration.release(unit)

    def __len__(self) -> int:
        """How many subscriptions run."""
        return len(self._subscriptions)

    def views(self) -> tuple[SubscriptionView, ...]:
        """The subscriptions that run, oldest first."""
        return tuple(map(self.view, self.ids()))

    def ids(self) -> tuple[str, ...]:
        """Those of the subscriptions that run, oldest first."""
        return tuple(self._subscriptions)

    def of_stream(self, stream: str) -> tuple[str, ...]:
        """The ids of the subscriptions whose samples come on a stream, which they read as it is
        or which was made for them."""
        return tuple(
            id for id, found in self._subscriptions.items() if stream in _streams_of(found)
        )

    def view(self, id: str) -> SubscriptionView:
        """One subscription; raises `UnknownRequest`."""
        found = self._get(id)
        if isinstance(found, AdaptiveSubscription):
            return replace(
                _adaptive_view(found), failure=self._configuration.failure_of(found.unit)
            )
        unit = found.unit
        counters: dict[str, object] = {}
        violations = None
        if unit is not None:
            counters = counts_of(unit)
            violations = None if unit.violations is None else unit.violations.name
        last = unit or self._configuration.units.get(found.source.name)
        return SubscriptionView(
            id=id,
            source=found.source.name,
            policy=format_policy(found.policy),
            since=str(found.since),
            stream=found.source.name if unit is None else unit.output.name,
            counters=counters,
            violations=violations,
            failure=None if last is None else self._configuration.failure_of(last),
        )

    def _get(self, id: str) -> _Subscription | AdaptiveSubscription:
        found = self._subscriptions.get(id)
        if found is None:
            raise UnknownRequest(
                f"there is no subscription {id!r}", "GET /subscriptions lists those that run"
            )
        return found

    def _adapted(
        self, source: StreamGenerator, policy: Policy, since: Beginning, keys: Sequence[str]
    ) -> AdaptationUnit:
        """The unit that keeps a policy, shared, with one user more."""
        made = self.obtain(source, policy, since, keys)
        made.users += 1
        return made

    def obtain(
        self, source: StreamGenerator, policy: Policy, since: Beginning, keys: Sequence[str]
    ) -> AdaptationUnit:
        """The unit that keeps a policy, found or built; its user is still to be counted."""
        key = (source, policy, tuple(keys), since)
        made = self._configuration.share(key, lambda: self._build(source, policy, since, keys))
        assert isinstance(made, AdaptationUnit)
        return made

    def _build(
        self, source: StreamGenerator, policy: Policy, since: Beginning, keys: Sequence[str]
    ) -> AdaptationUnit:
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
            keys=keys,
            violations=self._configuration.violations(name, source.stream.retention),
        )
        self._configuration.start(unit, since, text)
        return unit


def _streams_of(found: _Subscription | AdaptiveSubscription) -> tuple[str, ...]:
    if isinstance(found, AdaptiveSubscription):
        return found.unit.output.name, found.output.name
    return (found.source.name if found.unit is None else found.unit.output.name,)


def _adaptive_view(found: AdaptiveSubscription) -> SubscriptionView:
    wish, adapted = found.wish, found.adapted
    violations = None if adapted is None or adapted.violations is None else adapted.violations.name
    return SubscriptionView(
        id=found.id,
        source=found.unit.output.name,
        policy=format_policy(wish.policy),
        since=str(wish.since),
        stream=found.output.name,
        counters={} if adapted is None else counts_of(adapted),
        violations=violations,
        adaptive=AdaptiveView(
            want=str(wish.want),
            strategy=wish.strategy,
            state=str(found.state),
            failure=found.unit.failure,
            reads=found.leaves,
            missing=found.missing,
            staleness=wish.staleness,
            quality=wish.quality,
            hold_off=wish.hold_off,
            rematches=len(found.rematches),
        ),
    )
