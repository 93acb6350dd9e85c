"""Event templates as the engine has them: registered, told to matching, found for requests."""

from __future__ import annotations

from collections.abc import Callable

from ...languages.csparql.ast import EventRequest, Template
from ...matching.space import StreamSpace
from ...ontology.ontology import Ontology
from ...rdf.namespaces import shorten
from ...templates.library import NoSuchTemplate, TemplateExists, TemplateLibrary, TemplateRefused
from ...templates.transformations import event_transformation
from ..catalog.name_resolution import did_you_mean
from ..configuration.configuration import C_SPARQL
from ..model.errors import AlreadyExists, Conflict, Refused, UnknownEvent, UnknownTemplate
from ..model.status_changes import Change, ChangeKind, KnownTransformation
from ..model.views import TemplateView
from .event_requests import EventRequests


class EventTemplates:
    """The library of templates, and the transformations that they are to matching (``space``)."""

    def __init__(
        self,
        ontology: Ontology,
        library: TemplateLibrary,
        requests: EventRequests,
        space: StreamSpace,
        changed: Callable[[Change], None],
    ) -> None:
        self._ontology = ontology
        self._library = library
        self._requests = requests
        self._space = space
        self._changed = changed

    def __len__(self) -> int:
        return len(self._library)

    def register(self, text: str, *, replace: bool) -> TemplateView:
        """Register a template; its event concept is known from now on. Raises `LanguageError`,
        `Refused`, and `AlreadyExists` unless ``replace``."""
        try:
            template = self._library.register(text, replace=replace)
        except TemplateExists as error:
            raise AlreadyExists(
                f"there is a template {shorten(error.name)}", "replace it with PUT, or remove it"
            ) from error
        except TemplateRefused as error:
            raise Refused(error.message, error.hint) from error
        self.tell()
        return self._view(template)

    def remove(self, name: str) -> None:
        """Forget a template; raises `UnknownTemplate`, and `Conflict` while a request uses it."""
        template = self.find(name)
        users = self._requests.of_event(template.name)
        if users:
            raise Conflict(
                f"template {shorten(template.name)} is used by request {', '.join(users)}",
                "cancel the requests first",
            )
        self._library.remove(name)
        self._requests.forget(template)
        self._changed(
            Change(ChangeKind.TRANSFORMATION_REMOVED, transformation=shorten(template.name))
        )

    def views(self) -> tuple[TemplateView, ...]:
        """All templates, by name."""
        return tuple(self.view(name) for name in self._library.names())

    def view(self, name: str) -> TemplateView:
        """One template by local name, prefixed name or IRI; raises `UnknownTemplate`."""
        return self._view(self.find(name))

    def find(self, name: str) -> Template:
        """The template itself; raises `UnknownTemplate`."""
        try:
            return self._library.get(name)
        except NoSuchTemplate as error:
            raise UnknownTemplate(
                f"there is no template {name!r}", did_you_mean(error.suggestions)
            ) from error

    def of(self, request: EventRequest) -> Template:
        """The template of the event that is requested; raises `UnknownEvent`."""
        try:
            return self._library.get(request.event)
        except NoSuchTemplate as error:
            known = ", ".join(shorten(name) for name in self._library.names())
            raise UnknownEvent(
                f"the ontology knows no event {shorten(request.event)} with a template",
                did_you_mean(error.suggestions)
                or (f"there are {known}" if known else "register one with POST /templates"),
            ) from error

    def tell(self) -> None:
        """What the templates take and give, as matching sees it; one may have made known what
        another needs."""
        for name in self._library.names():
            template = self._library.get(name)
            known = event_transformation(
                template, lambda: self._ontology.vocabulary, self._library.needs
            )
            if known != self._space.transformations.get(known.name):
                self._changed(
                    Change(
                        ChangeKind.TRANSFORMATION_ANNOTATED,
                        transformation=known.name,
                        specification=template.source,
                        described=KnownTransformation(known, C_SPARQL),
                    )
                )

    def _view(self, template: Template) -> TemplateView:
        return TemplateView(
            name=template.name,
            local_name=shorten(template.name).removeprefix("dyknow:"),
            parameters=tuple(f"?{parameter.value}" for parameter in template.parameters),
            source=template.source,
            etag=self._library.etag(template.name),
        )
