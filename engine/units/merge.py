"""A feature's samples out of whatever streams hold them now ([Introspection15 §4.4]).

A mediation process in the words of [DyKnow10 §4.3]: it changes its inputs at run time and keeps
its output. It is what an adaptive subscription reads.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...converters.objects import ObjectTable, object_name
from ...ontology.units import Conversion
from ...rdf.dictionary import TermDictionary, TermTable
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
class Whose:
    """Who an argument of the feature is: always ``object`` (an IRI), or whom ``id_field`` names, in
    ``namespace``."""

    object: str | None
    id_field: str | None
    namespace: str = DYKNOW


@dataclass(frozen=True, slots=True, eq=False)
class MergeInput:
    """What is taken from a stream: ``field``, converted, of the objects of ``whose``.

    ``wanted`` says of an object (an IRI) whether it is meant; None: each is.
    """

    source: StreamGenerator
    field: str
    conversion: Conversion
    whose: tuple[Whose, ...]
    wanted: Callable[[str], bool] | None = None


class MergeUnit(ComputationalUnit):
    """Passes on the samples of its inputs under one name each: the objects and the value.

    A sample keeps its times; where another stream has been ahead of it, it is available with what
    was passed on last. `switch` changes the inputs: of a new one what is available later than the
    last instant passed on (by the time it brought) follows, out of the history it keeps, and
    nothing else; of one that is taken up again what follows its last sample.

    Law (tests/laws): of a single source each sample is passed on once, in order, with its times;
    whatever the switches, none is passed on twice. Cost: numpy per batch, a look-up per sample and
    Python per distinct object. Memory: an entry for each object.
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
        self._begun: dict[StreamGenerator, tuple[int, int]] = {}
        """When, by the clock, each input began, and after which available time."""
        self._place = TIME_MIN
        """How far what was lost last had been."""
        self._left: dict[StreamGenerator, tuple[int, int]] = {}
        """How far inputs were that were left, and the number of the last sample, while nothing else
        has begun in their stead."""
        self.arrivals: dict[StreamGenerator, Arrivals] = {}
        """When each input spoke, by the clock."""
        self.delivered = TIME_MIN
        """The greatest available time (ns) that a sample passed on brought, or, where it began
        with what comes, the last one before."""

    @property
    def merged(self) -> tuple[MergeInput, ...]:
        """What is merged now."""
        return tuple(feed.input for feeds in self._feeds.values() for feed in feeds)

    def begin_at(self, since: Beginning) -> None:
        """Pass on nothing that was available before the moment ``since``, if it is one. Contract:
        nothing was passed on yet."""
        if isinstance(since, Moment):
            self._after = self._place = last_before(since)

    def switch(self, inputs: Sequence[MergeInput], *, history: bool) -> bool:
        """Read ``inputs`` from now on and nothing else; with ``history`` what they keep of later
        than was passed on last goes first. An input that is read already goes on, and one that was
        left and that nothing has taken the place of goes on from there.

        Returns whether an input had forgotten some of what followed, as far as can be known.
        """
        wanted: dict[StreamGenerator, list[MergeInput]] = {}
        for input in inputs:
            wanted.setdefault(input.source, []).append(input)
        lost = [source for source in self._feeds if source not in wanted]
        # Of several streams, one may have been ahead of the one that is replaced.
        after = self.delivered
        if lost or not self._feeds:
            self._place = max((self._reached[source] for source in lost), default=self._place)
            after = self._place
        for source in lost:
            self._left[source] = self._reached[source], source.stream.last_number
            self._leave(source)
        new = [source for source in wanted if source not in self._feeds]
        begins = {source: self._left.pop(source, None) for source in new}
        if None in begins.values():
            self._left.clear()
        forgotten = False
        for source, parts in wanted.items():
            known = [_same(feed.input) for feed in self._feeds.get(source, ())]
            if known != [_same(part) for part in parts]:
                self._feeds[source] = [
                    _Feed(part, self._dictionary, self._value, self.output) for part in parts
                ]
            if source in begins:
                place, number = begins[source] or (after, None)
                forgotten |= self._begin(source, place, number, history)
        self.inputs = self.sources = tuple(self._feeds)
        return forgotten

    def _begin(
        self, source: StreamGenerator, after: int, number: int | None, history: bool
    ) -> bool:
        """Read a source after the instant ``after``, or after sample ``number`` of it, or without
        ``history`` what comes. Returns whether some of it is forgotten."""
        stream = source.stream
        self.arrivals[source] = Arrivals(self._clock())
        if not history and stream.last_available is not None:
            after = stream.last_available
            self.delivered = max(self.delivered, after)
        self._reached[source] = after
        if number is not None and history:
            after -= 1  # that instant may go on
        self._begun[source] = self._clock(), after
        forgotten = False
        if history and stream.first_available is not None:
            forgotten = TIME_MIN < after < stream.first_available and stream.first_number > 1
            for segment in stream.since(0 if number is None else number + 1):
                batch = segment.batch
                if batch.available[-1] > after:
                    self.receive(source, batch)
        self.connect(source)
        return forgotten

    def ask_again(self) -> None:
        """More may be known of the objects: who is meant is asked again."""
        for feeds in self._feeds.values():
            for feed in feeds:
                feed.ask_again()

    def _leave(self, source: StreamGenerator) -> None:
        del self._feeds[source]
        del self.arrivals[source]
        del self._reached[source]
        del self._begun[source]
        self._ended.discard(source)
        self._watermarks.pop(source, None)
        if source in self._subscribed:
            self._subscribed.remove(source)
            source.unsubscribe(self)

    def process(self, source: StreamGenerator, batch: SampleBatch) -> None:
        now = self._clock()
        self.arrivals[source].came(now)
        begun, after = self._begun[source]
        if begun == now:  # the rest of a batch that was cut is judged like what is kept
            batch = batch.take(batch.available > after)
            if not len(batch):
                return
        self._reached[source] = int(batch.available[-1])
        self.delivered = max(self.delivered, self._reached[source])
        for feed in self._feeds[source]:
            made = feed.made(batch)
            if len(made):
                self.output.emit(made.with_available(self.output.stamps_at(made.available)))

    def progress(self, source: StreamGenerator, watermark: int) -> None:
        # The fastest input is how far the stream is: what comes behind it is stamped later.
        self.output.advance(watermark)

    def finish(self, source: StreamGenerator) -> None:
        """An input that ends is replaced, or waited for; the output goes on."""


