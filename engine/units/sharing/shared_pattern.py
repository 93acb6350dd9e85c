"""Requests of one pattern template that differ in an object, evaluated as one (SPEC §8)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....reasoning.patterns.plans.by_object import PART, PatternByObject
from ....reasoning.patterns.plans.query import Keys, PatternQuery, object_key
from ....reasoning.patterns.recognition.explanation import PartialMatches
from ....reasoning.patterns.recognition.part_recognition import PartRecognition
from ....reasoning.patterns.recognition.recognition import Recognized
from ....streams.generator import StreamGenerator
from ....streams.sample import SampleBatch
from ..reasoning.match_samples import MatchWriter
from ..reasoning.partial_answers import partial_answers
from ..reasoning.pattern import RecalledEvents, explain_matches
from ..reasoning.row_readers import SourceInput, row_readers
from ..reasoning.sample_reasoner import ReportedLosses, ReportLimit
from .shared_reasoner import ReasoningInstance, SharedReasoner


class SharedPatternUnit(SharedReasoner["PatternInstance"]):
    """Evaluates a pattern for each of the objects that its instances ask for."""

    def __init__(
        self,
        *args: Any,
        pattern: PatternByObject,
        inputs_of_sources: Sequence[SourceInput],
        lateness: Callable[[StreamGenerator], int],
        report_limit: ReportLimit,
        **options: Any,
    ) -> None:
        super().__init__(*args, **options)
        self.pattern = pattern
        self._inputs_of_sources = tuple(inputs_of_sources)
        self._lateness = tuple(lateness(each) for each in self.sources)
        self.keys = Keys()
        self._losses = ReportedLosses(report_limit)
        self._begin()

    def _begin(self) -> None:
        self.recognition = PartRecognition(
            self.pattern, len(self.sources), self.keys, lateness=self._lateness
        )
        self.matches = 0
        """Matches that the evaluation has found by now."""
        self._readers = row_readers(
            self._inputs_of_sources, self._dictionary, self.keys, self.pattern.column
        )

    def explain(self) -> str:
        """Describe the evaluation: the plan, and what has been done by now."""
        run = self.recognition
        return self._explain(run.explain(), *explain_matches(run, self.matches))

    @property
    def reasoning(self) -> PartRecognition:
        return self.recognition

    def enter(self, object: str) -> int:
        """Evaluate the pattern for ``object`` (an IRI) from now on; return its number."""
        return self.ask_for(object, self.recognition.add_part())

    def recall(self, number: int, since: Mapping[StreamGenerator, int]) -> RecalledEvents:
        """Return the retained samples of an instance's object, for explanations; of each stream
        those after the available time (ns) ``since``."""
        own, evicting = self.past_of_part(number, since)
        return RecalledEvents(
            self.pattern.query,
            self._inputs_of_sources,
            self._lateness,
            own,
            evicting,
            None,
            self._end + 1 if self.all_ended else self.least_watermark,
            self._end if self.all_ended else None,
        )

    def _emit(self, found: Recognized) -> None:
        self._losses.report(self, self.recognition.losses())
        if not len(found):
            return
        self.matches += len(found)
        parts = found.outputs[PART]

        def of_instance(rows: NDArray[np.int64], instance: PatternInstance) -> Recognized:
            """Its matches, with its object in place of the number of its part."""
            outputs = {name: values[rows] for name, values in found.outputs.items()}
            for name in self.pattern.objects:
                outputs[name] = np.full(len(rows), instance.key, np.int64)
            return Recognized(found.available[rows], found.valid[rows], outputs, found.rows[rows])

        self._hand_out(parts, found.available, found.valid, of_instance)


class PatternInstance(ReasoningInstance):
    """Emits the matches of one ``object`` (an IRI). ``query``: the pattern of this object."""

    def __init__(
        self, *args: Any, template: SharedPatternUnit, object: str, query: PatternQuery
    ) -> None:
        super().__init__(
            *args, template=template, object=object, enter=lambda: template.enter(object)
        )
        self.query = query
        self.key = template.keys.number(object_key(object))
        """The number of its object."""
        self._writer = MatchWriter(query, template.keys)

    @property
    def template(self) -> SharedPatternUnit:
        """The unit that evaluates this pattern together with others."""
        assert isinstance(self._template, SharedPatternUnit)
        return self._template

    def recall(self) -> RecalledEvents:
        """Return the retained samples that it has read, for explanations."""
        assert self.number is not None
        return self.template.recall(self.number, self._since)

    def partial(self, objects: Sequence[str], limit: int) -> PartialMatches:
        """Return the partial matches of all these objects; see `partial_answers`."""
        assert self.number is not None
        template = self.template
        return partial_answers(
            self.query,
            template.recognition,
            template.keys,
            self._writer,
            objects,
            limit,
            self.number,
        )

    @property
    def rows_of(self) -> Mapping[str, int]:
        """The rows of each kind that came."""
        return {} if self.number is None else self.template.recognition.rows_of_part(self.number)

    @property
    def pending(self) -> int:
        """The number of matches that wait."""
        run = self.template.recognition
        return 0 if self.number is None else run.evaluator.pending_of(self.number)

    def _emit(self, found: Recognized) -> None:
        columns = self._writer.columns(found, self.output.stream.pools)
        self.output.emit(SampleBatch(self.output.stamps_at(found.available), found.valid, columns))
