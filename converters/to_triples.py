"""Samples -> timed triples by a stream's SSL annotation ([Events14 §V.A], SPEC §4).

The annotation is compiled once to a plan of columns; converting a batch renames, masks and looks up
columns. docs/reference/formats.md shows the triples of s1-s7.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray
from pyoxigraph import NamedNode

from ..languages.ssl.annotation import Content, Role, StreamAnnotation
from ..ontology.units import IDENTITY, Conversion, Unit, UnitError, conversion
from ..ontology.vocabulary import Vocabulary
from ..rdf.dictionary import HeldTerms, Ids, TermDictionary
from ..rdf.namespaces import DYKNOW, RDF, local_name
from ..rdf.timed import Kind, ObjectColumn, TimedTriples, TripleRows
from ..streams.instants import places_in_instants
from ..streams.sample import Field, FieldType, Mask, SampleBatch, Schema, Times
from ..streams.time import format_time
from .errors import ConversionError
from .objects import ObjectTable, object_iri
from .values import ToObjects, object_column

VALUE: Final = RDF + "value"


class ToTriples(Protocol):
    """Samples of one stream to timed triples, by ``annotation``; see `SampleConverter`."""

    annotation: StreamAnnotation

    @property
    def makes_nodes(self) -> bool: ...
    def convert(self, batch: SampleBatch, names: Sequence[str] | None = None) -> TimedTriples: ...


class SampleConverter:
    """Compiled from an annotation: `convert` maps batches of the stream to timed triples.

    Meaning: ``(object, feature, value)`` for each feature whose condition holds, at τ = available
    time, with the valid time. No object or no value: no triple. Features with the same subject and
    condition share one table of wide rows, in the order of the samples, without rows that have no
    triple. ``features`` (IRIs) selects features, ``units`` gives a feature (IRI) another unit than
    the stream's, ``ranges`` gives the ranges of features that the vocabulary lacks. Objects named
    by an id field lie in ``namespace`` unless they are IRIs.

    Law (tests/laws): `TripleConverter` of the same annotation gives the samples back.

    The constructor raises `ConversionError` if the annotation does not fit the schema or the
    ontology's ranges; `convert` raises it with the row of a value that is no object of its feature.

    Cost: numpy per column, a dict look-up per distinct new name or text; n-ary features make one
    IRI per sample. Memory: 4 bytes a distinct name of each id field.
    """

    def __init__(
        self,
        annotation: StreamAnnotation,
        schema: Schema,
        vocabulary: Vocabulary,
        dictionary: TermDictionary,
        *,
        namespace: str = DYKNOW,
        features: Collection[str] | None = None,
        units: Mapping[str, Unit] | None = None,
        ranges: Mapping[str, str] | None = None,
    ) -> None:
        self.annotation = annotation
        self.dictionary = dictionary
        self._tables: list[_Table] = []
        self._tables_of: dict[tuple[Role, ...], list[_Table]] = {}
        self._nodes: list[_Node] = []
        self._named: list[HeldTerms] = []
        """Keep the features' ids, which columns hold, in the dictionary."""
        for position, content in enumerate(annotation.contents):
            if features is not None and content.feature not in features:
                continue
            info = vocabulary.feature(content.feature)
            names = ObjectTable(dictionary, namespace)
            objects = object_column(
                field_of(schema, content.field, annotation),
                (None if info is None else info.range) or (ranges or {}).get(content.feature),
                edge_conversion(content, units),
                names,
                dictionary,
            )
            roles = tuple(
                _Subject.compile(role, schema, annotation, dictionary, namespace)
                for role in content.roles
            )
            predicate = HeldTerms(dictionary, [NamedNode(content.feature)])
            self._named.append(predicate)
            column = _Column(content.field, int(predicate.ids[0]), objects)
            if len(roles) > 1:
                stem = node_stem(annotation, position, namespace)
                self._nodes.append(_Node(column, roles, stem, dictionary))
            else:
                subject = roles[0] if roles else _stream(annotation, dictionary, namespace)
                self._add(subject, content.roles, column)

    @property
    def makes_nodes(self) -> bool:
        """Whether features of several objects make nodes, which need names."""
        return bool(self._nodes)

    def convert(self, batch: SampleBatch, names: Sequence[str] | None = None) -> TimedTriples:
        """The timed triples of the samples.

        ``names`` (`node_names`) name the nodes of n-ary features, one per sample. Without them the
        batch must hold its instants completely.
        """
        tables: list[TripleRows] = []
        for table in self._tables:
            rows = table.rows(batch)
            if len(rows):
                tables.append(rows)
        if self._nodes and names is None:
            names = node_names(batch.available, places_in_instants(batch.available))
        for node in self._nodes:
            tables.extend(node.tables(batch, names or ()))
        return TimedTriples(self.dictionary, tuple(tables))

    def _add(self, subject: _Subject, roles: tuple[Role, ...], column: _Column) -> None:
        alike = self._tables_of.setdefault(roles, [])
        for table in alike:
            if column.predicate not in {other.predicate for other in table.columns}:
                table.columns.append(column)
                return
        table = _Table(subject, roles, [column])
        alike.append(table)
        self._tables.append(table)


