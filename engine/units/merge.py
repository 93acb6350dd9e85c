"""The unit that merges the streams of a feature for an adaptive subscription
([Introspection15 §4.4]).

It is a mediation process in the sense of [DyKnow10 §4.3]: its inputs change at run time, its output
stays.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...converters.objects import ObjectTable, object_name
from ...ontology.units import Conversion
from ...rdf.dictionary import Ids, TermDictionary, TermTable
from ...rdf.namespaces import DYKNOW
from ...streams.generator import StreamGenerator
from ...streams.past_queries import Moment
from ...streams.sample import (
    Column,
    FieldType,
    Mask,
    SampleBatch,
    column_from_values,
)
from ...streams.string_pool import StringPool
from ...streams.time import TIME_MIN
from ..model.arrivals import Arrivals
from ..model.beginning import Beginning, last_before
from .base import ComputationalUnit

Codes: TypeAlias = NDArray[np.int32]
OBJECT = "object"
"""The field that names the object; further ones of an n-ary feature are `object2`, …"""


@dataclass(frozen=True, slots=True)
class ObjectName:
    """The object of an argument of the feature: always ``object`` (an IRI), or the object that
    ``id_field`` names in ``namespace``."""

    object: str | None
    id_field: str | None
    namespace: str = DYKNOW


@dataclass(frozen=True, slots=True, eq=False)
class MergeInput:
    """A source with its ``field`` that has the value, the conversion of that, and the ``objects``
    of the feature's arguments.

    ``is_wanted`` returns whether an object (an IRI) is wanted; None: each is.
    """

    source: StreamGenerator
    field: str
    conversion: Conversion
    objects: tuple[ObjectName, ...]
    is_wanted: Callable[[str], bool] | None = None


class MergeUnit(ComputationalUnit):
    """Passes on the samples of its inputs with the same fields: the objects and the value.

    A sample keeps its times. If another input has been ahead of it, it becomes available with the
    last sample passed on. `switch` changes the inputs. It reads from the history of a new input the
    samples that are available after the last instant passed on (by the times of the inputs). An
    input that returns continues after its last sample.

    Law (tests/laws): each sample of a single source is passed on once, in order, with its times. No
    switch passes a sample on twice. Cost: numpy per batch, a look-up per sample and Python per
    distinct object. Memory: an entry for each object.
    """

    waits_for_all = False

    def __init__(
        self,
        *args: Any,
        dictionary: TermDictionary,
        value: str,
        clock: Callable[[], int],
    ) -> None:
        super().__init__(*args)
        self._dictionary = dictionary
        self._value = value
        self._clock = clock
        self._feeds: dict[StreamGenerator, list[_Feed]] = {}
        self._reached: dict[StreamGenerator, int] = {}
        """The last available time (ns) read of each input."""
        self._begun: dict[StreamGenerator, tuple[int, int]] = {}
        """The time of the clock when each input was added, and the available time (ns) after which
        it is read."""
        self._resume_after = TIME_MIN
        """The last available time (ns) read of the inputs that the last switch removed."""
        self._left: dict[StreamGenerator, tuple[int, int]] = {}
        """Removed inputs, until another input replaces them: the last available time (ns) and the
        last sequence number."""
        self.arrivals: dict[StreamGenerator, Arrivals] = {}
        """The arrivals of samples at each input, by the clock."""
        self.delivered = TIME_MIN
        """The greatest available time (ns) of a sample passed on, by the time of its input. Without
        history, at least that of the input's last sample before."""

    @property
    def merged(self) -> tuple[MergeInput, ...]:
        """The present inputs."""
        return tuple(feed.input for feeds in self._feeds.values() for feed in feeds)

    def begin_at(self, since: Beginning) -> None:
        """Ignore samples that were available before ``since``, if that is a moment. Contract: no
        sample was passed on yet."""
        if isinstance(since, Moment):
            self._after = self._resume_after = last_before(since)

    def switch(self, inputs: Sequence[MergeInput], *, history: bool) -> bool:
        """Replace the inputs by ``inputs``. With ``history``, first read the retained samples of
        the new ones that follow the last instant passed on. Present inputs go on. A removed input
        that returns goes on where it was, unless another one has replaced it.

        Returns whether an input had dropped some of the samples to read, as far as this is known.
        """
        wanted: dict[StreamGenerator, list[MergeInput]] = {}
        for input in inputs:
            wanted.setdefault(input.source, []).append(input)
        lost = [source for source in self._feeds if source not in wanted]
        after = self.delivered
        if lost or not self._feeds:
            # `delivered` may be that of another input, ahead of the one that is replaced.
            self._resume_after = max(
                (self._reached[source] for source in lost), default=self._resume_after
            )
            after = self._resume_after
        for source in lost:
            self._left[source] = self._reached[source], source.stream.last_number
            self._leave(source)
        new = [source for source in wanted if source not in self._feeds]
        begins = {source: self._left.pop(source, None) for source in new}
        # A new source takes the place of the removed ones, so none of these goes on where it was.
        if None in begins.values():
            self._left.clear()
        forgotten = False
        for source, parts in wanted.items():
            present = [_key(feed.input) for feed in self._feeds.get(source, ())]
            if present != [_key(part) for part in parts]:
                self._feeds[source] = [
                    _Feed(part, self._dictionary, self._value, self.output) for part in parts
                ]
            if source in begins:
                begin_after, number = begins[source] or (after, None)
                forgotten |= self._begin(source, begin_after, number, history)
        self.inputs = self.sources = tuple(self._feeds)
        return forgotten

    def _begin(
        self, source: StreamGenerator, after: int, number: int | None, history: bool
    ) -> bool:
        """Read a source after the instant ``after``, or after its sample ``number``; without
        ``history`` only new samples. Returns whether the source has dropped some of them."""
        stream = source.stream
        self.arrivals[source] = Arrivals(self._clock())
        if not history and stream.last_available is not None:
            after = stream.last_available
            self.delivered = max(self.delivered, after)
        self._reached[source] = after
        if number is not None and history:
            after -= 1  # the instant may have got further samples
        self._begun[source] = self._clock(), after
        forgotten = False
        if history and stream.first_available is not None:
            # A stream whose history begins with number 1 has evicted nothing.
            forgotten = TIME_MIN < after < stream.first_available and stream.first_number > 1
            for segment in stream.since(0 if number is None else number + 1):
                batch = segment.batch
                if batch.available[-1] > after:
                    self.receive(source, batch)
        self.connect(source)
        return forgotten

    def refresh_objects(self) -> None:
        """Decide anew which objects are wanted, since the ontology may have changed."""
        for feeds in self._feeds.values():
            for feed in feeds:
                feed.refresh_objects()

    def _leave(self, source: StreamGenerator) -> None:
        del self._feeds[source]
        del self.arrivals[source]
        del self._reached[source]
        del self._begun[source]
        self._ended.discard(source)
        self._watermarks.pop(source, None)
        # A unit that has failed has left all of its inputs already.
        if source in self._subscribed:
            self._subscribed.remove(source)
            source.unsubscribe(self)

    def process(self, source: StreamGenerator, batch: SampleBatch) -> None:
        now = self._clock()
        self.arrivals[source].add(now)
        begun, after = self._begun[source]
        if begun == now:
            # The rest of a batch that was cut: without the cut it would be in the history.
            batch = batch.take(batch.available > after)
            if not len(batch):
                return
        self._reached[source] = int(batch.available[-1])
        self.delivered = max(self.delivered, self._reached[source])
        for feed in self._feeds[source]:
            converted = feed.convert(batch)
            if len(converted):
                stamps = self.output.stamps_at(converted.available)
                self.output.emit(converted.with_available(stamps))

    def progress(self, source: StreamGenerator, watermark: int) -> None:
        # The greatest watermark, since samples of slower inputs are stamped later.
        self.output.advance(watermark)

    def finish(self, source: StreamGenerator) -> None:
        """Keep the output open: the subscription replaces the input, or waits for it."""


