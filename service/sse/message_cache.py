"""Samples as messages of server-sent events, each encoded once for all clients
(docs/reference/streams.md).

A `Block` has the messages of consecutive samples and grows at its end; `Blocks` are those of one
stream, `MessageCache` bounds the bytes of all. Used by sse, which says what to encode.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Sequence

PIECE_BYTES = 32 * 1024
"""At most so many bytes are sent in one go, but for a message that is longer: what a client that
takes nothing has waiting, and how long the others wait for one that takes much."""
BLOCK_SAMPLES = 256
"""At most so many messages are kept, and forgotten, together."""


class Block:
    """Messages of the samples from ``first`` on, up to before ``end``."""

    __slots__ = ("_ends", "first", "messages", "owner")

    def __init__(self, owner: Blocks, first: int) -> None:
        self.owner = owner
        self.first = first
        self.messages: list[bytes] = []
        self._ends = [0]

    @property
    def end(self) -> int:
        """The number of the sample after the last one."""
        return self.first + len(self.messages)

    @property
    def size(self) -> int:
        """Bytes of all messages."""
        return self._ends[-1]

    @property
    def is_full(self) -> bool:
        """Whether the next message begins another block."""
        return len(self.messages) >= BLOCK_SAMPLES or self.size >= PIECE_BYTES

    def extend(self, messages: Sequence[bytes]) -> None:
        """Continue with ``messages``."""
        for message in messages:
            self.messages.append(message)
            self._ends.append(self._ends[-1] + len(message))

    def part(self, number: int, until: int) -> tuple[int, bytes]:
        """From sample ``number`` on at most `PIECE_BYTES`, nothing after sample ``until``: the last
        sample's number, and the messages. At least one message. Cost: O(what is given)."""
        begin = number - self.first
        most = bisect_right(self._ends, self._ends[begin] + PIECE_BYTES) - 1
        stop = max(begin + 1, min(most, until + 1 - self.first, len(self.messages)))
        if stop == begin + 1:
            return number, self.messages[begin]
        return self.first + stop - 1, b"".join(self.messages[begin:stop])


class Blocks:
    """The blocks of one stream that are kept, by the numbers of their first samples."""

    def __init__(self, cache: MessageCache) -> None:
        self._cache = cache
        self._firsts: list[int] = []
        self._blocks: list[Block] = []

    def find(self, number: int) -> Block | None:
        """The block that has the message of sample ``number``. Cost: O(log blocks)."""
        i = bisect_right(self._firsts, number) - 1
        if i < 0 or number >= self._blocks[i].end:
            return None
        block = self._blocks[i]
        self._cache.use(block)
        return block

    def place(self, number: int) -> tuple[Block, int]:
        """Where the message of sample ``number``, which is not kept, belongs: a block that ends
        right before it, a new one otherwise; and how many messages it has room for."""
        i = bisect_right(self._firsts, number)
        if i and self._blocks[i - 1].end == number and not self._blocks[i - 1].is_full:
            block = self._blocks[i - 1]
        else:
            block = Block(self, number)
            self._firsts.insert(i, number)
            self._blocks.insert(i, block)
            i += 1
        room = BLOCK_SAMPLES - len(block.messages)
        if i < len(self._firsts):
            room = min(room, self._firsts[i] - number)
        return block, room

    def extend(self, block: Block, messages: Sequence[bytes]) -> None:
        """Continue ``block``; others are forgotten where there is no room for it."""
        block.extend(messages)
        self._cache.grown(block, sum(map(len, messages)))

    def forget(self, block: Block) -> None:
        """``block`` is not kept any more; who has it may still read it."""
        i = bisect_right(self._firsts, block.first) - 1
        del self._firsts[i]
        del self._blocks[i]

    def clear(self) -> None:
        """Nobody listens to the stream any more."""
        for block in list(self._blocks):
            self._cache.drop(block)


class MessageCache:
    """All blocks that are kept; the least recently read go when there are more than ``limit``
    bytes."""

    def __init__(self, limit: int) -> None:
        self.size = 0
        self._limit = limit
        self._blocks: OrderedDict[Block, None] = OrderedDict()

    def use(self, block: Block) -> None:
        """``block`` is read."""
        self._blocks.move_to_end(block)

    def grown(self, block: Block, count: int) -> None:
        """``block``, new or known, has so many bytes more."""
        self._blocks[block] = None
        self._blocks.move_to_end(block)
        self.size += count
        while self.size > self._limit:
            self.drop(next(iter(self._blocks)))

    def drop(self, block: Block) -> None:
        """Keep ``block`` no longer."""
        del self._blocks[block]
        self.size -= block.size
        block.owner.forget(block)