def field_of(schema: Schema, name: str, annotation: StreamAnnotation) -> Field:
    """The declared field with this name; raises `ConversionError` if there is none."""
    field = schema.get(name)
    if field is None:
        raise ConversionError(
            f"the annotation of {annotation.stream} names a field {name!r} that it does not have",
            field=name,
            hint=f"its fields are {', '.join(schema.names)}",
        )
    return field


def edge_conversion(content: Content, units: Mapping[str, Unit] | None) -> Conversion:
    """The conversion from the stream's unit to the wanted one."""
    target = None if units is None else units.get(content.feature)
    if target is None:
        return IDENTITY
    try:
        return conversion(content.unit, target)
    except UnitError as error:
        raise ConversionError(f"field {content.field!r}: {error}", field=content.field) from error


def stream_iri(annotation: StreamAnnotation, namespace: str) -> str:
    """The subject of a feature without arguments, ``temperature() = t``: the stream itself."""
    return object_iri(annotation.stream, namespace)


def node_stem(annotation: StreamAnnotation, position: int, namespace: str) -> str:
    """The IRI of an n-ary feature's nodes, up to the available time.

    ``position`` is that of the feature in the annotation, which may have it twice with other
    arguments.
    """
    feature = local_name(annotation.contents[position].feature)
    return object_iri(f"{annotation.stream}/{feature}.{position}/", namespace)


def node_names(available: Times, places: NDArray[np.int64]) -> list[str]:
    """The ends of nodes' IRIs: the available time, and the place in its instant from 1 on."""
    times = zip(available.tolist(), places.tolist(), strict=True)
    return [format_time(time) + (f".{place}" if place else "") for time, place in times]


@dataclass(frozen=True, slots=True)
class _Subject:
    """The object of a role in each sample: a constant, the value of a field, or a constant where
    the field names it."""

    constant: HeldTerms | None
    field: str | None
    names: ObjectTable
    named_sort: HeldTerms | None

    @property
    def sort(self) -> int | None:
        """The id of the sort of its objects."""
        return None if self.named_sort is None else int(self.named_sort.ids[0])

    @classmethod
    def compile(
        cls,
        role: Role,
        schema: Schema,
        annotation: StreamAnnotation,
        dictionary: TermDictionary,
        namespace: str,
    ) -> _Subject:
        if role.id_field is not None:
            field = field_of(schema, role.id_field, annotation)
            if field.type not in (FieldType.STRING, FieldType.INTEGER):
                raise ConversionError(
                    f"field {field.name!r} names objects but holds {field.type} values",
                    field=field.name,
                    hint="declare it as string or integer",
                )
        elif role.object is None:
            raise ConversionError(
                f"the annotation of {annotation.stream} does not say which object it speaks of",
                hint=f"add: for every {local_name(role.sort or 'SORT')} = <id field>",
            )
        return cls(
            None if role.object is None else HeldTerms(dictionary, [NamedNode(role.object)]),
            role.id_field,
            ObjectTable(dictionary, namespace),
            None if role.sort is None else HeldTerms(dictionary, [NamedNode(role.sort)]),
        )

    def ids(self, batch: SampleBatch) -> tuple[Ids, Mask | None]:
        """Term ids, shape ``(n,)``, and the rows where the role has an object (None: all)."""
        if self.field is None:
            assert self.constant is not None
            return np.full(len(batch), self.constant.ids[0], np.int32), None
        column = batch.columns[self.field]
        ids = self.names.of_column(column)
        named = None if column.null is None else ~column.null
        if self.constant is not None:
            called = ids == self.constant.ids[0]
            named = called if named is None else named & called
        return ids, named