def _key(input: MergeInput) -> tuple[object, ...]:
    # All predicates `is_wanted` of one subscription are equal.
    return input.field, input.conversion, input.objects, input.is_wanted is None


class _Feed:
    """Converts the samples of one input to those of the output."""

    def __init__(
        self, input: MergeInput, dictionary: TermDictionary, value: str, output: StreamGenerator
    ) -> None:
        self.input = input
        self._value = value
        self._output = output
        self._encoders = {
            name: _ObjectEncoder(
                object,
                dictionary,
                output.stream.pools,
                name,
                input.is_wanted if name == OBJECT else None,
            )
            for name, object in zip(object_fields(len(input.objects)), input.objects, strict=True)
        }

    def convert(self, batch: SampleBatch) -> SampleBatch:
        """Return the samples of wanted objects with a value, as samples of the output."""
        column = batch.columns[self.input.field]
        present = column.present
        columns: dict[str, Column] = {}
        for name, encoder in self._encoders.items():
            codes, is_wanted = encoder.encode(batch)
            present = present & is_wanted
            columns[name] = Column(FieldType.STRING, codes, None, encoder.pool)
        columns[self._value] = self._convert_value(column)
        result = SampleBatch(batch.available, batch.valid, columns)
        return result if bool(present.all()) else result.take(present)

    def refresh_objects(self) -> None:
        """See `MergeUnit.refresh_objects`."""
        for encoder in self._encoders.values():
            encoder.refresh()

    def _convert_value(self, column: Column) -> Column:
        if not self.input.conversion.is_identity:
            values = self.input.conversion.apply(column.values.astype(np.float64))
            return Column(FieldType.FLOAT, values, column.null)
        field = self._output.schema.get(self._value)
        assert field is not None
        if column.pool is not None:
            return column.recoded(self._output.stream.pools[self._value])
        if field.type is FieldType.STRING:  # the feature has no range, so any value may come
            texts = [None if value is None else str(value) for value in column.tolist()]
            return column_from_values(field, texts, self._output.stream.pools[self._value])
        if field.type is FieldType.FLOAT and column.type is FieldType.INTEGER:
            return Column(FieldType.FLOAT, column.values.astype(np.float64), column.null)
        return column


