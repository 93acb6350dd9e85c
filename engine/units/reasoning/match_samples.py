"""The matches of a pattern as samples."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from ....converters.objects import object_name
from ....languages.mtl.checked import Kind
from ....rdf.namespaces import DYKNOW
from ....reasoning.patterns.plans.plan import NO_VALUE
from ....reasoning.patterns.plans.query import END, START, Keys, PatternQuery, integers_of, lists_of
from ....reasoning.patterns.recognition.explanation import Told
from ....reasoning.patterns.recognition.recognition import Recognized
from ....streams.sample import (
    Column,
    Field,
    FieldType,
    Schema,
    column_from_values,
    column_of_texts,
)
from ....streams.string_pool import StringPool
from ....streams.time import format_time

_TYPES = {
    Kind.NUMBER: FieldType.FLOAT,
    Kind.TRUTH: FieldType.BOOLEAN,
    Kind.TEXT: FieldType.STRING,
    Kind.TIME: FieldType.STRING,
    Kind.OBJECT: FieldType.STRING,
}


def match_schema(query: PatternQuery) -> Schema:
    """Return the fields of a pattern's matches: the results, then the times of start and end."""
    lists, integers = lists_of(query), integers_of(query)
    results = []
    for each in query.results:
        type = FieldType.STRING if each.name in lists else _TYPES[each.kind]
        if type is FieldType.FLOAT and each.name in integers:
            type = FieldType.INTEGER
        results.append(Field(each.name, type))
    return Schema((*results, Field(START, FieldType.STRING), Field(END, FieldType.STRING)))


class MatchWriter:
    """Writes matches as samples: numbers and truths as they are, texts, names of objects, times in
    ISO-8601, and lists in JSON."""

    def __init__(self, query: PatternQuery, keys: Keys) -> None:
        self._keys = keys
        self._results = {each.name: each for each in query.results}
        self._lists = lists_of(query)
        self._fields = match_schema(query).fields

    def columns(self, found: Recognized, pools: Mapping[str, StringPool]) -> dict[str, Column]:
        """Return the columns of a batch of matches."""
        return {
            field.name: self._column(field, found.outputs[field.name], pools.get(field.name))
            for field in self._fields
        }

    def values(self, found: Recognized, match: int) -> dict[str, Told]:
        """Return the results of one match."""
        return {name: self._told(name, found.outputs[name][match]) for name in self._results}

    def value(self, kind: Kind, value: Any) -> Told:
        """Return a value of a column of the plans; None if it is missing."""
        if value is None or value == NO_VALUE or value != value:
            return None
        match kind:
            case Kind.TIME:
                return format_time(int(value))
            case Kind.TRUTH:
                return bool(value)
            case Kind.TEXT:
                return self._keys.key(int(value))[1:]
            case Kind.OBJECT:
                return object_name(self._keys.key(int(value))[1:-1], DYKNOW)
            case Kind.NUMBER | Kind.DURATION:
                return float(value)

    def _told(self, name: str, value: Any) -> Told:
        result = self._results[name]
        if name in self._lists:
            told = [self.value(result.kind, each) for each in value.tolist()]
            return json.dumps(told, ensure_ascii=False)
        return self.value(result.kind, value)

    def _column(self, field: Field, values: Any, pool: StringPool | None) -> Column:
        if field.name in (START, END):
            return column_of_texts(values.tolist(), format_time, pool)
        if field.type is FieldType.INTEGER:
            return Column(field.type, values, values == NO_VALUE)
        if field.type is FieldType.FLOAT:
            is_missing = np.isnan(values) if values.dtype == np.float64 else values == NO_VALUE
            return Column(field.type, values.astype(np.float64), is_missing)
        told = partial(self._told, field.name)
        if field.type is FieldType.BOOLEAN or field.name in self._lists:
            return column_from_values(field, [told(each) for each in values], pool)
        return column_of_texts(values.tolist(), told, pool)