@dataclass(frozen=True, slots=True)
class _Column:
    field: str
    predicate: int
    convert: ToObjects

    def objects(self, chosen: SampleBatch, kept: Mask | None) -> ObjectColumn:
        """The objects of the chosen samples; errors count rows in the whole batch."""
        try:
            return self.convert(chosen.columns[self.field])
        except ConversionError as error:
            if kept is not None and error.row is not None:
                row = int(np.flatnonzero(kept)[error.row])
                raise ConversionError(error.message, row=row, field=error.field) from None
            raise


@dataclass(frozen=True, slots=True)
class _Table:
    """Features with the same subject and condition: one table of wide rows."""

    subject: _Subject
    roles: tuple[Role, ...]
    columns: list[_Column]

    def rows(self, batch: SampleBatch) -> TripleRows:
        subjects, kept = self.subject.ids(batch)
        # Samples without the condition may hold values of other features: they are not converted.
        chosen = _selected(batch, kept)
        objects = {column.predicate: column.objects(chosen, kept) for column in self.columns}
        if kept is not None and len(chosen) < len(batch):
            subjects = subjects[kept]
        rows = TripleRows(chosen.available, chosen.valid, subjects, objects, self.subject.sort)
        if all(column.null is not None for column in objects.values()):
            some = np.logical_or.reduce([column.present for column in objects.values()])
            if not some.all():
                return rows.take(some)
        return rows


@dataclass(frozen=True, slots=True)
class _Node:
    """An n-ary feature: a node per sample with ``rdf:value`` and ``rdf:_1``, ``rdf:_2`` …"""

    column: _Column
    roles: tuple[_Subject, ...]
    stem: str
    dictionary: TermDictionary

    def tables(self, batch: SampleBatch, names: Sequence[str]) -> list[TripleRows]:
        kept = batch.columns[self.column.field].present
        arguments = []
        for role in self.roles:
            ids, there = role.ids(batch)
            arguments.append(ids)
            if there is not None:
                kept = kept & there
        chosen = _selected(batch, kept)
        if not len(chosen):
            return []
        arguments = [ids[kept] for ids in arguments]
        # `stem` is an IRI already, so that the name needs no encoding.
        nodes = self.dictionary.transient_ids(
            NamedNode(f"{self.stem}{names[row]}") for row in np.flatnonzero(kept).tolist()
        )
        time, valid = chosen.available, chosen.valid
        objects = {self._predicate(VALUE): self.column.objects(chosen, kept)}
        for number, ids in enumerate(arguments, 1):
            objects[self._predicate(f"{RDF}_{number}")] = ObjectColumn(Kind.TERM, ids)
        link = {self.column.predicate: ObjectColumn(Kind.TERM, nodes)}
        found = [
            TripleRows(time, valid, arguments[0], link, self.roles[0].sort),
            TripleRows(time, valid, nodes, objects),
        ]
        # The other arguments are subjects of no triple; rows without objects tell their sort.
        found.extend(
            TripleRows(time, valid, ids, {}, role.sort)
            for role, ids in zip(self.roles[1:], arguments[1:], strict=True)
            if role.sort is not None
        )
        return found

    def _predicate(self, iri: str) -> int:
        return self.dictionary.id(NamedNode(iri))


def _stream(annotation: StreamAnnotation, dictionary: TermDictionary, namespace: str) -> _Subject:
    subject = HeldTerms(dictionary, [NamedNode(stream_iri(annotation, namespace))])
    return _Subject(subject, None, ObjectTable(dictionary, namespace), None)


def _selected(batch: SampleBatch, kept: Mask | None) -> SampleBatch:
    return batch if kept is None or bool(kept.all()) else batch.take(kept)
