"""Event templates as transformations ([Events14 §VI], SPEC §5): events that build on events.

The inputs and output are inferred from the template's query: the features (and events) of its
objects, and its event over their sort. A parameter in a class position is bound to the wanted sort,
the parameter for the event's object to the wanted object. A parameter that no pattern binds (a
threshold) needs a value in a direct request; matching cannot supply one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

from pyoxigraph import NamedNode, Variable

from ..converters.to_samples import ID, field_names
from ..languages.csparql import body_tree, required_parameters
from ..languages.csparql.ast import ContinuousQuery, Form, Template
from ..languages.ssl.annotation import Argument, PortAnnotation
from ..matching.space import EventDescription
from ..matching.subject import Subject
from ..matching.want import Want
from ..ontology.vocabulary import THING, Vocabulary
from ..rdf.namespaces import shorten
from .instantiate import ArgumentError, instantiate
from .needs import Needs, NeedsError
from .patterns import head_subjects, patterns


@dataclass(frozen=True)
class EventTransformation(EventDescription):
    """A template as seen by matching: `wants_of` returns its needs for the objects of a subject.

    ``vocabulary`` returns the current vocabulary, ``needs_of`` the needs of a query
    (`TemplateLibrary.needs`).
    """

    template: Template | None = None
    vocabulary: Callable[[], Vocabulary] | None = field(default=None, compare=False)
    needs_of: Callable[[ContinuousQuery], Needs] | None = field(default=None, compare=False)

    @cached_property
    def _wants_cache(self) -> dict[tuple[int, Subject], tuple[Want, ...] | None]:
        return {}

    def wants_of(self, subject: Subject) -> tuple[Want, ...] | None:
        """Return the needs of the query for the event of ``subject``; None if it cannot produce
        that."""
        assert self.vocabulary is not None
        key = (self.vocabulary().version, subject._replace(bounds=()))
        if key not in self._wants_cache:
            self._wants_cache[key] = self._wants(key[1])
        return self._wants_cache[key]

    def query(self, subject: Subject) -> ContinuousQuery:
        """Return the template's query for ``subject``. Raises `ArgumentError`."""
        assert self.template is not None
        assert self.vocabulary is not None
        own, sorts = _parameters(self.template)
        arguments: list[NamedNode | Variable] = []
        for parameter in self.template.parameters:
            if parameter.value == own and subject.object is not None:
                arguments.append(NamedNode(subject.object))
            elif parameter.value in sorts:
                arguments.append(NamedNode(subject.sort or THING))
            else:
                arguments.append(parameter)
        return instantiate(self.template, arguments, self.vocabulary())

    def is_selective(self, subject: Subject) -> bool:
        """Return whether a parameter stands for the object."""
        assert self.template is not None
        return subject.object is not None and _parameters(self.template)[0] is not None

    def _wants(self, subject: Subject) -> tuple[Want, ...] | None:
        assert self.needs_of is not None
        try:
            return self.needs_of(self.query(subject)).wants or None
        except (ArgumentError, NeedsError):
            return None


def event_transformation(
    template: Template,
    vocabulary: Callable[[], Vocabulary],
    needs_of: Callable[[ContinuousQuery], Needs],
) -> EventTransformation:
    """Return a template as a transformation; ``lacks`` states why it allows direct
    requests only."""
    query = template.query
    lacks, sort, value = "", THING, "value"
    wants: tuple[Want, ...] = ()
    required = required_parameters(template)
    if required:
        names = " and ".join(f"?{parameter.value}" for parameter in required)
        lacks = f"{names} must be given: request {shorten(template.name)} with a value"
    elif query.form is not Form.CONSTRUCT:
        lacks = "its results are a table, not a stream of an event"
    else:
        predicates = _predicates(query)
        value = field_names(predicates)[predicates[0]]
        try:
            needed = needs_of(query)
        except NeedsError as error:
            lacks = error.message
        else:
            wants = needed.wants
            product = needed.product
            if product is not None and len(product.sorts) == 1:
                sort = product.sorts[0]
            elif product is not None and len(product.sorts) > 1:
                lacks = "its head is about several kinds of objects"
    inputs = tuple(
        PortAnnotation(want.feature, want.feature, (), (Argument("o", want.wanted_sort),))
        for want in wants
    )
    output = PortAnnotation(value, template.name, (), (Argument("o", sort, None, None),))
    return EventTransformation(
        shorten(template.name),
        inputs,
        output,
        lacks=lacks,
        id_field=ID,
        template=template,
        vocabulary=vocabulary,
        needs_of=needs_of,
    )


def _predicates(query: ContinuousQuery) -> list[str]:
    tree = body_tree(query)
    found = dict.fromkeys(
        triple.predicate.value
        for triple in tree.template or ()
        if isinstance(triple.predicate, NamedNode | Variable)
    )
    return list(found)


def _parameters(template: Template) -> tuple[str | None, frozenset[str]]:
    """Return the parameter for the event's object, and those for its classes."""
    root = body_tree(template.query)
    names = {parameter.value for parameter in template.parameters}
    subjects = [subject.value for subject in head_subjects(root)]
    own = next((name for name in subjects if name in names), None)
    sorts = {
        found.value
        for pattern in patterns(root)
        if pattern.subject is not None and pattern.subject.value in subjects
        for found in pattern.classes
        if found.value in names
    }
    return own, frozenset(sorts)
