"""What an EP-SPARQL pattern reads from streams, and the fields of its results (SPEC §8)."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Final, TypeAlias

from ....languages.epsparql.checked import Item, Place, Sample, Value, Variable
from ....languages.mtl.checked import Constant, Kind, ObjectConstant
from ....rdf.namespaces import local_name
from ..plans.plan import Column, ColumnType
from ..plans.query import (
    Argument,
    Part,
    Result,
    Source,
    SourceColumn,
    column_type,
    object_column,
)

Argued: TypeAlias = Mapping[str, Constant | ObjectConstant]
VALUES: Final = {
    ColumnType.NUMBER: "number",
    ColumnType.INTEGER: "integer",
    ColumnType.KEY: "key",
}
"""The columns of values; those of objects are ``object 1``, ``object 2`` …"""


class PatternSources:
    """The sources of ``samples``, one for each feature and the objects meant; ``kinds`` has the
    name of each sample's source, ``columns`` are those of all. ``arguments``: the values of
    parameters."""

    def __init__(self, samples: tuple[Sample, ...], arguments: Argued) -> None:
        self.arguments = arguments
        self._samples = samples
        self._sources: dict[tuple[str, tuple[Argument, ...]], Source] = {}
        self.kinds = tuple(self._source(sample).kind for sample in samples)
        count = max(len(sample.arguments) for sample in samples)
        self.columns = (
            *(Column(object_column(i), ColumnType.KEY) for i in range(count)),
            *(Column(name, type) for type, name in VALUES.items()),
        )

    @property
    def sources(self) -> tuple[Source, ...]:
        return tuple(self._sources.values())

    def _source(self, sample: Sample) -> Source:
        arguments = tuple(self._argument(place, sort) for place, sort in sample.arguments)
        key = sample.feature, arguments
        if key not in self._sources:
            base = local_name(sample.feature)
            used = {each.kind for each in self._sources.values()}
            names = itertools.chain([base], (f"{base} {i}" for i in itertools.count(2)))
            name = next(each for each in names if each not in used)
            columns = [
                SourceColumn(object_column(i), Part.OBJECT, Kind.OBJECT, i)
                for i in range(len(arguments))
            ]
            value = VALUES[column_type(sample.kind)]
            columns.append(SourceColumn(value, Part.VALUE, sample.kind))
            self._sources[key] = Source(name, sample.feature, arguments, tuple(columns))
        return self._sources[key]

    def _argument(self, place: Place, sort: str) -> Argument:
        found = self.constant(place)
        return Argument(sort, found.iri if isinstance(found, ObjectConstant) else None)

    def constant(self, place: Value) -> Value:
        """A place, or the value that a request gives for it."""
        return self.arguments.get(place.name, place) if isinstance(place, Variable) else place

    def result(self, item: Item) -> Result:
        """The field of an item of the head."""
        kind = Kind.NUMBER if item.kind == Kind.DURATION else item.kind
        value = self.constant(item.value)
        argument = None
        if isinstance(value, ObjectConstant):
            argument = Argument(None, value.iri)
        elif isinstance(value, Variable):
            argument = next(
                (
                    self._argument(place, sort)
                    for sample in self._samples
                    for place, sort in sample.arguments
                    if place == value
                ),
                None,
            )
        return Result(item.name, kind, argument, item.predicate)
