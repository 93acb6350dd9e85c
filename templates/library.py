"""The template library: event templates in the ontology ([Events14 §IV.B, §V.B]).

A template is a property of its event concept, so the ontology is the only storage of its text, also
across a restart. This module caches the parsed values. The engine registers, gets and removes
templates. Not thread-safe: the ontology has one writer.
"""

from __future__ import annotations

import difflib
import hashlib
from collections.abc import Sequence
from importlib.resources import files

from pyoxigraph import Variable

from ..languages.csparql.ast import ContinuousQuery, Template
from ..languages.errors import LanguageError
from ..languages.templates import AnyTemplate, parse_any_template
from ..ontology.ontology import Ontology
from ..rdf.dictionary import Term
from ..rdf.namespaces import DYKNOW, PREFIXES, local_name, shorten
from .defaults import check_defaults
from .instantiate import instantiate
from .needs import Needs, NeedsError, is_static_in, needs, open_predicates
from .reasoning import Bound, bound_template, template_wants


class TemplateExists(Exception):
    """A template of this name (an IRI) exists. Nothing was changed."""

    def __init__(self, name: str) -> None:
        super().__init__(f"there is a template {shorten(name)}")
        self.name = name


class TemplateRefused(ValueError):
    """A well-formed template uses terms that the ontology does not know. Nothing was changed."""

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint


class NoSuchTemplate(LookupError):
    """No template has this name; ``suggestions`` are similar names."""

    def __init__(self, name: str, suggestions: tuple[str, ...]) -> None:
        super().__init__(f"there is no template {name}")
        self.name = name
        self.suggestions = suggestions


