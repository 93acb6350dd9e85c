"""The unit that joins several streams object by object, for a transformation whose inputs are in
different streams ([Introspection15 §4.3-4.4]).

The kernel is streams/joins/keyed_join.py. It differs from KPL's `sync`, whose states have one valid
time: here each input contributes its latest sample (Def. 5.11).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...converters.objects import ObjectTable
from ...ontology.units import Conversion
from ...streams.generator import StreamGenerator
from ...streams.joins.keyed_join import KeyedJoin
from ...streams.key_numbering import Numbering, paired
from ...streams.sample import Column, Field, FieldType, SampleBatch, Schema
from ...streams.string_pool import StringPool
from ...streams.tuples import TupleBatch
from .base import ComputationalUnit

_NUMBERS = (FieldType.FLOAT, FieldType.INTEGER)


@dataclass(frozen=True, slots=True)
class TakenField:
    """A field of an input that becomes a field of the output, with the conversion into its unit."""

    source_field: str
    target_field: str
    conversion: Conversion


class SynchronizationUnit(ComputationalUnit):
    """Emits a sample for an object whenever an input has a new one and all inputs have one: the
    fields of the latest sample of each input. `KeyedJoin` defines the times.

    ``keys`` are the id fields of each input; an input without any joins with every object. All
    keyed inputs have the same number of id fields, in the same order of roles. ``objects`` returns
    a table that maps the names in an input to objects: the same object may have another id in
    another stream. ``id_fields`` are pairs (id field of the first keyed input, field of the
    output); the output has the ids of that input. The output has the schema and pools of
    `schema_of`, or is open and adopts them.

    Numbers are converted and become floats; strings and booleans stay as they are. A sample without
    a value in one of the fields is dropped and counted in `incomplete`, a sample without an object
    in `keyless`. Two inputs may be the same stream.

    Law (tests): the output does not depend on batch cuts. Cost: O(n log n) numpy for n decided
    samples, O(1) Python a batch, and an IRI for each new name. Integer ids cost Python for each
    distinct one in a batch (`ObjectTable`). Memory: the latest sample of each object and input.
    """

    def __init__(
        self,
        *args: Any,
        ports: Sequence[Sequence[TakenField]],
        keys: Sequence[tuple[str, ...]],
        id_fields: tuple[tuple[str, str], ...],
        objects: Callable[[StreamGenerator], ObjectTable],
    ) -> None:
        super().__init__(*args)
        self.output.adopt(*schema_of(self.inputs, ports, keys, id_fields))
        self._ports = tuple(tuple(own) for own in ports)
        self._keys = tuple(keys)
        first = _first_keyed(keys)
        self._ids = [id_fields if i == first else () for i in range(len(keys))]
        self._objects = [
            [objects(source) for _ in own] for source, own in zip(self.inputs, keys, strict=True)
        ]
        arity = 0 if first is None else len(keys[first])
        # A 64-bit key has room for two ids. With more, number the pairs before adding the next id.
        self._numberings = [Numbering() for _ in range(arity - 2)]
        self._join = KeyedJoin([bool(own) for own in keys], self.output.rules)
        self.incomplete = 0
        """Samples without a value, counted for each input that they are in."""

    @property
    def keyless(self) -> int:
        """Samples without an object."""
        return self._join.keyless

    @property
    def retained(self) -> int:
        """The number of samples in memory: the waiting ones, and the latest of each object and
        input."""
        return self._join.retained

    def process(self, source: StreamGenerator, batch: SampleBatch) -> None:
        for place in self._places(source):
            samples, keys = self._samples(place, batch)
            if len(samples):
                self._offer(self._join.push(place, samples, keys))
            # Dropped samples advance the input, too.
            self._offer(self._join.advance(place, source.promise_after(batch)))
        self._promise()

    def decided(self, source: StreamGenerator) -> int:
        # Equal for all places of one stream, which get the same calls.
        return self._join.decided(self._places(source)[0])

    def resume(self, source: StreamGenerator) -> None:
        super().resume(source)
        for place in self._places(source):
            self._join.resume(place)

    def progress(self, source: StreamGenerator, watermark: int) -> None:
        for place in self._places(source):
            self._offer(self._join.advance(place, watermark))
        self._promise()

    def finish(self, source: StreamGenerator) -> None:
        for place in self._places(source):
            self._offer(self._join.end(place))
        self._promise()
        super().finish(source)

    def _places(self, source: StreamGenerator) -> list[int]:
        return [i for i, given in enumerate(self.inputs) if given is source]

    def _promise(self) -> None:
        known = self._join.known
        if known is not None and not self.all_ended:
            self.output.advance(max(known, self._join.reached) + 1)

    def _offer(self, tuples: TupleBatch | None) -> None:
        if tuples is not None:
            flat = tuples.flatten([tuple(batch.columns) for batch in tuples.inputs])
            columns = {name: flat.columns[name] for name in self.output.schema.names}
            self.output.emit(SampleBatch(flat.available, flat.valid, columns))

    def _samples(self, place: int, batch: SampleBatch) -> tuple[SampleBatch, Column | None]:
        """Return the complete samples of an input with the fields of the output, and their keys."""
        values = {
            port.target_field: _convert(batch.columns[port.source_field], port.conversion)
            for port in self._ports[place]
        }
        nulls = [column.null for column in values.values() if column.null is not None]
        if nulls and bool((incomplete := np.logical_or.reduce(nulls)).any()):
            self.incomplete += int(np.count_nonzero(incomplete))
            rows = np.flatnonzero(~incomplete)
            batch = batch.take(rows)
            values = {name: column.take(rows) for name, column in values.items()}
        columns = {
            name: Column(column.type, column.values, None, column.pool)
            for name, column in values.items()
        }
        columns |= {target: batch.columns[field] for field, target in self._ids[place]}
        return SampleBatch(batch.available, batch.valid, columns), self._keys_of(place, batch)

    def _keys_of(self, place: int, batch: SampleBatch) -> Column | None:
        """Return a key for the objects that the id fields name; None for an input without any."""
        if not self._keys[place]:
            return None
        keys, null = np.zeros(len(batch), np.int64), np.zeros(len(batch), np.bool_)
        for k, (field, table) in enumerate(
            zip(self._keys[place], self._objects[place], strict=True)
        ):
            ids, present = table.ids(batch.columns[field])
            null |= ~present
            own = np.where(present, ids, 0).astype(np.int64)
            if k > 1:
                keys = self._numberings[k - 2].of(keys)
            keys = paired(keys, own) if k else own
        return Column(FieldType.INTEGER, keys, null if bool(null.any()) else None)


def schema_of(
    inputs: Sequence[StreamGenerator],
    ports: Sequence[Sequence[TakenField]],
    keys: Sequence[tuple[str, ...]],
    id_fields: Sequence[tuple[str, str]],
) -> tuple[Schema, dict[str, StringPool]]:
    """Return the schema of a `SynchronizationUnit`'s output, ids first, and the pools of its string
    fields, which are those of the inputs.

    Raises `ValueError` if inputs, ports and keys do not fit together: for a missing field, a string
    or boolean with another unit, keyed inputs of different arity, a repeated name.
    """
    if not len(inputs) == len(ports) == len(keys):
        raise ValueError(f"{len(inputs)} inputs, {len(ports)} lists of fields, {len(keys)} of ids")
    if len({len(own) for own in keys if own}) > 1:
        raise ValueError("all keyed inputs need the same number of id fields")
    for source, own in zip(inputs, keys, strict=True):
        for name in own:
            if _field(source, name).type not in (FieldType.STRING, FieldType.INTEGER):
                raise ValueError(f"id field {_name_of(source, name)} is not a string or integer")
    fields: list[Field] = []
    pools: dict[str, StringPool] = {}
    first = _first_keyed(keys)
    for name, target in id_fields:
        if first is None or name not in keys[first]:
            raise ValueError(f"{name!r} is not an id field of the first keyed input")
        fields.append(Field(target, _field(inputs[first], name).type))
        if fields[-1].type is FieldType.STRING:
            pools[target] = inputs[first].stream.pools[name]
    for source, own_ports in zip(inputs, ports, strict=True):
        for port in own_ports:
            kind = _field(source, port.source_field).type
            is_number = kind in _NUMBERS
            if not is_number and not port.conversion.is_identity:
                raise ValueError(
                    f"field {_name_of(source, port.source_field)} is a {kind}, which has no unit"
                )
            fields.append(Field(port.target_field, FieldType.FLOAT if is_number else kind))
            if kind is FieldType.STRING:
                pools[port.target_field] = source.stream.pools[port.source_field]
    return Schema(tuple(fields)), pools


def _field(source: StreamGenerator, name: str) -> Field:
    field = source.schema.get(name)
    if field is None:
        raise ValueError(f"there is no field {_name_of(source, name)}")
    return field


def _name_of(source: StreamGenerator, name: str) -> str:
    return f"{name!r} of stream {source.name!r}"


def _first_keyed(keys: Sequence[tuple[str, ...]]) -> int | None:
    return next((i for i, own in enumerate(keys) if own), None)


def _convert(column: Column, conversion: Conversion) -> Column:
    """Convert numbers to floats in the other unit, and to no value beyond the range of floats.
    Return other columns as they are."""
    if column.type not in _NUMBERS:
        return column
    values, null = column.values.astype(np.float64), column.null
    if not conversion.is_identity:
        with np.errstate(over="ignore", invalid="ignore"):
            values = conversion.apply(values)
        overflow = ~np.isfinite(values)
        if bool(overflow.any()):
            null = overflow if null is None else null | overflow
    return Column(FieldType.FLOAT, values, null)
