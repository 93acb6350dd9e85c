"""Limits of texts that declare something: the service refuses longer ones, the client splits
them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final

LONGEST: Final = 128 * 1024
"""Bytes of a text in SSL, KPL or XML."""
MOST_WORDS: Final = 2048
"""Words and signs of a text in SSL or KPL: a feature of a stream has seven, a unit about eight."""
MOST_DECLARATIONS: Final = 128
"""Declarations of one text: each takes the engine up to a millisecond."""
MOST_CONTENTS: Final = 256
"""Features of streams in one request in JSON, about as many as SSL can state in its words."""
MOST_PARTS: Final = 128
"""Units that one text inserts, and units that it removes: each takes the event loop up to a
millisecond."""
MOST_ELEMENTS: Final = 2048
"""XML elements of a text, with those of parameters and streams."""
# It matches the end of the text too: otherwise it would find words in a comment there.
_WORD: Final = re.compile(r"""(?:\s+|\#[^\n\r]*|//[^\n\r]*)*+("[^"\n]*+"|\w+|[^\w\s]|\Z)""")


def count_words(text: str) -> int:
    """Count the words and signs of a text in SSL or KPL."""
    return sum(1 for _ in words(text))


def words(text: str) -> Iterator[re.Match[str]]:
    """The words and signs of a text in SSL or KPL."""
    return (found for found in _WORD.finditer(text) if found[1])
