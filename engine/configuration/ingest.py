"""Taking samples in: which streams accept them, each batch once ([DyKnow10 Def. 4.4])."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable
from typing import NamedTuple

from ...converters.wire import Incoming
from ...streams.generator import StreamGenerator
from ..model.errors import Conflict, Refused
from .configuration import Configuration

_KEYS_KEPT = 10_000


class UsedKey(NamedTuple):
    """An idempotency key: of which stream, what was sent, and what was answered."""

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
        """The generator of a stream that takes samples; raises `UnknownStream`, and `Refused` for
        a stream that the system makes."""
        generator = self._configuration.stream(name)
        if self._configuration.is_made(generator.name):
            raise Refused(
                f"stream {name!r} is made by the system", "publish to a stream that you declared"
            )
        return generator

    def is_used(self, name: str, key: str | None) -> bool:
        """Whether ``key`` was used for this stream before: it has no second effect then."""
        return key is not None and (self.accepting(name).name, key) in self._keys

    def refuse_ahead(self, name: str) -> None:
        """Count a batch for stream ``name`` that `Publish.check_ahead` has refused, and forget its
        texts."""
        generator = self.accepting(name)
        generator.counters.ahead += 1
        generator.forget_texts()

    def publish(
        self, name: str, incoming: Incoming, now: int, idempotency_key: str | None, digest: bytes
    ) -> int:
        """See `Engine.publish`."""
        generator = self.accepting(name)
        try:
            return self._publish(generator, incoming, now, idempotency_key, digest)
        finally:
            # Its texts are in the pools of the stream, also where nothing comes of the batch.
            generator.forget_texts()

    def _publish(
        self,
        generator: StreamGenerator,
        incoming: Incoming,
        now: int,
        idempotency_key: str | None,
        digest: bytes,
    ) -> int:
        name = generator.name
        key = (name, idempotency_key or "")
        if idempotency_key is not None and key in self._keys:
            sent, accepted = self._keys[key]
            if sent != digest:
                raise Conflict(
                    f"key {idempotency_key!r} was used for other samples of stream {name!r}",
                    "use a key once; the same samples may be sent under it again",
                )
            return accepted
        if len(incoming.batch) and generator.stamped not in (None, incoming.stamped):
            has, lacks = (
                ("are stamped on arrival", "bring")
                if generator.stamped
                else ("bring their own available times", "lack")
            )
            raise Conflict(
                f"the samples of stream {name!r} {has}; these {lacks} them",
                "a stream is one or the other, from its first sample on",
            )
        accepted = generator.offer(incoming.batch, now if incoming.stamped else None)
        if idempotency_key is not None:
            self._keys[key] = (digest, accepted)
            self._keyed.add(name)
            if len(self._keys) > _KEYS_KEPT:
                self._keys.popitem(last=False)
        return accepted

    @property
    def keys(self) -> tuple[UsedKey, ...]:
        """Those that are remembered, oldest first."""
        return tuple(UsedKey(*key, *sent) for key, sent in self._keys.items())

    def remember(self, keys: Iterable[UsedKey]) -> None:
        """An earlier run has used these."""
        for each in keys:
            self._keys[each.stream, each.key] = (each.digest, each.accepted)
            self._keyed.add(each.stream)

    def forget(self, name: str) -> None:
        """A stream was removed, and with it the keys that were used for it."""
        if name in self._keyed:
            self._keyed.discard(name)
            for key in [key for key in self._keys if key[0] == name]:
                del self._keys[key]
