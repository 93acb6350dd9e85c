"""The users of a unit or of terms: requests, queries, subscriptions, KPL and so on."""

from __future__ import annotations

from collections.abc import Iterator, Set

from ..languages.ssl.annotation import StreamAnnotation
from .catalog.annotations import Annotations
from .kpl.declarations import KplDeclarations
from .model.named_terms import names_any
from .requests.continuous_queries import RegisteredQueries
from .requests.event_requests import EventRequests
from .requests.event_templates import EventTemplates
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


class TermUsers:
    """Finds what names terms of the ontology, for messages that refuse to remove them."""

    def __init__(
        self,
        annotations: Annotations,
        templates: EventTemplates,
        requests: EventRequests,
        queries: RegisteredQueries,
        subscriptions: Subscriptions,
        kpl: KplDeclarations,
    ) -> None:
        self._annotations = annotations
        self._templates = templates
        self._requests = requests
        self._queries = queries
        self._subscriptions = subscriptions
        self._kpl = kpl

    def __call__(self, terms: Set[str]) -> tuple[str, ...]:
        """Return the users of ``terms``, the IRIs of terms and graphs. Requests use the terms of
        their template too. Cost: linear in all texts."""
        return tuple(self._find(terms))

    def _find(self, terms: Set[str]) -> Iterator[str]:
        for annotation in self._annotations.all():
            if names_any(annotation, terms):
                if isinstance(annotation, StreamAnnotation):
                    yield f"the annotation of stream {annotation.stream}"
                else:
                    yield f"transformation {annotation.name}"
        templates = self._templates.naming(terms)
        yield from (f"template {name}" for name in templates.values())
        yield from (f"request {id}" for id in self._requests.naming({*terms, *templates}))
        yield from (f"query {name}" for name in self._queries.naming(terms))
        yield from (f"subscription {id}" for id in self._subscriptions.naming(terms))
        for declaration in self._kpl.signature.declarations:
            if names_any(declaration, terms):
                yield f"`{declaration.key}` of KPL"