def _same(input: MergeInput) -> tuple[object, ...]:
    # A subscription asks of every object the same, or nothing.
    return input.field, input.conversion, input.whose, input.wanted is None


class _Feed:
    """One input at work: its columns made into those of the output."""

    def __init__(
        self, input: MergeInput, dictionary: TermDictionary, value: str, output: StreamGenerator
    ) -> None:
        self.input = input
        self._value = value
        self._output = output
        self._namings = {
            name: _Naming(
                whose,
                dictionary,
                output.stream.pools,
                name,
                input.wanted if name == OBJECT else None,
            )
            for name, whose in zip(object_fields(len(input.whose)), input.whose, strict=True)
        }

    def made(self, batch: SampleBatch) -> SampleBatch:
        """What of ``batch`` is passed on, as samples of the output."""
        column = batch.columns[self.input.field]
        present = column.present
        columns: dict[str, Column] = {}
        for name, naming in self._namings.items():
            codes, known = naming.of(batch)
            present = present & known
            columns[name] = Column(FieldType.STRING, codes, None, naming.pool)
        columns[self._value] = self._converted(column)
        made = SampleBatch(batch.available, batch.valid, columns)
        return made if bool(present.all()) else made.take(present)

    def ask_again(self) -> None:
        """See `MergeUnit.ask_again`."""
        for naming in self._namings.values():
            naming.ask_again()

    def _converted(self, column: Column) -> Column:
        if not self.input.conversion.is_identity:
            values = self.input.conversion.apply(column.values.astype(np.float64))
            return Column(FieldType.FLOAT, values, column.null)
        field = self._output.schema.get(self._value)
        assert field is not None
        if column.pool is not None:
            return column.recoded(self._output.stream.pools[self._value])
        if field.type is FieldType.STRING:  # nobody says what the values of the feature are
            texts = [None if value is None else str(value) for value in column.tolist()]
            return column_from_values(field, texts, self._output.stream.pools[self._value])
        if field.type is FieldType.FLOAT and column.type is FieldType.INTEGER:
            return Column(FieldType.FLOAT, column.values.astype(np.float64), column.null)
        return column


class _Naming(TermTable):
    """Names of objects in a stream made into those of the output."""

    def __init__(
        self,
        whose: Whose,
        dictionary: TermDictionary,
        pools: Mapping[str, StringPool],
        name: str,
        wanted: Callable[[str], bool] | None,
    ) -> None:
        self.pool = pools[name]
        """The output's, as it was when names were last asked for."""
        self._pools = pools
        self._name = name
        self._whose = whose
        self._dictionary = dictionary
        self._wanted = wanted
        self._table = ObjectTable(dictionary, whose.namespace)
        self._codes: dict[int, int] = {}
        dictionary.follow(self)

    def forget(self, freed: NDArray[np.bool_]) -> None:
        """See `dictionary.TermTable`."""
        self._codes = {id: code for id, code in self._codes.items() if not freed[id]}

    def of(self, batch: SampleBatch) -> tuple[Codes, Mask]:
        """The codes of the objects in the output's pool, and where there is one that is meant."""
        if self.pool is not self._pools[self._name]:
            self.pool = self._pools[self._name]
            self._codes.clear()
        if self._whose.object is not None or self._whose.id_field is None:
            code = self._code_of(self._whose.object or "")
            return np.full(len(batch), max(code, 0), np.int32), np.full(len(batch), code >= 0)
        ids, present = self._table.ids(batch.columns[self._whose.id_field])
        distinct, place = np.unique(ids[present], return_inverse=True)
        known = np.array([self._code(id) for id in distinct.tolist()], np.int32)
        codes = np.zeros(len(batch), np.int32)
        meant = present.copy()
        if len(known):
            codes[present] = np.maximum(known[place], 0)
            meant[present] = known[place] >= 0
        return codes, meant

    def ask_again(self) -> None:
        """Forget of each object whether it is meant."""
        self._codes.clear()

    def _code(self, id: int) -> int:
        code = self._codes.get(id)
        if code is None:
            code = self._codes[id] = self._code_of(str(self._dictionary.term(id))[1:-1])
        return code

    def _code_of(self, iri: str) -> int:
        """The code of an object; -1 for one that is not meant."""
        if self._wanted is not None and not self._wanted(iri):
            return -1
        return int(self.pool.encode([object_name(iri, DYKNOW)])[0])


def object_fields(arity: int) -> tuple[str, ...]:
    """``object``, ``object2``, … for the arguments of a feature."""
    return tuple(OBJECT if i == 0 else f"{OBJECT}{i + 1}" for i in range(arity))
