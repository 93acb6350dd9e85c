"""Event templates: registers them, publishes them to matching, finds them for requests."""

from __future__ import annotations

from collections.abc import Callable, Set

from ...languages.csparql.ast import EventRequest, Template
from ...languages.mtl import FormulaTemplate
from ...languages.templates import AnyTemplate
from ...matching.space import StreamSpace
from ...ontology.ontology import Ontology
from ...rdf.namespaces import shorten
from ...templates.library import NoSuchTemplate, TemplateExists, TemplateLibrary, TemplateRefused
from ...templates.parameters import parameter_uses
from ...templates.reasoning import template_wants
from ...templates.transformations import event_transformation
from ..catalog.name_resolution import did_you_mean
from ..configuration.configuration import C_SPARQL, MTL, PATTERN
from ..model.errors import AlreadyExists, Conflict, Refused, UnknownEvent, UnknownTemplate
from ..model.named_terms import names_any
from ..model.status_changes import Change, ChangeKind, KnownTransformation
from ..model.views import TemplateView
from ..planning.explanations import window_text
from .event_requests import EventRequests


class EventTemplates:
    """The library of templates; to matching (``space``) each is a transformation."""

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
        self._report = changed

    def __len__(self) -> int:
        return len(self._library)

    def register(self, text: str, *, replace: bool) -> TemplateView:
        """Register a template and its event concept. Raises `LanguageError`, `Refused`, and
        `AlreadyExists` unless ``replace``."""
        try:
            template = self._library.register(text, replace=replace)
        except TemplateExists as error:
            raise AlreadyExists(
                f"there is a template {shorten(error.name)}",
                "replace it (dyknow template add --replace NAME, or PUT), or remove it",
            ) from error
        except TemplateRefused as error:
            raise Refused(error.message, error.hint) from error
        self.publish()
        return self._view(template)

    def remove(self, name: str) -> None:
        """Remove a template. Raises `UnknownTemplate`, and `Conflict` while a request uses it."""
        template = self.find(name)
        users = self._requests.of_event(template.name)
        if users:
            raise Conflict(
                f"template {shorten(template.name)} is used by request {', '.join(users)}",
                "cancel the requests first",
            )
        self._library.remove(name)
        self._requests.forget(template)
        self._report(
            Change(ChangeKind.TRANSFORMATION_REMOVED, transformation=shorten(template.name))
        )

    def views(self) -> tuple[TemplateView, ...]:
        """All templates, by name."""
        return tuple(self.view(name) for name in self._library.names())

    def view(self, name: str) -> TemplateView:
        """The view of a template by local name, prefixed name or IRI. Raises `UnknownTemplate`."""
        return self._view(self.find(name))

    def find(self, name: str) -> AnyTemplate:
        """Return a template. Raises `UnknownTemplate`."""
        try:
            return self._library.get(name)
        except NoSuchTemplate as error:
            raise UnknownTemplate(
                f"there is no template {name!r}", did_you_mean(error.suggestions)
            ) from error

    def of(self, request: EventRequest) -> AnyTemplate:
        """Return the template of a request's event. Raises `UnknownEvent`."""
        try:
            return self._library.get(request.event)
        except NoSuchTemplate as error:
            names = ", ".join(shorten(name) for name in self._library.names())
            raise UnknownEvent(
                f"no event {shorten(request.event)} has a template",
                did_you_mean(error.suggestions)
                or (
                    f"there are {names}"
                    if names
                    else "register one: dyknow template add FILE, or POST /templates"
                ),
            ) from error

    def naming(self, terms: Set[str]) -> dict[str, str]:
        """The templates that name one of ``terms``: the IRI of the event, and its short name."""
        library = (self._library.get(name) for name in self._library.names())
        return {
            template.name: shorten(template.name)
            for template in library
            if names_any(self._named(template), terms)
        }

    def _named(self, template: AnyTemplate) -> object:
        """A value with all terms that a template names."""
        if isinstance(template, Template):
            return template.query
        return template_wants(template, self._ontology.vocabulary)

    def publish(self) -> None:
        """Publish the inputs and outputs of all templates to matching. All, since the event concept
        of a new template may be a feature that another one needs."""
        for name in self._library.names():
            template = self._library.get(name)
            transformation = event_transformation(
                template, lambda: self._ontology.vocabulary, self._library.needs
            )
            kind = _kind(template)
            if transformation != self._space.transformations.get(transformation.name):
                self._report(
                    Change(
                        ChangeKind.TRANSFORMATION_ANNOTATED,
                        transformation=transformation.name,
                        specification=template.source,
                        described=KnownTransformation(transformation, kind),
                    )
                )

    def _view(self, template: AnyTemplate) -> TemplateView:
        window = template.query.window if isinstance(template, Template) else None
        return TemplateView(
            name=template.name,
            uses=parameter_uses(template, self._ontology.vocabulary),
            doc=_comment(template.source),
            window=None if window is None else window_text(window),
            local_name=shorten(template.name).removeprefix("dyknow:"),
            parameters=tuple(f"?{parameter.value}" for parameter in template.parameters),
            source=template.source,
            etag=self._library.etag(template.name),
        )


def _kind(template: AnyTemplate) -> str:
    """The transformation that evaluates a template."""
    if isinstance(template, Template):
        return C_SPARQL
    return MTL if isinstance(template, FormulaTemplate) else PATTERN


def _comment(source: str) -> str:
    """The comment with which a text begins, without its signs."""
    lines = []
    for line in source.strip().splitlines():
        if not line.startswith("#"):
            break
        lines.append(line.lstrip("# ").rstrip())
    return " ".join(lines)