class TemplateLibrary:
    """The event templates of an ontology, parsed.

    Law: another library over the same ontology has the same templates.
    """

    def __init__(self, ontology: Ontology) -> None:
        self._ontology = ontology
        self._templates: dict[str, AnyTemplate] = {}
        self.broken: dict[str, str] = {}
        """Stored texts that no longer parse, by event, with the reason; they stay stored."""
        for event, source in ontology.registered.templates.items():
            try:
                self._templates[event] = parse_any_template(source)
            except LanguageError as error:
                self.broken[event] = str(error)

    def register(self, text: str, *, replace: bool = False) -> AnyTemplate:
        """Parse, check and store the template; its event becomes a concept of the ontology.

        Raises `LanguageError` for the text; `TemplateRefused` if it uses unknown features or sorts,
        or if its name is one; `TemplateExists` unless ``replace``.
        """
        template = parse_any_template(text)
        if template.name in self._templates and not replace:
            raise TemplateExists(template.name)
        self._check(template)
        self._ontology.registered.templates[template.name] = text
        self._templates[template.name] = template
        return template

    def get(self, name: str) -> AnyTemplate:
        """Return a template by IRI, ``<IRI>``, prefixed name, or local name. Raises
        `NoSuchTemplate`."""
        return self._templates[self._resolve(name)]

    def remove(self, name: str) -> AnyTemplate:
        """Remove the template and return it. Raises `NoSuchTemplate`."""
        iri = self._resolve(name)
        del self._ontology.registered.templates[iri]
        return self._templates.pop(iri)

    def __len__(self) -> int:
        """Return the number of templates."""
        return len(self._templates)

    def names(self) -> tuple[str, ...]:
        """Return the IRIs of all templates, sorted."""
        return tuple(sorted(self._templates))

    def etag(self, name: str) -> str:
        """Return a tag that changes with the text: 32 hexadecimal digits. Raises
        `NoSuchTemplate`."""
        source = self._templates[self._resolve(name)].source
        return hashlib.sha256(source.encode()).hexdigest()[:32]

    def instantiate(
        self, template: AnyTemplate, arguments: Sequence[Term | Variable]
    ) -> ContinuousQuery | Bound:
        """Return the query, formula or pattern of a template with these arguments. Raises
        `ArgumentError`; for what is no query `LanguageError` and `NeedsError` too, where the
        ontology has changed."""
        if isinstance(template, Template):
            return instantiate(template, arguments, self._ontology.vocabulary)
        is_static = is_static_in(self._ontology.static_store)
        return bound_template(template, arguments, self._ontology.vocabulary, is_static)

    def needs(self, query: ContinuousQuery | Bound) -> Needs:
        """Return the `needs` of a query by this library's ontology. Raises `NeedsError`."""
        if not isinstance(query, ContinuousQuery):
            return query.needs
        return needs(query, self._ontology.vocabulary, is_static_in(self._ontology.static_store))

    def _check(self, template: AnyTemplate) -> None:
        vocabulary = self._ontology.vocabulary
        name = template.name
        for is_taken, kind in ((vocabulary.is_feature, "feature"), (vocabulary.is_sort, "sort")):
            if is_taken(name):
                raise TemplateRefused(
                    f"{shorten(name)} is a {kind}, so it cannot be the name of an event",
                    f"name the event, for example {shorten(name)}Event",
                )
        try:
            # The argument of a parameter in a predicate position is unknown yet.
            if not isinstance(template, Template) or not open_predicates(template.query):
                self._check_circle(template)
        except NeedsError as error:
            raise TemplateRefused(error.message, error.hint) from error
        check_defaults(template, vocabulary)

    def _check_circle(self, template: AnyTemplate) -> None:
        """Raise `TemplateRefused` if the event would need itself ([Events14 §VI])."""
        came_from: dict[str, str] = {}
        waiting = [template]
        while waiting:
            user = waiting.pop()
            try:
                events = self._events_of(user)
            except (NeedsError, LanguageError):
                if user is template:
                    raise
                continue  # a registered template whose terms the ontology no longer has
            for event in events:
                if event == template.name:
                    path = [user.name]
                    while path[-1] != template.name:
                        path.append(came_from[path[-1]])
                    steps = " needs ".join(map(shorten, (*reversed(path), event)))
                    raise TemplateRefused(
                        f"{shorten(event)} would need itself: {steps}",
                        "leave one of these out: an event builds on others, never on itself",
                    )
                if event not in came_from and event in self._templates:
                    came_from[event] = user.name
                    waiting.append(self._templates[event])

    def _events_of(self, template: AnyTemplate) -> tuple[str, ...]:
        """Return the events that a template needs."""
        if not isinstance(template, Template):
            wants = template_wants(template, self._ontology.vocabulary)
        elif open_predicates(template.query):
            return ()
        else:
            wants = self.needs(template.query).wants
        is_event = self._ontology.vocabulary.is_event
        own = template.name
        events = (w.feature for w in wants if is_event(w.feature) or w.feature == own)
        return tuple(dict.fromkeys(events))

    def _resolve(self, name: str) -> str:
        bare = name[1:-1] if name.startswith("<") and name.endswith(">") else name
        prefix, colon, local = bare.partition(":")
        expanded = PREFIXES[prefix] + local if colon and prefix in PREFIXES else bare
        for iri in (bare, expanded, DYKNOW + bare):
            if iri in self._templates:
                return iri
        same = [iri for iri in self._templates if local_name(iri) == bare]
        if len(same) == 1:
            return same[0]
        locals_ = {local_name(iri): shorten(iri) for iri in self.names()}
        near = difflib.get_close_matches(local_name(bare), locals_, n=3)
        raise NoSuchTemplate(name, tuple(locals_[local] for local in near))


def shipped_templates() -> tuple[str, ...]:
    """Return the texts of the templates in the package, by file name."""
    return tuple(shipped_texts().values())


def shipped_texts() -> dict[str, str]:
    """Return the same texts by name: ``high_speed``, that of the file without its suffix."""
    folder = files(__package__) / "library"
    found = sorted(
        (entry for entry in folder.iterdir() if entry.name.endswith(".rq")),
        key=lambda entry: entry.name,
    )
    return {entry.name.removesuffix(".rq"): entry.read_text("utf-8") for entry in found}
