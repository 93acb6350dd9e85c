"""The verdicts of a monitor as samples."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
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
from ....streams.sample import Column, Field, FieldType, Schema, column_of_texts
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
        texts: dict[str, tuple[NDArray[Any], Callable[[Any], str | None]]] = {
            VERDICT: (found.value, WORDS.__getitem__),
            DECIDED: (found.decided, format_time),
            WITNESS: (found.witness, _witness_text),
            LAST: (found.last, format_time),
        }
        for name, iris in zip(self._parameters, objects, strict=True):
            texts[name] = iris, _name
        columns = {}
        for field in self._fields:
            if field.type is FieldType.FLOAT:
                columns[field.name] = _margins(found)
            else:
                values, text = texts[field.name]
                columns[field.name] = column_of_texts(values.tolist(), text, pools.get(field.name))
        return columns


def _name(iri: str) -> str:
    return object_name(iri, DYKNOW)


def _witness_text(time: int) -> str | None:
    return None if time == TIME_MIN else format_time(time)


def _margins(found: Reported) -> Column:
    assert found.robustness is not None
    # An infinite margin is one that no number changes.
    known = np.isfinite(found.robustness)
    null = None if known.all() else ~known
    return Column(FieldType.FLOAT, np.where(known, found.robustness, 0.0), null)
