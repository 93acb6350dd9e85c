"""The matches of a chronicle by their definition: try all samples for all events.

It reads the checked chronicle, and neither plans nor the code that evaluates them.
"""

from __future__ import annotations

import itertools
import operator
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from dyknow.languages.chronicle.checked import (
    CheckedChronicle,
    Hold,
    Message,
    Moment,
    Occurs,
    Operand,
    Test,
    Variable,
)
from dyknow.languages.mtl.checked import Constant, ObjectConstant

COMPARISONS: dict[str, Callable[[Any, Any], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "=": operator.eq,
    "!=": operator.ne,
}
Value = float | bool | str
"""An object is its IRI."""


@dataclass(frozen=True)
class Sample:
    """A sample of a feature or event (IRI) of objects (IRIs); ``number`` counts arrivals."""

    number: int
    concept: str
    objects: tuple[str, ...]
    value: Value
    time: int


@dataclass(frozen=True)
class Match:
    """``samples``: the numbers of the samples of the events, in order of the text."""

    samples: tuple[int, ...]
    start: int
    end: int
    valid: int
    head: tuple[Value, ...]


Binding = dict[str, Value]


def matches(
    chronicle: CheckedChronicle, samples: Sequence[Sample], sorts: Mapping[str, set[str]]
) -> list[Match]:
    """All matches in samples that are in order, none of which is missing. ``sorts``: the objects of
    a sort (IRI); of a sort that is left out all are."""
    return list(_Definition(chronicle, list(samples), sorts).matches())


class _Definition:
    def __init__(
        self,
        chronicle: CheckedChronicle,
        samples: list[Sample],
        sorts: Mapping[str, set[str]],
    ) -> None:
        self.chronicle = chronicle
        self.samples = samples
        self.sorts = sorts

    def matches(self) -> Iterator[Match]:
        events = self.chronicle.events
        for samples in itertools.product(self.samples, repeat=len(events)):
            if len({each.number for each in samples}) < len(samples):
                continue
            times: dict[str, int] = {}
            if any(
                times.setdefault(event.point, sample.time) != sample.time
                for event, sample in zip(events, samples, strict=True)
            ):
                continue
            binding = self.bound(samples)
            if binding is None or not self.is_match(samples, times, binding):
                continue
            instants = [each.time for each in samples]
            emitted = self.chronicle.emitted
            yield Match(
                tuple(each.number for each in samples),
                min(instants),
                max(instants),
                max(instants) if emitted is None else times[emitted],
                tuple(binding[name] for name in self.chronicle.head),
            )

    def bound(self, samples: Sequence[Sample]) -> Binding | None:
        """The values of the variables: those of the first event that has them equal."""
        binding: Binding = dict(self.chronicle.fixed)
        for event, sample in zip(self.chronicle.events, samples, strict=True):
            message = event.message
            if message.concept != sample.concept:
                return None
            for argument, found in zip(message.arguments, sample.objects, strict=True):
                if isinstance(argument, Variable):
                    binding.setdefault(argument.name, found)
        for event, sample in zip(self.chronicle.events, samples, strict=True):
            for test, value in (
                (event.message.before, self.before(sample)),
                (event.message.value, sample.value),
            ):
                if test is not None and test.operator == "=" and isinstance(test.operand, Variable):
                    if value is None:
                        return None
                    binding.setdefault(test.operand.name, value)
        return binding

    def is_match(
        self, samples: Sequence[Sample], times: Mapping[str, int], binding: Binding
    ) -> bool:
        chronicle = self.chronicle
        for name, meaning in chronicle.variables.items():
            members = self.sorts.get(meaning.sort or "", {binding[name]})
            if binding[name] not in members and name not in dict(chronicle.fixed):
                return False
        for each in chronicle.distances:
            distance = times[each.second] - times[each.first]
            if each.least is not None and distance < each.least:
                return False
            if each.most is not None and distance > each.most:
                return False
        return (
            all(
                self.is_of(sample, event.message, binding)
                for event, sample in zip(chronicle.events, samples, strict=True)
            )
            and all(
                COMPARISONS[each.operator](
                    binding[each.left.name], self.operand(each.right, binding)
                )
                for each in chronicle.comparisons
            )
            and all(self.holds(each, times, binding) for each in chronicle.probes)
        )

    def is_of(self, sample: Sample, message: Message, binding: Binding) -> bool:
        return (
            self.is_series(sample, message, binding)
            and self.passes(message.value, sample.value, binding)
            and self.passes(message.before, self.before(sample), binding)
        )

    def is_series(self, sample: Sample, message: Message, binding: Binding) -> bool:
        """Whether the sample is of the feature and the objects."""
        return sample.concept == message.concept and all(
            argument is None or self.operand(argument, binding) == found
            for argument, found in zip(message.arguments, sample.objects, strict=True)
        )

    def passes(self, test: Test | None, value: Value | None, binding: Binding) -> bool:
        if test is None:
            return True
        return value is not None and COMPARISONS[test.operator](
            value, self.operand(test.operand, binding)
        )

    def before(self, sample: Sample) -> Value | None:
        same = [
            each.value
            for each in self.samples[: self.samples.index(sample)]
            if (each.concept, each.objects) == (sample.concept, sample.objects)
        ]
        return same[-1] if same else None

    def holds(self, probe: Occurs | Hold, times: Mapping[str, int], binding: Binding) -> bool:
        message = probe.message
        start, end = self.time(probe.start, times), self.time(probe.end, times)
        if isinstance(probe, Occurs):
            number = sum(
                start < each.time < end and self.is_of(each, message, binding)
                for each in self.samples
            )
            return probe.least <= number and (probe.most is None or number <= probe.most)
        series = [each for each in self.samples if self.is_series(each, message, binding)]
        before = [each for each in series if each.time <= start]
        after = [each for each in series if start < each.time <= end]
        return bool(before) and all(
            self.passes(message.value, each.value, binding) for each in [before[-1], *after]
        )

    def time(self, moment: Moment, times: Mapping[str, int]) -> int:
        return times[moment.point] + moment.offset

    def operand(self, operand: Operand, binding: Binding) -> Value:
        match operand:
            case Variable(name):
                return binding[name]
            case ObjectConstant(iri):
                return iri
            case Constant(value):
                return value
            case _:
                raise NotImplementedError(operand)
