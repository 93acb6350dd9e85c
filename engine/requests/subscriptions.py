"""Subscriptions to streams under policies, history included ([DyKnow10 Def. 4.8, 5.35])."""

from __future__ import annotations

from collections.abc import Iterator, Sequence, Set
from dataclasses import dataclass, replace

from ...languages.kpl import format_policy, parse_policy
from ...rdf.namespaces import shorten
from ...streams.generator import StreamGenerator
from ...streams.policies.policy import Policy
from ...streams.sample import Schema
from ..configuration.configuration import POLICY, Configuration
from ..configuration.policy_keys import policy_keys
from ..model.beginning import Beginning, check_retained, resolve_duration
from ..model.errors import UnknownRequest
from ..model.graph import Node, NodeKind
from ..model.named_terms import names_any
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
    """The running subscriptions to streams and to features. Equal subscriptions to a stream share
    one adapted stream; one without constraints reads the stream itself.
    """

    def __init__(self, configuration: Configuration) -> None:
        self._configuration = configuration
        self._rematching: Rematching
        """Set by `rematch_with`: `Rematching` needs `adapt`, so it is created later."""
        self._subscriptions: dict[str, _Subscription | AdaptiveSubscription] = {}
        self._number = 0

    def rematch_with(self, rematching: Rematching) -> None:
        """Set the owner of the adaptive subscriptions."""
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
        """Subscribe to a stream.

        ``policy`` is text as after ``with`` in KPL, with integers in ``unit``. ``keyed``: it
        applies to each object separately, by the keys of `policy_keys`. With ``Since.START`` the
        subscription begins with the kept history, with a `Moment` at that time. Raises
        `UnknownStream`, `LanguageError` and `Forgotten`.
        """
        source = self._configuration.stream(stream)
        since = resolve_duration(since, [source.stream])
        parsed = parse_policy(policy, unit)
        check_retained(since, source.stream)
        keys = policy_keys(self._configuration, source) if keyed else ()
        unit_of_policy = (
            None if parsed.is_default else self._obtain_for_user(source, parsed, since, keys)
        )
        self._number += 1
        id = f"subscription{self._number}"
        self._subscriptions[id] = _Subscription(id, source, parsed, since, unit_of_policy)
        return self.view(id)

    def start_adaptive(self, wish: Wish) -> SubscriptionView:
        """Subscribe to a feature ([Introspection15 §4.4]); without a plan it waits for one."""
        id = f"subscription{self._number + 1}"
        self._subscriptions[id] = self._rematching.start(id, wish)
        # A refused subscription uses no number: a replay by another version may not refuse it, and
        # the numbers of later subscriptions must not depend on that.
        self._number += 1
        return self.view(id)

    def adapt(self, source: StreamGenerator, wish: Wish) -> AdaptationUnit | None:
        """Start the unit that applies the policy of a wish; None if it has no constraint."""
        policy = wish.policy
        if policy.is_default:
            return None
        keys = object_fields(1 + len(wish.want.others)) if wish.is_keyed else ()
        return self._obtain_for_user(source, policy, Since.START, keys)

    def rematches(self, id: str) -> Sequence[Rematch]:
        """The switches of an adaptive subscription, oldest first; empty for another one."""
        subscription = self._get(id)
        return subscription.rematches if isinstance(subscription, AdaptiveSubscription) else ()

    @property
    def number(self) -> int:
        """The number of the latest subscription, whether it runs or not."""
        return self._number

    def number_after(self, number: int) -> None:
        """Let the next subscription have a number greater than this one and the present ones."""
        self._number = max(self._number, number)

    def cancel(self, id: str) -> None:
        """Cancel a subscription. Raises `UnknownRequest`."""
        subscription = self._get(id)
        del self._subscriptions[id]
        if isinstance(subscription, AdaptiveSubscription):
            self._rematching.cancel(id)
            return
        unit = subscription.unit
        if unit is not None and self._configuration.units.get(unit.output.name) is unit:
            self._configuration.release(unit)

    def __len__(self) -> int:
        """The number of running subscriptions."""
        return len(self._subscriptions)

    def views(self) -> tuple[SubscriptionView, ...]:
        """The running subscriptions, oldest first."""
        return tuple(map(self.view, self.ids()))

    def ids(self) -> tuple[str, ...]:
        """The ids of the running subscriptions, oldest first."""
        return tuple(self._subscriptions)

    def naming(self, terms: Set[str]) -> tuple[str, ...]:
        """The ids of the subscriptions to a feature that want one of ``terms``."""
        return tuple(
            id
            for id, one in self._subscriptions.items()
            if isinstance(one, AdaptiveSubscription) and names_any(one.wish.want, terms)
        )

    def of_stream(self, stream: str) -> tuple[str, ...]:
        """The ids of the subscriptions whose samples are those of ``stream``: they read it without
        constraints, or it was unit for them."""
        return tuple(
            id
            for id, subscription in self._subscriptions.items()
            if stream in _streams_of(subscription)
        )

    def nodes(self) -> Iterator[tuple[Node, str]]:
        """Yield the node of each subscription, and the stream that has its samples."""
        for id in self._subscriptions:
            view = self.view(id)
            state, text = view.state, f"{view.source} {view.policy}".rstrip()
            if view.adaptive is not None:
                state, text = view.adaptive.state, view.adaptive.want
            yield Node(NodeKind.SUBSCRIPTION, id, text, state), view.stream

    def view(self, id: str) -> SubscriptionView:
        """The view of a subscription. Raises `UnknownRequest`."""
        subscription = self._get(id)
        if isinstance(subscription, AdaptiveSubscription):
            state, failure = self._configuration.state_of(subscription.unit, subscription.output)
            return replace(_adaptive_view(subscription), state=state, failure=failure)
        unit = subscription.unit
        counters: dict[str, object] = {}
        violations = None
        if unit is not None:
            counters = counts_of(unit)
            violations = None if unit.violations is None else unit.violations.name
        last = unit or self._configuration.units.get(subscription.source.name)
        answer = subscription.source if unit is None else unit.output
        state, failure = self._configuration.state_of(last, answer)
        return SubscriptionView(
            id=id,
            source=subscription.source.name,
            policy=format_policy(subscription.policy),
            since=str(subscription.since),
            stream=answer.name,
            counters=counters,
            violations=violations,
            state=state,
            failure=failure,
        )

    def _get(self, id: str) -> _Subscription | AdaptiveSubscription:
        subscription = self._subscriptions.get(id)
        if subscription is None:
            raise UnknownRequest(
                f"there is no subscription {id!r}", "GET /subscriptions lists those that run"
            )
        return subscription

    def _obtain_for_user(
        self, source: StreamGenerator, policy: Policy, since: Beginning, keys: Sequence[str]
    ) -> AdaptationUnit:
        """Return the unit that applies a policy, shared, and add a user to it."""
        unit = self.obtain(source, policy, since, keys)
        unit.users += 1
        return unit

    def obtain(
        self, source: StreamGenerator, policy: Policy, since: Beginning, keys: Sequence[str]
    ) -> AdaptationUnit:
        """Return the unit that applies a policy, and start it if needed. The caller adds the
        user."""
        key = (source, policy, tuple(keys), since)
        unit = self._configuration.share(key, lambda: self._build(source, policy, since, keys))
        assert isinstance(unit, AdaptationUnit)
        return unit

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


