"""Publishes batches to the streams that accept samples, each batch once ([DyKnow10 Def. 4.4])."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable
from typing import NamedTuple

from ...converters.rdf.statements import with_named_nodes
from ...converters.wire import Incoming
from ...streams.generator import StreamGenerator
from ..model.errors import Conflict, Refused
from .configuration import Configuration

_KEYS_KEPT = 10_000


class UsedKey(NamedTuple):
    """An idempotency key with its stream, the digest of the samples, and the answer."""

    stream: str
    key: str
    digest: bytes
    accepted: int


class Intake:
    """Offers published batches to their streams. Remembers the last 10,000 idempotency keys."""

    def __init__(self, configuration: Configuration) -> None:
        self._configuration = configuration
        self._keys: OrderedDict[tuple[str, str], tuple[bytes, int]] = OrderedDict()
        self._keyed: set[str] = set()

    def accepting(self, name: str) -> StreamGenerator:
        """Return the generator of a stream that users publish to. Raises `UnknownStream`, and
        `Refused` for a stream that the system makes."""
        generator = self._configuration.stream(name)
        if self._configuration.is_made_by_system(generator.name):
            raise Refused(
                f"the system makes stream {name!r}", "publish to a stream that you declared"
            )
        return generator

    def is_used(self, generator: StreamGenerator, key: str | None) -> bool:
        """Whether ``key`` was used for this stream before. If so, publishing has no effect."""
        return key is not None and (generator.name, key) in self._keys

    def count_ahead(self, name: str) -> None:
        """Count a batch for stream ``name`` that `Publish.check` has refused, and drop its
        texts from the string pools."""
        generator = self.accepting(name)
        generator.counters.ahead += 1
        generator.forget_texts()

    def publish(
        self,
        generator: StreamGenerator,
        incoming: Incoming,
        now: int,
        idempotency_key: str | None,
        digest: bytes,
    ) -> int:
        """See `Engine.publish`."""
        try:
            return self._publish(generator, incoming, now, idempotency_key, digest)
        finally:
            # Decoding has put the texts into the stream's pools, even if the batch is refused.
            generator.forget_texts()

    def _publish(
        self,
        generator: StreamGenerator,
        incoming: Incoming,
        now: int,
        idempotency_key: str | None,
        digest: bytes,
    ) -> int:
        # A stream may have several names, and a key counts for the stream.
        name = generator.name
        key = (name, idempotency_key or "")
        if idempotency_key is not None and key in self._keys:
            used_digest, accepted = self._keys[key]
            if used_digest != digest:
                raise Conflict(
                    f"key {idempotency_key!r} was used for other samples of stream {name!r}",
                    "use a new key; a key may be used again only for the same samples",
                )
            return accepted
        if len(incoming.batch) and generator.stamped not in (None, incoming.stamped):
            earlier, these, remedy = (
                ("were stamped on arrival", "have available times", "leave `available` out")
                if generator.stamped
                else (
                    "have available times, as those of a recording",
                    "have none",
                    "give each sample `available`, the time when you had it",
                )
            )
            raise Conflict(
                f"the earlier samples of stream {name!r} {earlier}; these {these}",
                f"the first sample decides for the whole stream: {remedy}, or take another stream",
            )
        batch = incoming.batch
        if incoming.has_nodes:
            batch = with_named_nodes(batch, generator.counters.accepted + 1)
        accepted = generator.offer(
            batch,
            now if incoming.stamped else None,
            stamps_valid=incoming.valid_on_arrival,
        )
        if idempotency_key is not None:
            self._keys[key] = (digest, accepted)
            self._keyed.add(name)
            if len(self._keys) > _KEYS_KEPT:
                self._keys.popitem(last=False)
        return accepted

    @property
    def keys(self) -> tuple[UsedKey, ...]:
        """The remembered keys, oldest first."""
        return tuple(UsedKey(*key, *use) for key, use in self._keys.items())

    def restore_keys(self, keys: Iterable[UsedKey]) -> None:
        """Remember the keys of an earlier run."""
        for each in keys:
            self._keys[each.stream, each.key] = (each.digest, each.accepted)
            self._keyed.add(each.stream)

    def forget_keys(self, name: str) -> None:
        """Forget the keys of a removed stream."""
        # The search below costs O(keys of all streams), so streams without keys skip it.
        if name in self._keyed:
            self._keyed.discard(name)
            for key in [key for key in self._keys if key[0] == name]:
                del self._keys[key]
