"""The objects that the ontology and the samples of annotated streams name, and what is known of
each: its sorts, and the newest value of each feature.

Samples of streams of RDF do not count: they have no annotation. Answers come in parts, so that the
caller can do other work in between: a stream may end or change meanwhile, but no part is wrong by
itself.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from ...converters.objects import object_iri, spellings
from ...converters.rdf.statements import SUBJECT
from ...languages.ssl.annotation import Content, Role, StreamAnnotation
from ...ontology.ontology import Ontology
from ...streams.sample import Column, Mask, SampleBatch, Value
from ...streams.string_pool import StringPool
from ..configuration.configuration import Configuration

PART = 1_000
"""Objects of a part, at most: some 2 ms of work."""
Sorts = frozenset[str]
"""IRIs of sorts, with the sorts above them or without."""


@dataclass(frozen=True, slots=True)
class KnownValue:
    """The newest value of a feature in a stream: the one with the greatest valid time, and of
    these the last to become available. ``objects`` are all arguments of the feature. Times in
    ns."""

    content: Content
    objects: tuple[str, ...]
    stream: str
    value: Value
    valid: int
    available: int


class KnownObjects:
    """Finds objects. ``annotations`` has the annotations of the streams that run, by name."""

    def __init__(
        self,
        ontology: Ontology,
        configuration: Configuration,
        annotations: Mapping[str, StreamAnnotation],
    ) -> None:
        self._ontology = ontology
        self._configuration = configuration
        self._annotations = annotations

    def all(self) -> Iterator[Mapping[str, Sorts]]:
        """Yield all objects in parts, by IRI, with the sorts that name them there. An object may be
        in several parts, and has the sorts of all of them and those above.

        Cost: O(kept samples) numpy, and a microsecond an object in each stream.
        """
        vocabulary = self._ontology.vocabulary
        names = vocabulary.objects()
        for start in range(0, len(names), PART):
            part = names[start : start + PART]
            yield {iri: vocabulary.sorts_of(iri) for iri in part}
        for stream in tuple(self._annotations):
            yield from self._of_stream(stream)

    def sorts_above(self, sorts: Sorts) -> Sorts:
        """Return the domain's sorts among ``sorts`` and those above them."""
        vocabulary = self._ontology.vocabulary
        above = (one for sort in sorts for one in vocabulary.supersorts(sort))
        return frozenset(filter(vocabulary.is_domain_sort, above))

    def of(self, iri: str) -> Iterator[tuple[Sorts, list[KnownValue]] | None]:
        """Yield what the ontology and each stream know of an object; None where it is not known.

        Cost: O(kept samples x features) numpy a stream.
        """
        vocabulary = self._ontology.vocabulary
        yield (vocabulary.sorts_of(iri), []) if vocabulary.is_object(iri) else None
        for stream in tuple(self._annotations):
            yield self._in_stream(iri, stream)

    def _batches(self, stream: str) -> tuple[tuple[Content, ...], list[SampleBatch]]:
        """The contents of a stream, and its kept samples, oldest first; none if it has gone."""
        annotation = self._annotations.get(stream)
        generator = self._configuration.streams.get(stream)
        if annotation is None or generator is None:
            return (), []
        return annotation.contents, [segment.batch for segment in generator.stream.since(0)]

    def _of_stream(self, stream: str) -> Iterator[Mapping[str, Sorts]]:
        contents, batches = self._batches(stream)
        roles = {role for content in contents for role in content.roles}
        yield {role.object: frozenset() for role in roles if role.object is not None}
        by_field: dict[str, set[str]] = {}
        for role in roles:
            if role.id_field is not None and role.sort is not None:
                by_field.setdefault(role.id_field, set()).add(role.sort)
        namespace = self._configuration.namespaces.get(stream, "")
        for field, sorts in by_field.items():
            found = frozenset(sorts)
            for column in (batch.columns[field] for batch in batches):
                values = np.unique(column.values[column.present])
                for start in range(0, len(values), PART):
                    names = _names(column.pool, values[start : start + PART].tolist())
                    yield {object_iri(name, namespace): found for name in names}

    def _in_stream(self, iri: str, stream: str) -> tuple[Sorts, list[KnownValue]] | None:
        contents, batches = self._batches(stream)
        namespace = self._configuration.namespaces.get(stream, "")
        sorts: set[str] = set()
        values = []
        is_known = False
        for content in contents:
            newest: tuple[SampleBatch, int] | None = None
            is_known |= any(role.object == iri for role in content.roles)
            for batch in batches:
                about, named_by = _about(batch, content, iri, namespace)
                if named_by:
                    is_known = True
                    sorts |= named_by
                rows = np.flatnonzero(about & batch.columns[content.field].present)
                if not len(rows):
                    continue
                valid = batch.valid[rows]
                row = int(rows[np.flatnonzero(valid == valid.max())[-1]])
                if newest is None or batch.valid[row] >= newest[0].valid[newest[1]]:
                    newest = batch, row
            if newest is not None:
                batch, row = newest
                values.append(
                    KnownValue(
                        content,
                        tuple(_named(batch, row, role, namespace) for role in content.roles),
                        stream,
                        batch.columns[content.field].at(row),
                        int(batch.valid[row]),
                        int(batch.available[row]),
                    )
                )
        return (frozenset(sorts), values) if is_known else None


