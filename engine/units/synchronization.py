"""The unit that makes one stream of several, object by object, for a transformation whose inputs
stand in different streams ([Introspection15 §4.3-4.4]).

The kernel is streams/joins/keyed_join.py. It is another thing than `sync` of KPL, whose states are
of one valid time: here each input stands with its latest sample (Def. 5.11).
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
    """A sample for an object whenever one of it comes and all inputs have something to say of it:
    the fields of the latest sample of each input. When that is says `KeyedJoin`.

    ``keys`` are the id fields of each input; none: it is about one object that stands for all. All
    keyed inputs have as many, in the same order of roles. Who is the same object says ``objects``,
    which gives a table of an input's names that keeps them: an object is the same however
    its id is spelled in different streams. ``id_fields`` are pairs (id field of the first
    keyed input, field of the output); there an id is spelled as in that input. The output has the
    schema and pools of `schema_of`, or is open and gets them.

    Numbers are converted and become floats; text and booleans stay as they are. A sample that
    lacks a value of those fields is no sample of its input, and counted in `incomplete`; one that
    names no object in `keyless`. The same stream may be given twice, as two inputs.

    Law (tests): what it makes does not depend on batch cuts. Cost: O(n log n) numpy for n samples
    decided, O(1) Python a batch, and an IRI for each name that is new. Integer ids cost Python a
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
        # Two ids are one key; of more, the first ones are numbered before the next is added.
        self._numberings = [Numbering() for _ in range(arity - 2)]
        self._join = KeyedJoin([bool(own) for own in keys], self.output.rules)
        self.incomplete = 0
        """Samples that lack a value; of a stream that is given twice counted for each input."""

    @property
    def keyless(self) -> int:
        """Samples that name no object."""
        return self._join.keyless

    @property
    def retained(self) -> int:
        """How many samples are kept: those that wait, and the latest of each object and input."""
        return self._join.retained

    def process(self, source: StreamGenerator, batch: SampleBatch) -> None:
        for place in self._places(source):
            samples, keys = self._samples(place, batch)
            if len(samples):
                self._offer(self._join.push(place, samples, keys))
            # What was left out has been there too.
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
            made = tuples.flatten([tuple(batch.columns) for batch in tuples.inputs])
            columns = {name: made.columns[name] for name in self.output.schema.names}
            self.output.emit(SampleBatch(made.available, made.valid, columns))

    def _samples(self, place: int, batch: SampleBatch) -> tuple[SampleBatch, Column | None]:
        """What an input gives to the output, where no value is missing, and the keys of that."""
        taken = {
            port.target_field: _converted(batch.columns[port.source_field], port.conversion)
            for port in self._ports[place]
        }
        lacking = [column.null for column in taken.values() if column.null is not None]
        if lacking and bool((incomplete := np.logical_or.reduce(lacking)).any()):
            self.incomplete += int(np.count_nonzero(incomplete))
            rows = np.flatnonzero(~incomplete)
            batch = batch.take(rows)
            taken = {name: column.take(rows) for name, column in taken.items()}
        columns = {
            name: Column(column.type, column.values, None, column.pool)
            for name, column in taken.items()
        }
        columns |= {target: batch.columns[field] for field, target in self._ids[place]}
        return SampleBatch(batch.available, batch.valid, columns), self._keys_of(place, batch)

    def _keys_of(self, place: int, batch: SampleBatch) -> Column | None:
        """A key for the objects that the id fields name together; None for a constant input."""
        if not self._keys[place]:
            return None
        keys, null = np.zeros(len(batch), np.int64), np.zeros(len(batch), np.bool_)
        named = zip(self._keys[place], self._objects[place], strict=True)
        for k, (field, table) in enumerate(named):
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
    """The fields of a `SynchronizationUnit`'s output, ids first, and the pools of its text fields,
    which are those of the inputs.

    Raises `ValueError` where inputs, ports and keys do not fit together: a field that is not
    there, a text or boolean with another unit, keyed inputs of different arity, a name twice.
    """
    if not len(inputs) == len(ports) == len(keys):
        raise ValueError(f"{len(inputs)} inputs, {len(ports)} lists of fields, {len(keys)} of ids")
    if len({len(own) for own in keys if own}) > 1:
        raise ValueError("all keyed inputs name objects by as many fields")
    for source, own in zip(inputs, keys, strict=True):
        for name in own:
            if _field(source, name).type not in (FieldType.STRING, FieldType.INTEGER):
                raise ValueError(f"id field {_called(source, name)} is neither text nor integer")
    fields: list[Field] = []
    pools: dict[str, StringPool] = {}
    first = _first_keyed(keys)
    for name, target in id_fields:
        if first is None or name not in keys[first]:
            raise ValueError(f"{name!r} is no id field of the first keyed input")
        fields.append(Field(target, _field(inputs[first], name).type))
        if fields[-1].type is FieldType.STRING:
            pools[target] = inputs[first].stream.pools[name]
    for source, taken in zip(inputs, ports, strict=True):
        for port in taken:
            kind = _field(source, port.source_field).type
            is_number = kind in _NUMBERS
            if not is_number and not port.conversion.is_identity:
                raise ValueError(
                    f"field {_called(source, port.source_field)} is a {kind}: it has no unit"
                )
            fields.append(Field(port.target_field, FieldType.FLOAT if is_number else kind))
            if kind is FieldType.STRING:
                pools[port.target_field] = source.stream.pools[port.source_field]
    return Schema(tuple(fields)), pools


def _field(source: StreamGenerator, name: str) -> Field:
    field = source.schema.get(name)
    if field is None:
        raise ValueError(f"there is no field {_called(source, name)}")
    return field


def _called(source: StreamGenerator, name: str) -> str:
    return f"{name!r} of stream {source.name!r}"


def _first_keyed(keys: Sequence[tuple[str, ...]]) -> int | None:
    return next((i for i, own in enumerate(keys) if own), None)


def _converted(column: Column, conversion: Conversion) -> Column:
    """A number as a float in the other unit, no value where that is beyond floats; else itself."""
    if column.type not in _NUMBERS:
        return column
    values, null = column.values.astype(np.float64), column.null
    if not conversion.is_identity:
        with np.errstate(over="ignore", invalid="ignore"):
            values = conversion.apply(values)
        beyond = ~np.isfinite(values)
        if bool(beyond.any()):
            null = beyond if null is None else null | beyond
    return Column(FieldType.FLOAT, values, null)
