"""One evaluation for several requests or queries ([Events14 §V.B], DESIGN §3 "Sharing").

A `SharingUnit` reads the streams and evaluates. Each request or query that it serves has an
`InstanceUnit`, which emits its part of the results.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from ....streams.generator import StreamGenerator
from ....streams.sample import Column, Field, FieldType, SampleBatch, Schema, Times
from ..base import ComputationalUnit

TALLY = Schema(
    (Field("instances", FieldType.INTEGER), Field("answered", FieldType.INTEGER)),
)
"""The output of a shared evaluation: for each window, or for each instant of a pattern's matches,
the number of instances, and of those with a result."""

Instance = TypeVar("Instance", bound="InstanceUnit")


class SharingUnit(ComputationalUnit, Generic[Instance]):
    """What shared evaluations have in common: their instances, by number.

    Only instances with followers get watermarks. The others are as far as this unit.
    """

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._instances: dict[int, Instance] = {}
        self._followed: set[Instance] = set()
        self._late_of_instances: dict[StreamGenerator, dict[Instance, StreamGenerator]] = {}

    def add(self, instance: Instance, number: int) -> None:
        """Add an instance by its number in the evaluation, which evaluates it from now on."""
        self._instances[number] = instance

    def remove(self, number: int) -> None:
        """Remove the instance with this number."""
        self.let_go(self._instances.pop(number))
        self.between_steps(lambda: self.forget(number))

    def let_go(self, instance: Instance) -> None:
        """Send an instance neither watermarks nor late samples any more."""
        self._followed.discard(instance)
        for sides in self._late_of_instances.values():
            sides.pop(instance, None)

    @abstractmethod
    def forget(self, number: int) -> None:
        """Evaluate the instance with this number no longer."""

    def between_steps(self, change: Callable[[], Any]) -> Any:
        """Do ``change``, which changes the evaluation, when no step of it is half done."""
        return change()

    def pass_late_of(
        self, instance: Instance, source: StreamGenerator, side: StreamGenerator
    ) -> None:
        """Emit the samples of ``source`` that are late for ``instance`` to ``side`` from now on."""
        self._late_of_instances.setdefault(source, {})[instance] = side
        self.start_late(source, side)

    def drop_late_of(self, instance: Instance, source: StreamGenerator) -> None:
        """Only count the samples that are late for ``instance`` from now on."""
        self._late_of_instances[source].pop(instance, None)

    def late_streams_of(self, source: StreamGenerator) -> Sequence[StreamGenerator]:
        own = super().late_streams_of(source)
        return (*own, *self._late_of_instances.get(source, {}).values())

    def follow(self, instance: Instance, is_followed: bool) -> None:
        """Send watermarks to the stream of an instance while it has readers, which need them."""
        if not is_followed:
            self._followed.discard(instance)
            return
        self._followed.add(instance)
        self.promise_to(instance)

    def promise_to(self, instance: Instance) -> None:
        """Promise of an instance's output what was promised of this one."""
        if self.output.watermark is not None:
            instance.output.advance(self.output.watermark)

    def promise_to_followed(self) -> None:
        """Promise it of all instances with followers."""
        for instance in tuple(self._followed):
            self.promise_to(instance)

    def end_output(self) -> None:
        super().end_output()
        if self.all_ended:
            for instance in tuple(self._instances.values()):
                # An instance without followers has had no watermarks so far.
                self.promise_to(instance)
                instance.output.end()

    def set_output_idle(self, is_idle: bool) -> None:
        was_idle = self.output.is_idle
        super().set_output_idle(is_idle)
        if self.output.is_idle != was_idle:
            for instance in tuple(self._instances.values()):
                instance.idleness_changed(self.output)

    def resume(self, source: StreamGenerator) -> None:
        super().resume(source)
        for instance in tuple(self._instances.values()):
            instance.output.resume()

    def emit_tally(self, available: int, valid: int, answered: int) -> None:
        """Emit how many instances have a result at the ``valid`` time (ns)."""
        given = (np.array([each], np.int64) for each in (available, valid, answered))
        self.emit_tallies(*given)

    def emit_tallies(self, available: Times, valid: Times, answered: NDArray[np.int64]) -> None:
        """Emit how many instances have a result at each of the ``valid`` times (ns)."""
        count = np.full(len(valid), len(self._instances), np.int64)
        columns = {
            "instances": Column(FieldType.INTEGER, count),
            "answered": Column(FieldType.INTEGER, answered),
        }
        self.output.emit(SampleBatch(available, valid, columns))


class InstanceUnit(ComputationalUnit):
    """Emits the results of one request or query of a shared evaluation.

    The template's unit calls it directly. It does not subscribe to the template's output, which has
    only the tally. ``enter`` adds it to the evaluation and returns its number; ``evaluation``
    prints the evaluation.
    """

    waits_for_all = False

    def __init__(
        self,
        *args: Any,
        template: SharingUnit[Any],
        enter: Callable[[], int],
        evaluation: Callable[[], str],
    ) -> None:
        super().__init__(*args)
        self._template = template
        self._enter = enter
        self._evaluation = evaluation
        self.number: int | None = None
        """Its number in the evaluation, while it is evaluated."""

    def enter(self) -> None:
        """Be evaluated from now on."""
        self.number = self._template.between_steps(self._enter)
        self._template.add(self, self.number)

    def leave(self, *, forgets: bool = True) -> None:
        """Be evaluated no longer; not ``forgets``: the evaluation itself is given up."""
        if self.number is not None:
            number, self.number = self.number, None
            if forgets:
                self._template.remove(number)
            self.output.on_followed = None

    def connect(self, source: StreamGenerator) -> None:
        self.enter()
        self.output.on_followed = lambda is_followed: self._template.follow(self, is_followed)
        if source.is_ended:
            self.output.end()
        elif source.is_idle:
            self.output.fall_idle()

    @property
    def reads(self) -> Sequence[StreamGenerator]:
        """The streams whose samples are evaluated."""
        return self._template.inputs

    @property
    def lag(self) -> int | None:
        # Its own output has watermarks only while it is followed.
        return self._template.lag

    @property
    def least_watermark(self) -> int | None:
        return self._template.least_watermark

    @property
    def late_inputs(self) -> Sequence[StreamGenerator]:
        return self._template.late_inputs

    def pass_late_to(self, source: StreamGenerator, side: StreamGenerator) -> None:
        self._template.pass_late_of(self, source, side)

    def drop_late(self, source: StreamGenerator) -> None:
        self._template.drop_late_of(self, source)

    def explain(self) -> str:
        """Print the query with its arguments, and the shared evaluation."""
        return f"{self.parameters['query'].rstrip()}\n\n{self._evaluation()}"

    def process(self, source: StreamGenerator, batch: SampleBatch) -> None:
        raise NotImplementedError("the template's unit has the results")

    def _leave_inputs(self) -> None:
        self.leave()
