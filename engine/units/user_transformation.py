"""A computational unit that runs user-written code as a transformation, object by object
([Introspection15 §3.1, §4.3], [DyKnow10 Def. 5.10]).

`join` runs the same code over the join of KPL streams. Here one stream has all inputs; a
`SynchronizationUnit` has joined them if they were several. The code has a state for each object,
and a class an instance for each object.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np

from ...streams.generator import StreamGenerator
from ...streams.sample import (
    Column,
    FieldType,
    SampleBatch,
    Value,
    column_from_values,
    concatenate,
)
from ...streams.single_sample import Sample
from ...streams.tuples import TupleBatch
from ..model.process_reports import OnReport, Report, ignore_report
from ..processes.call_adapter import Answers, Row, check_pair, samples_of
from ..processes.registry import UnitImplementation
from ..processes.supervision import (
    DIRECT,
    Instance,
    OnEvent,
    ProcessError,
    Runner,
    Supervisor,
)
from .base import ComputationalUnit
from .function import InputPort

Objects: TypeAlias = tuple[Value, ...]
"""The values of a sample's id fields, which name its objects."""


class TransformationUnit(ComputationalUnit):
    """Runs ``implementation`` on the samples of one stream, separately for each object.

    ``ports`` are pairs of an input's name and the field of its value. The code gets a sample for
    each of its inputs, or one with all values if it declares a single input. ``carried`` are pairs
    of an id field of the input and its field of the output. The answer of the code fills the other
    fields. A sample without a value or an object is dropped.

    Law: output, counters and reports do not depend on batch cuts. A batch form must obey this
    itself. Cost: Python per sample in the sample form; in the batch form a call for each object of
    a batch. Memory: the state of each object.
    """

    def __init__(
        self,
        *args: Any,
        implementation: UnitImplementation,
        parameters: Mapping[str, str],
        ports: Sequence[tuple[str, InputPort]],
        id_fields: Sequence[str],
        carried: Sequence[tuple[str, str]],
        on_event: OnEvent,
        on_report: OnReport = ignore_report,
        runner: Runner = DIRECT,
    ) -> None:
        super().__init__(*args)
        self.implementation = implementation
        self.knows_codes = implementation.batch
        """A batch form may keep parts of batches, so the streams must not free their texts."""
        self._code_parameters = dict(parameters)
        self._ports = tuple(ports)
        self._id_fields = tuple(id_fields)
        self._carried = tuple(carried)
        self._answers = Answers(self.output, on_report)
        self._states: dict[Objects, Any] = {}
        self._instances: dict[Objects, Instance[Callable[..., Any]]] = {}
        self._objects: Objects = ()
        self._supervisor = Supervisor(
            implementation.rule,
            runner,
            self.counters,
            self._restart,
            self._stop_by_rule,
            on_event,
        )

    def process(self, source: StreamGenerator, batch: SampleBatch) -> None:
        batch = self._complete(batch)
        if not len(batch):
            return
        inputs = self._inputs_of(batch)
        if self.implementation.batch:
            self._apply_batch(inputs, batch)
        else:
            self._apply_samples(inputs, batch)

    def _complete(self, batch: SampleBatch) -> SampleBatch:
        needed = [batch.columns[port.field] for _, port in self._ports]
        needed += [batch.columns[field] for field in self._id_fields]
        complete = np.logical_and.reduce([column.present for column in needed])
        return batch if bool(complete.all()) else batch.take(complete)

    def _inputs_of(self, batch: SampleBatch) -> tuple[SampleBatch, ...]:
        """Return a batch for each input of the code, in the units of its ports."""
        columns = {name: _convert(batch, port) for name, port in self._ports}
        if len(self.implementation.inputs) == 1:
            return (SampleBatch(batch.available, batch.valid, columns),)
        return tuple(
            SampleBatch(batch.available, batch.valid, {name: column})
            for name, column in columns.items()
        )

    def _objects_of(self, batch: SampleBatch) -> Iterator[Objects]:
        columns = [batch.columns[field].tolist() for field in self._id_fields]
        return zip(*columns, strict=True) if columns else iter([()] * len(batch))

    # -- sample by sample --------------------------------------------------------------------

    def _apply_samples(self, inputs: Sequence[SampleBatch], batch: SampleBatch) -> None:
        samples = zip(*(samples_of(each) for each in inputs), strict=True)
        items = list(
            zip(
                batch.available.tolist(),
                zip(self._objects_of(batch), samples, strict=True),
                strict=True,
            )
        )
        self._supervisor.run(items, self._step, self._answers.offer)

    def _step(self, time: int, item: tuple[Objects, tuple[Sample, ...]]) -> Row | None:
        objects, samples = item
        valid = samples[0].valid
        answer, state = self._call(objects, time, samples)
        row = self._answers.row(self._with_objects(answer, objects), time, valid)
        self._states[objects] = state  # only after `row` has accepted the answer
        return row

    def _with_objects(self, answer: object, objects: Objects) -> object:
        """Return the answer with the carried id fields."""
        if isinstance(answer, Report):
            return replace(answer, answer=self._with_objects(answer.answer, objects))
        has_form = isinstance(answer, SampleBatch) == self.implementation.batch
        if answer is None or not self._carried or not has_form:
            return answer  # `Answers` refuses one of the other form
        values = dict(zip(self._id_fields, objects, strict=True))
        ids = {output: values[field] for field, output in self._carried}
        match answer:
            case Sample():
                return Sample(answer.valid, {**answer.values, **ids}, answer.available)
            case Mapping():
                return {**answer, **ids}
            case SampleBatch():
                columns = dict(answer.columns)
                for output, value in ids.items():
                    columns[output] = _constant(self.output, output, value, len(answer))
                return SampleBatch(answer.available, answer.valid, columns)
            case _:
                others = [name for name in self.output.schema.names if name not in ids]
                if len(others) != 1:
                    raise ProcessError(
                        f"the output has the fields {', '.join(others)}: give a mapping"
                    )
                return {others[0]: answer, **ids}

    # -- batch by batch ----------------------------------------------------------------------

    def _apply_batch(self, inputs: Sequence[SampleBatch], batch: SampleBatch) -> None:
        rows: dict[Objects, list[int]] = {}
        for row, objects in enumerate(self._objects_of(batch)):
            rows.setdefault(objects, []).append(row)
        items = []
        for objects, places in rows.items():
            own = np.array(places)
            part = TupleBatch(
                batch.available[own], batch.valid[own], tuple(inputs), (own,) * len(inputs)
            )
            items.append((int(part.available[0]), (objects, part)))
        results: list[SampleBatch] = []

        def step(time: int, item: tuple[Objects, TupleBatch]) -> SampleBatch | None:
            objects, part = item
            answer, state = self._call(objects, part)
            result = self._answers.batch(self._with_objects(answer, objects), time)
            self._states[objects] = state
            return result

        self._supervisor.run(
            items, step, lambda found: results.extend(each for each in found if each is not None)
        )
        self._offer(results)

    def _offer(self, batches: Sequence[SampleBatch]) -> None:
        """Emit the samples of all objects in order of available time."""
        pools = self.output.stream.pools
        parts = [
            SampleBatch(
                batch.available,
                batch.valid,
                {
                    name: column.recoded(pools[name]) if column.pool is not None else column
                    for name, column in batch.columns.items()
                },
            )
            for batch in batches
        ]
        if parts:
            batch = concatenate(parts)
            self.output.emit(batch.take(np.argsort(batch.available, kind="stable")))
        self._answers.offer_batches(())  # passes the reports on

    # -- the code ----------------------------------------------------------------------------

    def _call(self, objects: Objects, *arguments: Any) -> tuple[object, Any]:
        """Call the code; return the pair ``(sample, new state)``."""
        self._objects = objects
        instance = self._instances.get(objects)
        if instance is None:
            instance = Instance(lambda: self.implementation.make(self._code_parameters))
            self._instances[objects] = instance
        return check_pair(instance.get()(*arguments, self._states.get(objects)))

    def _restart(self) -> None:
        """Drop the state of the object whose sample failed; the others keep theirs."""
        self._states.pop(self._objects, None)
        self._instances.pop(self._objects, None)

    def _stop_by_rule(self, reason: str) -> None:
        self.cut_off(reason)
        self.output.end()


def _convert(batch: SampleBatch, port: InputPort) -> Column:
    column = batch.columns[port.field]
    if port.conversion.is_identity:
        return column
    values = port.conversion.apply(column.values.astype(np.float64))
    return Column(FieldType.FLOAT, values, column.null)


def _constant(output: StreamGenerator, name: str, value: Value, length: int) -> Column:
    field = output.schema.get(name)
    assert field is not None
    return column_from_values(field, [value] * length, output.stream.pools.get(name))
