"""Tuples of samples of several streams, in columns: what `join` and synchronization give.

A row is ⟨available, valid, [s1 … sn]⟩ where each s_i is a row of input i's batch, or -1: then it
is no_sample in a join (Def. 5.11), no_value in a state (SPEC §1). Nothing is copied: the inputs'
batches are shared, and rows are indices into them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .sample import Column, Field, FieldType, SampleBatch, Schema, Times

Rows: TypeAlias = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class TupleBatch:
    """``available`` and ``valid`` in ns, shape ``(n,)``; ``rows[i]``, shape ``(n,)``, says which
    sample of ``inputs[i]`` stands in each tuple, -1 for none."""

    available: Times
    valid: Times
    inputs: tuple[SampleBatch, ...]
    rows: tuple[Rows, ...]

    def __len__(self) -> int:
        return len(self.available)

    def take(self, chosen: NDArray[np.bool_] | NDArray[np.int64] | slice) -> TupleBatch:
        """The tuples at ``chosen`` (a mask, indices or a slice), in that order."""
        rows = tuple(row[chosen] for row in self.rows)
        return TupleBatch(self.available[chosen], self.valid[chosen], self.inputs, rows)

    def compact(self) -> TupleBatch:
        """The same tuples over as much of the inputs as they name: for keeping."""
        inputs, rows = [], []
        for batch, row in zip(self.inputs, self.rows, strict=True):
            used = np.unique(row[row >= 0])
            inputs.append(batch.take(used))
            rows.append(np.where(row < 0, -1, np.searchsorted(used, row)))
        return TupleBatch(self.available, self.valid, tuple(inputs), tuple(rows))

    def column(self, input: int, field: str) -> Column:
        """A field of input ``input``, one value a tuple; null where there is no sample."""
        return spread(self.inputs[input].columns[field], self.rows[input])

    def times(self, input: int, which: str) -> Column:
        """``available`` or ``valid`` of input ``input``'s samples, null where there is none."""
        values: Times = getattr(self.inputs[input], which)
        return spread(Column(FieldType.INTEGER, values), self.rows[input])

    def tuples(self) -> Iterator[tuple[int, int, tuple[int | None, ...]]]:
        """Each as ``(available, valid, row of each input or None)``: for edges and tests."""
        rows = [row.tolist() for row in self.rows]
        for k, (available, valid) in enumerate(
            zip(self.available.tolist(), self.valid.tolist(), strict=True)
        ):
            yield available, valid, tuple(None if row[k] < 0 else row[k] for row in rows)

    def flatten(self, names: Sequence[Sequence[str]], times: bool = False) -> SampleBatch:
        """One sample a tuple: ``names[i]`` are what the fields of input i (in its batch's order)
        are called; with ``times`` each input's available and valid time come along, called
        ``names[i][-2]`` and ``names[i][-1]``. `flat_names` makes such names."""
        columns: dict[str, Column] = {}
        for i, batch in enumerate(self.inputs):
            for name, field in zip(names[i], batch.columns, strict=False):
                columns[name] = self.column(i, field)
            if times:
                columns[names[i][-2]] = self.times(i, "available")
                columns[names[i][-1]] = self.times(i, "valid")
        return SampleBatch(self.available, self.valid, columns)


def spread(column: Column, rows: Rows) -> Column:
    """``column`` at ``rows``, null where a row is negative. Cost: O(n) numpy."""
    absent = rows < 0
    if not len(column):
        empty = np.zeros(len(rows), column.type.dtype)
        return Column(column.type, empty, np.ones(len(rows), np.bool_), column.pool)
    found = column.take(np.maximum(rows, 0))
    if not bool(absent.any()):
        return found
    null = absent if found.null is None else absent | found.null
    return Column(column.type, found.values, null, column.pool)


def flat_names(
    labels: Sequence[str], schemas: Sequence[Schema], times: bool = False
) -> list[list[str]]:
    """Distinct field names for flattened tuples: the input's label where it has one field, else
    ``label_field``; equal names get ``_2``, ``_3`` …"""
    taken: set[str] = set()

    def distinct(wanted: str) -> str:
        name, count = wanted, 1
        while name in taken:
            count += 1
            name = f"{wanted}_{count}"
        taken.add(name)
        return name

    names = []
    for label, schema in zip(labels, schemas, strict=True):
        fields = schema.names
        own = [distinct(label if len(fields) == 1 else f"{label}_{field}") for field in fields]
        if times:
            own += [distinct(f"{label}_available"), distinct(f"{label}_valid")]
        names.append(own)
    return names


def flat_schema(
    names: Sequence[Sequence[str]], schemas: Sequence[Schema], times: bool = False
) -> Schema:
    """The schema of samples flattened under ``names`` of `flat_names`."""
    fields: list[Field] = []
    for own, schema in zip(names, schemas, strict=True):
        fields += [Field(name, field.type) for name, field in zip(own, schema.fields, strict=False)]
        if times:
            fields += [Field(name, FieldType.INTEGER) for name in own[-2:]]
    return Schema(tuple(fields))
