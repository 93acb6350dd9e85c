"""How long texts may be that declare something: what the service refuses and the client divides."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final

LONGEST: Final = 128 * 1024
"""Bytes of a text in SSL, KPL or XML."""
MOST_WORDS: Final = 2048
"""Words and signs of a text in SSL or KPL: seven make a feature of a stream, some eight a unit."""
MOST_DECLARATIONS: Final = 128
"""Of one text: each costs the engine up to a millisecond."""
MOST_CONTENTS: Final = 256
"""Features that streams contain, of one request in JSON: what SSL can say in its words."""
MOST_PARTS: Final = 128
"""Units that one text inserts, and units that it removes: each costs the engine up to a
millisecond, in which everybody waits."""
MOST_ELEMENTS: Final = 2048
"""Elements of a text, parameters and streams among them."""
# Its end is matched, too: else a comment there would be looked into.
_WORD: Final = re.compile(r"""(?:\s+|\#[^\n\r]*|//[^\n\r]*)*+("[^"\n]*+"|\w+|[^\w\s]|\Z)""")


def count_words(text: str) -> int:
    """How many words and signs a text in SSL or KPL has."""
    return sum(1 for _ in words(text))


def words(text: str) -> Iterator[re.Match[str]]:
    """Each of them."""
    return (found for found in _WORD.finditer(text) if found[1])
