"""A feed: a stream with clients of its events, encoded for all of them (docs/reference/streams.md).

A feed encodes samples when a client needs them, once for all clients with the same `Projection`,
into a bounded cache (`message_cache`). Called by `feeds`, whose cursors read it.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from ...converters.json_rows import (
    PLACE,
    cells,
    constant,
    object_template,
    rows,
    time_cells,
    value_cells,
)
from ...engine.engine import Engine
from ...engine.model.errors import UnknownStream
from ...engine.requests.adaptive_subscription import Rematch
from ...streams.downsampling import newest_of_each, object_numbers
from ...streams.generator import StreamGenerator
from ...streams.sample import SampleBatch, Times, concatenate
from .clients import EventClient, EventClients
from .delivery import WHOLE, Projection
from .message_cache import PIECE_BYTES, Block, Blocks, MessageCache

_ENCODED: Final = 4 * PIECE_BYTES
"""Bytes of samples (`SampleBatch.sizes`) that are encoded at once, unless one has more."""


@dataclass(frozen=True, slots=True)
class Visible:
    """The part of a stream that clients may see: the number of the newest sample, whether the
    stream has ended, the time (ns) of the last switch, and the failure of its source."""

    newest: int
    is_ended: bool
    switched: int | None
    failure: str | None = None


class Feed:
    """A stream with clients, which it wakes when its generator publishes.

    With a data directory, clients see the durable part only: `Feeds.release` advances it.
    """

    def __init__(
        self,
        engine: Engine,
        generator: StreamGenerator,
        cache: MessageCache,
        clients: EventClients,
        pending: dict[Feed, None] | None,
    ) -> None:
        self.generator = generator
        self.name = generator.name
        self.clients: dict[EventClient, Projection] = {}
        self.is_removed = False
        self.switches: Sequence[Rematch] = ()
        """The switches of the adaptive subscription that publishes the stream."""
        self.failure = engine.failure_of(generator)
        """The failure of the stream's source, as of the last `check`."""
        self._last_switch: Rematch | None = None
        self._engine = engine
        self._all = clients
        self._cache = cache
        self._blocks: dict[Projection, Blocks] = {}
        self._keys: tuple[str, ...] = ()
        """The fields that named objects at the last `_object_fields`."""
        self._pending = pending
        self.visible: Visible | None = None
        """The part that clients may see; None: all."""

    @property
    def newest(self) -> int:
        """The number of the newest sample that clients may see."""
        last = self.generator.stream.last_number
        return last if self.visible is None else min(last, self.visible.newest)

    def state(self) -> Visible:
        """Return the stream's present state, durable or not."""
        generator = self.generator
        latest = self.switches[-1].time if self.switches else None
        last = generator.stream.last_number
        return Visible(last, generator.is_ended, latest, self.failure)

    @property
    def oldest(self) -> int:
        """The number of the oldest sample in the history."""
        return self.generator.stream.first_number

    @property
    def end_reason(self) -> str | None:
        """The reason why no sample follows `newest`; None while one may follow."""
        if self.is_removed:
            return "removed"
        # Samples that are not durable yet come before the end.
        if self.newest != self.generator.stream.last_number:
            return None
        visible = self.visible or self.state()
        if visible.failure is not None and self.failure is not None:
            return "failed"
        return "ended" if self.generator.is_ended and visible.is_ended else None

    def receive(self, source: StreamGenerator, batch: SampleBatch) -> None:
        self._mark_changed()

    def ended(self, source: StreamGenerator) -> None:
        # A unit that its rule stops ends its stream, and clients get the failure as the reason.
        self.failure = self._engine.failure_of(self.generator)
        self._mark_changed()

    def _mark_changed(self) -> None:
        # Without a data directory nothing can become durable, so clients see it at once.
        if self._pending is None:
            self.wake()
        else:
            self._pending[self] = None

    def show(self, visible: Visible) -> None:
        """Let clients see the stream up to ``visible``."""
        self.visible = visible
        self.wake()

    def wake(self) -> None:
        """Let every client check for messages. Several wakes before it does so count as one."""
        self._all.rounds.add(self)

    def check(self, *, failures: bool = True) -> None:
        """Wake the clients for a new switch, or for a new failure of the source (looked up if
        ``failures``). These need not come with a sample."""
        if failures and self.failure != (failure := self._engine.failure_of(self.generator)):
            self.failure = failure
            self._mark_changed()
        if self.switches and self.switches[-1] is not self._last_switch:
            self._last_switch = self.switches[-1]
            self._mark_changed()

    def messages(
        self, number: int, until: int, projection: Projection = WHOLE
    ) -> tuple[int, bytes]:
        """Return the messages of one piece, from sample ``number`` to at most ``until``: the last
        sample's number, and the bytes. Contract: the history has ``number``."""
        blocks = self._blocks.setdefault(projection, Blocks(self._cache))
        block = blocks.find(number) or self._fill_block(blocks, number, projection)
        return block.part(number, until)

    def newest_of_each(
        self, number: int, until: int
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the numbers of the newest samples of each object from sample ``number`` to
        ``until``, increasing, and how many samples the object has there. A stream without known
        objects has one. Contract: the history has all of them."""
        schema = self.generator.schema
        keys = [key for key in self._object_fields() if schema.get(key) is not None]
        count = until + 1 - number
        segments = self.generator.stream.since(number, count)
        batch = concatenate([segment.batch.select(keys) for segment in segments])
        places, counts = newest_of_each(object_numbers(batch.take(slice(0, count)), keys))
        return places + number, counts

    def conflated(
        self, numbers: NDArray[np.int64], counts: NDArray[np.int64], projection: Projection
    ) -> list[bytes]:
        """Return messages of the first samples with these ``numbers``, each of which stands for so
        many samples (``counts``): at least one, and at most a piece. Contract: the history has
        them. Cost: these messages are encoded for one client."""
        batch = self.generator.stream.at(numbers)
        messages: list[bytes] = []
        size = 0
        for each in self._encode(numbers, batch, projection, counts.tolist()):
            if messages and size + len(each) > PIECE_BYTES:
                break
            messages.append(each)
            size += len(each)
        return messages

    def forget(self, client: EventClient) -> None:
        """Remove ``client``, and the messages of a projection that no other client has."""
        projection = self.clients.pop(client)
        # Most clients have the first one's projection, so this ends early.
        if projection not in self.clients.values() and projection in self._blocks:
            self._blocks.pop(projection).clear()

    def close(self) -> None:
        """Stop listening to the generator: the last client has left."""
        self.generator.leave(self)

    def _object_fields(self) -> tuple[str, ...]:
        with suppress(UnknownStream):  # removed; its last samples still go out
            self._keys = self._engine.object_fields(self.name)
        return self._keys

    def _fill_block(self, blocks: Blocks, number: int, projection: Projection) -> Block:
        """Encode sample ``number`` and some that follow it into a block, and return the block."""
        block, room = blocks.place(number)
        room = min(room, self.newest + 1 - number)
        batch = self.generator.stream.since(number, room)[0].batch.take(slice(0, room))
        numbers = np.arange(number, number + len(batch))
        blocks.extend(block, self._encode(numbers, batch, projection))
        return block

    def _encode(
        self,
        numbers: NDArray[np.int64],
        batch: SampleBatch,
        projection: Projection,
        counts: Sequence[int] | None = None,
    ) -> list[bytes]:
        """Return the messages of at least one sample, and of at most `_ENCODED` bytes of samples.
        ``counts`` as in `conflated`.

        Law (tests/laws/service/test_messages.py): they are those of the samples one by one. Cost:
        some 3 µs a message, half of it for RDF, and 60 µs a call.
        """
        fitting = int(batch.sizes().cumsum().searchsorted(_ENCODED, "right"))
        if fitting < len(batch):
            part = slice(0, max(1, fitting))
            numbers, batch = numbers[part], batch.take(part)
        sequence = cells(numbers.tolist())
        values = value_cells(batch.select(projection.names(batch.columns)))
        times = time_cells(batch.available), time_cells(batch.valid)
        columns = [sequence, sequence, *times, *values.values()]
        if projection.has_rdf:
            columns.append(cells(self._rdf(numbers, batch)))
        if counts is not None:
            columns.append(cells(counts[: len(batch)]))
        template = _message_template(
            self._engine.epoch, self.name, tuple(values), projection.has_rdf, counts is not None
        )
        return rows(template, columns)

    def _rdf(self, numbers: NDArray[np.int64], batch: SampleBatch) -> list[str]:
        def places(available: Times) -> NDArray[np.int64]:
            # The batch may begin within an instant, and lack some of its samples.
            instants, which = np.unique(available, return_inverse=True)
            number_at = self.generator.stream.number_at
            firsts = np.array([number_at(time) for time in instants.tolist()], np.int64)
            found: NDArray[np.int64] = numbers - firsts[which]
            return found

        try:
            return self._engine.rdf_of(self.name, batch, places)
        except UnknownStream:
            # The stream was removed, and its annotation with it; its last samples still go out.
            return [""] * len(batch)


@lru_cache(maxsize=1024)
def _message_template(
    epoch: str, stream: str, fields: tuple[str, ...], has_rdf: bool, has_count: bool
) -> bytes:
    """The template of a message, for the number of its sample, twice, and then the other cells."""
    members = {
        "stream": constant(msgspec.json.encode(stream)),
        "sequence": PLACE,
        "available": PLACE,
        "valid": PLACE,
        "values": object_template(dict.fromkeys(fields, PLACE)),
    }
    if has_rdf:
        members["rdf"] = PLACE
    if has_count:
        members["count"] = PLACE
    head = constant(b"id: %b-" % epoch.encode()) + PLACE + b"\nevent: sample\ndata: "
    return head + object_template(members) + b"\n\n"
