"""A cache of samples encoded as messages of server-sent events (docs/reference/streams.md).

A `Block` has the messages of consecutive samples. Whole blocks are evicted, so that the cache needs
no entry for each sample. `Blocks` are those of one stream; `MessageCache` bounds the bytes of all.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Sequence
from itertools import accumulate

PIECE_BYTES = 32 * 1024
"""The greatest size of one send, unless one message is longer. It bounds the memory of a stalled
client, and the time that the others wait for a fast one."""
BLOCK_SAMPLES = 256
"""The greatest number of messages in a block."""


class Block:
    """Messages of the samples from ``first`` until before ``end``."""

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
        """Append ``messages``."""
        self.messages += messages
        ends = accumulate(map(len, messages), initial=self._ends.pop())
        self._ends += ends

    def part(self, number: int, until: int) -> tuple[int, bytes]:
        """Return at most `PIECE_BYTES` of messages from sample ``number`` to at most ``until``, but
        at least one message: the last sample's number, and the bytes. Cost: O(bytes)."""
        begin = number - self.first
        most = bisect_right(self._ends, self._ends[begin] + PIECE_BYTES) - 1
        stop = max(begin + 1, min(most, until + 1 - self.first, len(self.messages)))
        if stop == begin + 1:
            return number, self.messages[begin]
        return self.first + stop - 1, b"".join(self.messages[begin:stop])


class Blocks:
    """The cached blocks of one stream, ordered by the numbers of their first samples."""

    def __init__(self, cache: MessageCache) -> None:
        self._cache = cache
        self._firsts: list[int] = []
        self._blocks: list[Block] = []

    def find(self, number: int) -> Block | None:
        """Return the block with sample ``number``, or None. Cost: O(log blocks)."""
        i = bisect_right(self._firsts, number) - 1
        if i < 0 or number >= self._blocks[i].end:
            return None
        block = self._blocks[i]
        self._cache.use(block)
        return block

    def place(self, number: int) -> tuple[Block, int]:
        """Return the block for sample ``number``, which is not cached, and the number of messages
        that fit: the block that ends right before it, or else a new one."""
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
            # The next block already has the messages from there on.
            room = min(room, self._firsts[i] - number)
        return block, room

    def extend(self, block: Block, messages: Sequence[bytes]) -> None:
        """Append to ``block``, and evict others if there is no room."""
        block.extend(messages)
        self._cache.grow(block, sum(map(len, messages)))

    def forget(self, block: Block) -> None:
        """Forget an evicted block. A caller that has it may still read it."""
        i = bisect_right(self._firsts, block.first) - 1
        del self._firsts[i]
        del self._blocks[i]

    def clear(self) -> None:
        """Drop all blocks: the stream has no clients."""
        for block in list(self._blocks):
            self._cache.drop(block)


class MessageCache:
    """The cached blocks of all streams: an LRU cache of at most ``limit`` bytes."""

    def __init__(self, limit: int) -> None:
        self.size = 0
        self._limit = limit
        self._blocks: OrderedDict[Block, None] = OrderedDict()

    def use(self, block: Block) -> None:
        """Note that ``block`` was read."""
        self._blocks.move_to_end(block)

    def grow(self, block: Block, count: int) -> None:
        """Note that ``block``, new or old, has ``count`` bytes more, and evict others."""
        self._blocks[block] = None
        self._blocks.move_to_end(block)
        self.size += count
        while self.size > self._limit:
            # This may evict ``block`` itself, and the caller can still read it.
            self.drop(next(iter(self._blocks)))

    def drop(self, block: Block) -> None:
        """Remove ``block`` from the cache."""
        del self._blocks[block]
        self.size -= block.size
        block.owner.forget(block)
