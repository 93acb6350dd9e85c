"""Timed triples -> samples of an annotated stream: the way back from `to_triples` ([Events14 §V.A],
SPEC §4)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from pyoxigraph import NamedNode

from ..languages.ssl.annotation import Content, StreamAnnotation
from ..ontology.units import Conversion, Unit
from ..rdf.dictionary import NO_TERM, Ids, TermDictionary
from ..rdf.namespaces import DYKNOW, RDF
from ..rdf.timed import Kind, ObjectColumn, TimedTriples, TripleRows
from ..streams.sample import (
    Column,
    Field,
    FieldType,
    Mask,
    SampleBatch,
    Schema,
    Times,
    empty_batch,
)
from ..streams.string_pool import StringPool
from .errors import ConversionError
from .to_triples import VALUE, edge_conversion, field_of, stream_iri
from .values import field_column


class TripleConverter:
    """The inverse of `SampleConverter` for the same annotation: triples of one τ are one sample.
    Where a feature has several of one τ, which is an instant of several samples, those of one valid
    time and one subject (or node) are a sample.

    Subject -> id field, object -> field, in names as `objects.object_name` writes them; τ becomes
    the available time, the valid time is kept. What comes back, exactly: every sample that gave a
    triple, with the fields that gave one and the id fields of these; other fields are no_value. A
    sample that gave no triple does not come back. ``units`` as given to `SampleConverter` converts
    back (to float64's rounding).

    Triples that the annotation does not speak of are left out. Raises `ConversionError` at once for
    an annotation whose triples cannot be told apart (one feature twice of objects that may be the
    same), and in `convert` when triples of one sample contradict each other.

    Cost: numpy per column, a name per distinct new object.
    """

    def __init__(
        self,
        annotation: StreamAnnotation,
        schema: Schema,
        pools: dict[str, StringPool],
        *,
        namespace: str = DYKNOW,
        units: Mapping[str, Unit] | None = None,
    ) -> None:
        self._schema = schema
        self._pools = pools
        self._namespace = namespace
        self._contents = annotation.contents
        self._stream = stream_iri(annotation, namespace)
        self._conversions: list[Conversion | None] = []
        for position, content in enumerate(annotation.contents):
            field_of(schema, content.field, annotation)
            for role in content.roles:
                if role.id_field is not None:
                    field_of(schema, role.id_field, annotation)
            for other in annotation.contents[:position]:
                _check_apart(content, other)
            forth = edge_conversion(content, units)
            self._conversions.append(None if forth.is_identity else _inverse(forth))
        for field in schema.fields:
            if field.type is FieldType.STRING:
                pools.setdefault(field.name, StringPool())

    def convert(self, triples: TimedTriples) -> SampleBatch:
        """The samples that the triples stand for, by available time."""
        parts: list[_Part] = []
        several: list[Times] = []
        for content, back in zip(self._contents, self._conversions, strict=True):
            convert = self._nary if len(content.roles) > 1 else self._unary
            own = list(convert(content, back, triples))
            parts += own
            told = [part.time for part in own if part.field == content.field]
            if told:
                times, counts = np.unique(np.concatenate(told), return_counts=True)
                several.append(times[counts > 1])
        if not parts:
            return empty_batch(self._schema, self._pools)
        samples, rows = np.unique(
            np.concatenate([_keys(part, np.concatenate(several)) for part in parts]),
            axis=0,
            return_inverse=True,
        )
        building = _Building(self._schema, samples[:, 0].copy())
        ends = np.cumsum([len(part.time) for part in parts])[:-1]
        for part, own_rows in zip(parts, np.split(rows.reshape(-1), ends), strict=True):
            building.put(part, own_rows, self._pools, triples.dictionary, self._namespace)
        return building.batch(self._pools)

    def _unary(
        self, content: Content, back: Conversion | None, triples: TimedTriples
    ) -> Iterable[_Part]:
        role = content.roles[0] if content.roles else None
        constant = self._stream if role is None else role.object
        for table, objects in _tables_of(triples, content.feature):
            chosen = objects.present
            if constant is not None:
                chosen = chosen & (table.subject == _find(triples, constant))
            rows = np.flatnonzero(chosen)
            if len(rows):
                subjects = table.subject[rows]
                has_id = role is not None and role.id_field is not None
                of = subjects if has_id else None
                yield _Part(table, rows, content.field, objects.take(rows), of, back)
                if role is not None and role.id_field is not None:
                    yield _Part(table, rows, role.id_field, _terms(subjects), of)

    def _nary(
        self, content: Content, back: Conversion | None, triples: TimedTriples
    ) -> Iterable[_Part]:
        links = [column.take(column.present) for _, column in _tables_of(triples, content.feature)]
        nodes = [column.values for column in links if column.kind is Kind.TERM]
        if not nodes:
            return
        known = np.unique(np.concatenate(nodes))
        fields = [(VALUE, content.field, back)]
        fields.extend(
            (f"{RDF}_{number}", role.id_field, None)
            for number, role in enumerate(content.roles, 1)
            if role.id_field is not None
        )
        for predicate, field, change in fields:
            for table, objects in _tables_of(triples, predicate):
                rows = np.flatnonzero(objects.present & np.isin(table.subject, known))
                if len(rows):
                    nodes_of = table.subject[rows]
                    yield _Part(table, rows, field, objects.take(rows), nodes_of, change)


class _Part:
    """Values of one field at some rows of a table."""

    __slots__ = ("back", "field", "objects", "of", "time", "valid")

    def __init__(
        self,
        table: TripleRows,
        rows: np.ndarray,
        field: str,
        objects: ObjectColumn,
        of: Ids | None,
        back: Conversion | None = None,
    ) -> None:
        self.time: Times = table.time[rows]
        self.valid: Times = table.valid[rows]
        self.field = field
        self.objects = objects
        self.of = of
        """The subjects or nodes that tell samples of one instant apart; None: nothing does."""
        self.back = back


def _keys(part: _Part, several: Times) -> np.ndarray:
    """Which sample each row is of, as (τ, valid time, subject): the latter where there are several
    samples of one τ. Shape ``(n, 3)``."""
    keys = np.zeros((len(part.time), 3), np.int64)
    keys[:, 0] = part.time
    is_shared = np.isin(part.time, several)
    keys[is_shared, 1] = part.valid[is_shared]
    keys[is_shared, 2] = -1 if part.of is None else part.of[is_shared]
    return keys


class _Building:
    """Samples being put together, one row each."""

    def __init__(self, schema: Schema, available: Times) -> None:
        count = len(available)
        self._schema = schema
        self._available = available
        self._valid = np.zeros(count, np.int64)
        self._begun = np.zeros(count, np.bool_)
        self._values = {f.name: np.zeros(count, f.type.dtype) for f in schema.fields}
        self._there = {f.name: np.zeros(count, np.bool_) for f in schema.fields}

    def put(
        self,
        part: _Part,
        rows: np.ndarray,
        pools: Mapping[str, StringPool],
        dictionary: TermDictionary,
        namespace: str,
    ) -> None:
        """Add a part to the samples ``rows``; raises `ConversionError` if it contradicts them."""
        field = self._schema.get(part.field)
        assert field is not None
        objects = part.objects
        if part.back is not None:
            # Numbers that stayed terms (such as "1.0") are read before they are converted.
            numbers = Field(field.name, FieldType.FLOAT)
            read = field_column(numbers, objects, dictionary, None, namespace)
            values = part.back.apply(read.values)
            if field.type is FieldType.INTEGER:
                # What was an integer before its unit changed is one again but for rounding.
                whole = np.rint(values)
                values = np.where(np.isclose(values, whole, rtol=1e-12, atol=1e-9), whole, values)
            objects = ObjectColumn(Kind.DOUBLE, values, read.null)
        column = field_column(field, objects, dictionary, pools.get(field.name), namespace)
        self._set(self._valid, self._begun, rows, part.valid, "valid", np.ones(len(rows), np.bool_))
        self._set(
            self._values[field.name],
            self._there[field.name],
            rows,
            column.values,
            field.name,
            column.present,
        )

    def _set(
        self,
        into: np.ndarray,
        there: Mask,
        rows: np.ndarray,
        values: np.ndarray,
        name: str,
        present: Mask,
    ) -> None:
        rows, values = rows[present], values[present]
        before = there[rows] & (into[rows] != values)
        into[rows] = values
        there[rows] = True
        # Of two values for one row the later stands there now: the earlier no longer agrees.
        differs = before | (into[rows] != values)
        if differs.any():
            time = int(self._available[rows[int(np.argmax(differs))]])
            raise ConversionError(
                f"triples at τ = {time} give {name!r} two values",
                field=name,
                hint="these are triples of several samples, and nothing tells them apart",
            )

    def batch(self, pools: Mapping[str, StringPool]) -> SampleBatch:
        columns = {}
        for field in self._schema.fields:
            there = self._there[field.name]
            null = None if there.all() else ~there
            pool = pools[field.name] if field.type is FieldType.STRING else None
            columns[field.name] = Column(field.type, self._values[field.name], null, pool)
        return SampleBatch(self._available, self._valid, columns)


def _check_apart(one: Content, other: Content) -> None:
    """Refuse two contents whose triples could be of either."""
    if one.feature != other.feature or (one.field, one.roles) == (other.field, other.roles):
        return
    several = len(one.roles) > 1 or len(other.roles) > 1
    objects = [c.roles[0].object if c.roles else None for c in (one, other)]
    if several or None in objects or (objects[0] == objects[1] and one.field != other.field):
        raise ConversionError(
            f"fields {other.field!r} and {one.field!r} are the same feature of objects that may be "
            "the same: their triples cannot be told apart",
            field=one.field,
        )


def _inverse(forth: Conversion) -> Conversion:
    return Conversion(1.0 / forth.factor, -forth.offset / forth.factor)


def _tables_of(triples: TimedTriples, predicate: str) -> Iterable[tuple[TripleRows, ObjectColumn]]:
    id = _find(triples, predicate)
    if id == NO_TERM:
        return
    for table in triples.tables:
        objects = table.objects.get(id)
        if objects is not None:
            yield table, objects


def _find(triples: TimedTriples, iri: str) -> int:
    return triples.dictionary.find(NamedNode(iri))


def _terms(ids: Ids) -> ObjectColumn:
    return ObjectColumn(Kind.TERM, ids)
