"""The users of a unit: requests, queries, subscriptions and KPL declarations."""

from __future__ import annotations

from .kpl.declarations import KplDeclarations
from .requests.continuous_queries import RegisteredQueries
from .requests.event_requests import EventRequests
from .requests.subscriptions import Subscriptions


class Users:
    """Finds the users of a unit or a stream, for messages that name them."""

    def __init__(
        self,
        requests: EventRequests,
        queries: RegisteredQueries,
        subscriptions: Subscriptions,
        kpl: KplDeclarations,
    ) -> None:
        self._requests = requests
        self._queries = queries
        self._subscriptions = subscriptions
        self._kpl = kpl

    def __call__(self, unit: str, stream: str) -> tuple[str, ...]:
        """Return the KPL declarations that run ``unit``, and the requests, queries and
        subscriptions whose samples are those of ``stream``. Either argument may be empty."""
        answered = (*self._requests.of_stream(stream), *self._queries.of_stream(stream))
        subscribed = self._subscriptions.of_stream(stream)
        views = self._kpl.views() if unit else ()
        declared = (view.name for view in views if view.unit == unit)
        return (*answered, *subscribed, *(f"`{name}` of KPL" for name in declared))