def _streams_of(subscription: _Subscription | AdaptiveSubscription) -> tuple[str, ...]:
    if isinstance(subscription, AdaptiveSubscription):
        return subscription.unit.output.name, subscription.output.name
    return (
        subscription.source.name if subscription.unit is None else subscription.unit.output.name,
    )


def _adaptive_view(subscription: AdaptiveSubscription) -> SubscriptionView:
    wish, adapted = subscription.wish, subscription.adaptation
    violations = None if adapted is None or adapted.violations is None else adapted.violations.name
    want = wish.want
    objects = (want.object, *(each.object for each in want.others))
    return SubscriptionView(
        id=subscription.id,
        source=subscription.unit.output.name,
        policy=format_policy(wish.policy),
        since=str(wish.since),
        stream=subscription.output.name,
        counters={} if adapted is None else counts_of(adapted),
        violations=violations,
        adaptive=AdaptiveView(
            want=str(want),
            feature=shorten(want.feature),
            sort=None if want.sort is None else shorten(want.sort),
            objects=tuple(shorten(each) for each in objects if each is not None),
            strategy=wish.strategy,
            state=str(subscription.state),
            failure=subscription.unit.failure,
            reads=subscription.source_names,
            missing=subscription.missing,
            staleness=wish.staleness,
            quality=wish.quality,
            hold_off=wish.hold_off,
            rematches=len(subscription.rematches),
        ),
    )
