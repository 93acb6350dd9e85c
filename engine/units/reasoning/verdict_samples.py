"""The verdicts of a monitor as samples."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from typing import Any

from numpy.typing import NDArray

from ....converters.objects import object_name
from ....languages.mtl.ast import Report
from ....languages.mtl.checked import CheckedMonitor
from ....rdf.namespaces import DYKNOW
from ....reasoning.mtl.monitoring import (
    DECIDED,
    LAST,
    ROBUSTNESS,
    VERDICT,
    WITNESS,
    WORDS,
    Reported,
)
from ....streams.sample import Column, Field, FieldType, Schema, column_from_values
from ....streams.string_pool import StringPool
from ....streams.time import TIME_MIN, format_time


def verdict_schema(monitor: CheckedMonitor) -> Schema:
    """Return the fields of a monitor's verdicts: the objects by the names of the parameters, the
    verdict, the times of the deciding state and of the witness; of a run the time of its last
    start; and by how much the verdict holds, where that is asked for."""
    names = [name for name, _ in monitor.parameters]
    results = [VERDICT, DECIDED, WITNESS, *([LAST] if monitor.report is Report.CHANGES else [])]
    fields = [Field(name, FieldType.STRING) for name in (*names, *results)]
    if monitor.robustness:
        fields.append(Field(ROBUSTNESS, FieldType.FLOAT))
    return Schema(tuple(fields))


class VerdictWriter:
    """Writes verdicts as samples: names of objects, words, and times in ISO-8601."""

    def __init__(self, monitor: CheckedMonitor) -> None:
        self._parameters = [name for name, _ in monitor.parameters]
        self._fields = verdict_schema(monitor).fields

    def columns(
        self, found: Reported, objects: NDArray[Any], pools: Mapping[str, StringPool]
    ) -> dict[str, Column]:
        """Return the columns of a batch of verdicts. ``objects``: the IRIs of each parameter's
        objects, shape ``(parameters, n)``."""
        columns: dict[str, list[Any]] = {}
        for name, iris in zip(self._parameters, objects, strict=True):
            names = {iri: object_name(iri, DYKNOW) for iri in set(iris)}
            columns[name] = [names[iri] for iri in iris]
        columns[VERDICT] = [WORDS[value] for value in found.value.tolist()]
        columns[DECIDED] = list(map(format_time, found.decided.tolist()))
        columns[WITNESS] = [
            None if time == TIME_MIN else format_time(time) for time in found.witness.tolist()
        ]
        columns[LAST] = list(map(format_time, found.last.tolist()))
        if found.robustness is not None:
            # An infinite margin is one that no number changes.
            margins = found.robustness.tolist()
            columns[ROBUSTNESS] = [each if isfinite(each) else None for each in margins]
        return {
            field.name: column_from_values(field, columns[field.name], pools.get(field.name))
            for field in self._fields
        }