def rows_about(batch: SampleBatch, contents: Iterable[Content], iri: str, namespace: str) -> Mask:
    """The rows of a stream with these ``contents`` in which one of them is about the object."""
    about = np.zeros(len(batch), np.bool_)
    for content in contents:
        about |= _about(batch, content, iri, namespace)[0]
    return about


def statements_about(batch: SampleBatch, iri: str) -> Mask:
    """The rows of a stream of RDF whose subject is the object."""
    column = batch.columns[SUBJECT]
    assert column.pool is not None
    found: Mask = column.values == column.pool.find(f"<{iri}>")
    return found


def _about(batch: SampleBatch, content: Content, iri: str, namespace: str) -> tuple[Mask, set[str]]:
    """The rows in which the feature is one of the object, and the sorts by which they name it."""
    applies = np.ones(len(batch), np.bool_)
    named: list[tuple[Role, Mask]] = []
    for role in content.roles:
        if role.id_field is None:
            rows = np.full(len(batch), role.object == iri)
        elif role.object is None:
            column = batch.columns[role.id_field]
            applies &= column.present
            rows = _equals(column, iri, namespace)
        else:
            rows = _equals(batch.columns[role.id_field], role.object, namespace)
            applies &= rows
            rows = rows & (role.object == iri)
        named.append((role, rows))
    about = np.zeros(len(batch), np.bool_)
    sorts = set()
    for role, rows in named:
        rows = rows & applies
        about |= rows
        if role.sort is not None and bool(rows.any()):
            sorts.add(role.sort)
    return about, sorts


def _equals(column: Column, iri: str, namespace: str) -> Mask:
    """The rows of an id field that name an object."""
    names = spellings(iri, namespace)
    if column.pool is not None:
        wanted = [column.pool.find(name) for name in names]
    else:
        wanted = [int(name) for name in names if _is_integer(name)]
    found: Mask = np.isin(column.values, wanted) & column.present
    return found


def _is_integer(name: str) -> bool:
    """Whether it is the name that a value of an integer field gives."""
    if not re.fullmatch("-?[0-9]{1,19}", name):
        return False
    value = int(name)
    return str(value) == name and -(2**63) <= value < 2**63


def _names(pool: StringPool | None, values: list[int]) -> list[str]:
    """The names that values of an id field stand for: integers, or codes of ``pool``."""
    return [str(value) if pool is None else pool[value] for value in values]


def _named(batch: SampleBatch, row: int, role: Role, namespace: str) -> str:
    if role.object is not None:
        return role.object
    assert role.id_field is not None
    return object_iri(str(batch.columns[role.id_field].at(row)), namespace)
