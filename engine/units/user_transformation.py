"""A computational unit that runs user-written code as a transformation, object by object
([Introspection15 §3.1, §4.3], [DyKnow10 Def. 5.10]).

`join` runs the same code over the join of KPL streams; here one stream brings all inputs
(synchronized before, if they were several), and the samples of each object are a stream of their
own: with its own state, and of a class with its own instance.
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
from ..processes.call_adapter import Answers, Row, samples_of
from ..processes.registry import UnitImplementation
from ..processes.supervision import (
    DIRECT,
    Instance,
    ProcessError,
    Runner,
    Supervisor,
    Tell,
)
from .base import ComputationalUnit
from .function import InputPort

Objects: TypeAlias = tuple[Value, ...]
"""The values of the id fields of a sample: whose it is."""


class TransformationUnit(ComputationalUnit):
    """Runs ``implementation`` on the samples of one stream, each object by itself.

    ``ports`` are pairs of an input's name and where its value comes from; the code gets a sample
    for each of its inputs, or one with all values where it declares a single input. ``carried``
    are pairs of an id field of the input and of the output: the objects pass through. What the
    code answers stands in the output's other fields. A sample that lacks a value or an object
    gives nothing.

    Law: output, counters and what is told do not depend on batch cuts; a batch form has to keep
    that by itself. Cost: Python per sample in the sample form; in the batch form a call for each
    object of a batch. Memory: the state of each object.
    """

    def __init__(
        self,
        *args: Any,
        implementation: UnitImplementation,
        parameters: Mapping[str, str],
        ports: Sequence[tuple[str, InputPort]],
        id_fields: Sequence[str],
        carried: Sequence[tuple[str, str]],
        on_event: Tell,
        on_report: OnReport = ignore_report,
        runner: Runner = DIRECT,
    ) -> None:
        super().__init__(*args)
        self.implementation = implementation
        self.knows_codes = implementation.batch
        """Batches are the user's, to keep what he likes."""
        self._code = dict(parameters)
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
        """A batch for each input of the code, converted."""
        columns = {name: _converted(batch, port) for name, port in self._ports}
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
        made, state = self._call(objects, time, samples)
        row = self._answers.row(self._with_objects(made, objects), time, valid)
        self._states[objects] = state  # kept once the sample is fit
        return row

    def _with_objects(self, made: object, objects: Objects) -> object:
        """The answer, with the objects that pass through."""
        if isinstance(made, Report):
            return replace(made, answer=self._with_objects(made.answer, objects))
        if made is None or not self._carried:
            return made
        named = dict(zip(self._id_fields, objects, strict=True))
        ids = {output: named[field] for field, output in self._carried}
        match made:
            case Sample():
                return Sample(made.valid, {**made.values, **ids}, made.available)
            case Mapping():
                return {**made, **ids}
            case _:
                others = [name for name in self.output.schema.names if name not in ids]
                if len(others) != 1:
                    raise ProcessError(
                        f"the output has the fields {', '.join(others)}: name which one"
                    )
                return {others[0]: made, **ids}

    # -- batch by batch ----------------------------------------------------------------------

    def _apply_batch(self, inputs: Sequence[SampleBatch], batch: SampleBatch) -> None:
        rows: dict[Objects, list[int]] = {}
        for row, objects in enumerate(self._objects_of(batch)):
            rows.setdefault(objects, []).append(row)
        items = []
        for objects, places in rows.items():
            chosen = np.array(places)
            part = TupleBatch(
                batch.available[chosen], batch.valid[chosen], tuple(inputs), (chosen,) * len(inputs)
            )
            items.append((int(part.available[0]), (objects, part)))
        made: list[tuple[Objects, SampleBatch]] = []

        def step(time: int, item: tuple[Objects, TupleBatch]) -> tuple[Objects, SampleBatch] | None:
            objects, part = item
            answer, state = self._call(objects, part)
            checked = self._checked(answer, time, objects)
            self._states[objects] = state
            return None if checked is None else (objects, checked)

        self._supervisor.run(items, step, lambda found: made.extend(filter(None, found)))
        self._offer([part for _, part in made])

    def _checked(self, answer: object, time: int, objects: Objects) -> SampleBatch | None:
        if isinstance(answer, Report):
            made = self._named(answer.answer, objects)
            return self._answers.batch(replace(answer, answer=made), time)
        return self._answers.batch(self._named(answer, objects), time)

    def _named(self, answer: object, objects: Objects) -> object:
        """The samples, with the objects that pass through."""
        if isinstance(answer, SampleBatch) and self._carried:
            named = dict(zip(self._id_fields, objects, strict=True))
            columns = dict(answer.columns)
            for field, output in self._carried:
                columns[output] = _constant(self.output, output, named[field], len(answer))
            return SampleBatch(answer.available, answer.valid, columns)
        return answer

    def _offer(self, batches: Sequence[SampleBatch]) -> None:
        """The objects' samples together, in order of available time."""
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
            whole = concatenate(parts)
            self.output.emit(whole.take(np.argsort(whole.available, kind="stable")))
        self._answers.offer_batches(())

    # -- the code ----------------------------------------------------------------------------

    def _call(self, objects: Objects, *arguments: Any) -> tuple[object, Any]:
        """The pair ``(sample, new state)``."""
        self._objects = objects
        instance = self._instances.get(objects)
        if instance is None:
            instance = Instance(lambda: self.implementation.make(self._code))
            self._instances[objects] = instance
        answer = instance.get()(*arguments, self._states.get(objects))
        if not isinstance(answer, tuple) or len(answer) != 2:
            raise ProcessError(
                f"a unit gives a pair (sample, new state), got {type(answer).__name__}: "
                "`return None, state` gives no sample"
            )
        return answer

    def _restart(self) -> None:
        """The object whose sample failed begins anew; the others go on."""
        self._states.pop(self._objects, None)
        self._instances.pop(self._objects, None)

    def _stop_by_rule(self, reason: str) -> None:
        self.cut_off(reason)
        self.output.end()


def _converted(batch: SampleBatch, port: InputPort) -> Column:
    column = batch.columns[port.field]
    if port.conversion.is_identity:
        return column
    values = port.conversion.apply(column.values.astype(np.float64))
    return Column(FieldType.FLOAT, values, column.null)


def _constant(output: StreamGenerator, name: str, value: Value, length: int) -> Column:
    field = output.schema.get(name)
    assert field is not None
    return column_from_values(field, [value] * length, output.stream.pools.get(name))
