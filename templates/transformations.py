"""Event templates as transformations ([Events14 §VI], SPEC §5): events that build on events.

The inputs and output are inferred from the template's query: the features (and events) of its
objects, and its event over their sort. A parameter in a class position is bound to the wanted sort,
the parameter for the event's object to the wanted object. A parameter that no pattern binds (a
threshold) needs a value in a direct request; matching cannot supply one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple, TypeAlias

from pyoxigraph import NamedNode, Variable

from ..converters.results_to_samples import ID, field_names
from ..languages.csparql import body_tree, required_parameters
from ..languages.csparql.ast import ContinuousQuery, Form, Template
from ..languages.errors import LanguageError
from ..languages.mtl import FormulaTemplate
from ..languages.mtl.checked import ObjectSlot
from ..languages.ssl.annotation import Argument, PortAnnotation
from ..languages.templates import AnyTemplate
from ..matching.space import EventDescription
from ..matching.subject import Subject
from ..matching.want import Want
from ..ontology.vocabulary import THING, Vocabulary
from ..rdf.namespaces import shorten
from ..reasoning.mtl.monitoring import VERDICT
from ..reasoning.patterns.plans.query import START
from .instantiate import ArgumentError, instantiate
from .needs import Needs, NeedsError
from .patterns import head_subjects, patterns
from .reasoning import Bound, ReasonedTemplate, bound_template, slots_of, template_wants

NeedsOf: TypeAlias = Callable[[ContinuousQuery | Bound], Needs]


@dataclass(frozen=True)
class EventTransformation(EventDescription):
    """A template as seen by matching: `wants_of` returns its needs for the objects of a subject.

    ``vocabulary`` returns the current vocabulary, ``needs_of`` the needs of a query
    (`TemplateLibrary.needs`).
    """

    template: AnyTemplate | None = None
    vocabulary: Callable[[], Vocabulary] | None = field(default=None, compare=False)
    needs_of: NeedsOf | None = field(default=None, compare=False)

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

    def query(self, subject: Subject) -> ContinuousQuery | Bound:
        """Return the template's query for ``subject``. Raises `ArgumentError`."""
        assert self.vocabulary is not None
        assert self.template is not None
        if not isinstance(self.template, Template):
            # `lacks` leaves out templates of several parameters.
            object = Variable("o") if subject.object is None else NamedNode(subject.object)
            return bound_template(self.template, [object], self.vocabulary())
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
        if subject.object is None:
            return False
        assert self.template is not None
        if not isinstance(self.template, Template):
            return True
        return _parameters(self.template)[0] is not None

    def _wants(self, subject: Subject) -> tuple[Want, ...] | None:
        assert self.needs_of is not None
        try:
            return self.needs_of(self.query(subject)).wants or None
        except (ArgumentError, LanguageError, NeedsError):
            return None


def event_transformation(
    template: AnyTemplate,
    vocabulary: Callable[[], Vocabulary],
    needs_of: NeedsOf,
) -> EventTransformation:
    """Return a template as a transformation; ``lacks`` states why it allows direct
    requests only."""
    description = (
        _query(template, needs_of)
        if isinstance(template, Template)
        else _reasoned(template, vocabulary())
    )
    inputs = tuple(
        PortAnnotation(want.feature, want.feature, (), (Argument("o", want.wanted_sort),))
        for want in description.wants
    )
    argument = Argument("o", description.sort, None, None)
    return EventTransformation(
        shorten(template.name),
        inputs,
        PortAnnotation(description.value, template.name, (), (argument,)),
        lacks=description.lacks,
        id_field=description.id_field,
        template=template,
        vocabulary=vocabulary,
        needs_of=needs_of,
    )


class _Description(NamedTuple):
    """``value`` and ``id_field`` are the fields of the event's value and object."""

    wants: tuple[Want, ...]
    sort: str
    value: str
    id_field: str
    lacks: str


def _reasoned(template: ReasonedTemplate, vocabulary: Vocabulary) -> _Description:
    names = [parameter.value for parameter in template.parameters]
    value = VERDICT if isinstance(template, FormulaTemplate) else START
    lacks, sort = "", THING
    wants: tuple[Want, ...] = ()
    try:
        slots = slots_of(template, vocabulary)
        wants = template_wants(template, vocabulary)
    except (LanguageError, NeedsError) as error:
        lacks = error.message
    else:
        match slots:
            case (ObjectSlot(sort=sort),):
                pass
            case _:
                values = [f"?{slot.name}" for slot in slots if not isinstance(slot, ObjectSlot)]
                lacks = (
                    _must_be_given(template, values)
                    if values
                    else "it is no event of a single object"
                )
    return _Description(wants, sort, value, names[0] if names else ID, lacks)


def _must_be_given(template: AnyTemplate, parameters: Sequence[str]) -> str:
    names = " and ".join(parameters)
    # A default is what a request takes; a query over the event makes none.
    return (
        f"{names} must be given: request {shorten(template.name)} first, and keep the request "
        "(`dyknow events … --keep`)"
    )


def _query(template: Template, needs_of: NeedsOf) -> _Description:
    query = template.query
    lacks, sort, value = "", THING, "value"
    wants: tuple[Want, ...] = ()
    required = required_parameters(template)
    if required:
        lacks = _must_be_given(template, [f"?{parameter.value}" for parameter in required])
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
    return _Description(wants, sort, value, ID, lacks)


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