class ObjectCodes(TermTable):
    """Codes of the objects of one argument of a feature, by the texts of its id field.

    ``code_of`` returns the code of an IRI, which is not negative. Cost: two look-ups a sample, some
    30 ns, and more for each new object.
    """

    def __init__(
        self,
        object: ObjectName,
        dictionary: TermDictionary,
        code_of: Callable[[str], int],
        is_wanted: Callable[[str], bool] | None,
    ) -> None:
        self._object = object
        self._dictionary = dictionary
        self._make_code = code_of
        self._is_wanted = is_wanted
        self._table = ObjectTable(dictionary, object.namespace)
        self._codes: dict[int, int] = {}
        dictionary.follow(self)

    def forget(self, freed: NDArray[np.bool_]) -> None:
        """See `dictionary.TermTable`."""
        # The dictionary gives the freed ids to other terms, for which these codes are wrong.
        self._codes = {id: code for id, code in self._codes.items() if not freed[id]}

    def encode(self, batch: SampleBatch) -> tuple[Codes, Mask]:
        """Return the codes of the samples' objects, and a mask of the samples with a wanted
        object."""
        if self._object.object is not None or self._object.id_field is None:
            code = self._code_of(self._object.object or "")
            return np.full(len(batch), max(code, 0), np.int32), np.full(len(batch), code >= 0)
        column = batch.columns[self._object.id_field]
        ids = self._table.of_column(column)
        if column.null is None:
            codes = self._codes_of(ids)
        else:
            codes = np.full(len(batch), -1, np.int32)
            codes[column.present] = self._codes_of(ids[column.present])
        return np.maximum(codes, 0), codes >= 0

    def refresh(self) -> None:
        """Forget which objects are wanted."""
        self._codes.clear()

    def _codes_of(self, ids: Ids) -> Codes:
        """The codes of objects; -1 for those that are not wanted."""
        listed = ids.tolist()
        try:  # that all are known is the common case
            return np.fromiter(map(self._codes.__getitem__, listed), np.int32, len(listed))
        except KeyError:
            return np.fromiter(map(self._code, listed), np.int32, len(listed))

    def _code(self, id: int) -> int:
        code = self._codes.get(id)
        if code is None:
            code = self._codes[id] = self._code_of(str(self._dictionary.term(id))[1:-1])
        return code

    def _code_of(self, iri: str) -> int:
        """Return the code of an object; -1 for one that is not wanted."""
        if self._is_wanted is not None and not self._is_wanted(iri):
            return -1
        return self._make_code(iri)


class _ObjectEncoder(ObjectCodes):
    """Encodes the objects of an input in the string pool of the output."""

    def __init__(
        self,
        object: ObjectName,
        dictionary: TermDictionary,
        pools: Mapping[str, StringPool],
        name: str,
        is_wanted: Callable[[str], bool] | None,
    ) -> None:
        super().__init__(object, dictionary, self._pool_code, is_wanted)
        self.pool = pools[name]
        """The output's pool at the last call; the output replaces it when it forgets texts."""
        self._pools = pools
        self._name = name

    def encode(self, batch: SampleBatch) -> tuple[Codes, Mask]:
        if self.pool is not self._pools[self._name]:
            self.pool = self._pools[self._name]
            self.refresh()
        return super().encode(batch)

    def _pool_code(self, iri: str) -> int:
        return int(self.pool.encode([object_name(iri, DYKNOW)])[0])


def object_fields(arity: int) -> tuple[str, ...]:
    """Return the field names ``object``, ``object2``, … for the arguments of a feature."""
    return tuple(OBJECT if i == 0 else f"{OBJECT}{i + 1}" for i in range(arity))
