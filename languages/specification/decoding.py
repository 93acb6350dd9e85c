"""Decodes a specification to characters: size, encoding, characters.

It accepts UTF-8 and UTF-16, as every XML processor must (XML 1.0 §4.3.3). A str is decoded already,
so the encoding that its declaration names does not apply and is ignored.
"""

from __future__ import annotations

import codecs
import re
from typing import Final

from ..errors import LanguageError, Span
from .markup import abbreviate

MAX_BYTES: Final = 2 * 1024 * 1024
"""The greatest size in bytes; a str counts as UTF-8."""

_DECLARED: Final = re.compile(
    r"<\?xml[ \t\r\n][^<>]*?[ \t\r\n]encoding[ \t\r\n]*=[ \t\r\n]*[\"']([^\"'<>]*)[\"']"
)
_NO_CHARACTER: Final = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
# The first bytes identify the encoding (XML 1.0, appendix F). UTF-32 begins like UTF-16, so it
# comes first.
_MARKS: Final = (
    (codecs.BOM_UTF32_LE, "UTF-32", ""),
    (codecs.BOM_UTF32_BE, "UTF-32", ""),
    (codecs.BOM_UTF8, "UTF-8", "utf-8"),
    (codecs.BOM_UTF16_LE, "UTF-16", "utf-16-le"),
    (codecs.BOM_UTF16_BE, "UTF-16", "utf-16-be"),
)
_UNMARKED: Final = (
    (b"<\0\0\0", "UTF-32", ""),
    (b"\0\0\0<", "UTF-32", ""),
    (b"<\0", "UTF-16", "utf-16-le"),
    (b"\0<", "UTF-16", "utf-16-be"),
    (b"", "UTF-8", "utf-8"),
)
_NAMES: Final = {
    "UTF-8": ("utf-8", "utf8", "us-ascii", "ascii"),
    "UTF-16": ("utf-16", "utf-16le", "utf-16be"),
}
_AS_UTF_8: Final = 'write the text as UTF-8, with encoding="UTF-8" or no encoding in its first line'


def decode(text: str | bytes) -> str:
    """Return the characters of the text, without byte order mark.

    Raises `LanguageError` for a text that is too large, an encoding other than UTF-8 and UTF-16 or
    than the declared one, bytes that the encoding does not allow, and characters that XML does not
    allow.
    """
    _check_size(text)
    source = text.removeprefix("\ufeff") if isinstance(text, str) else _decoded_bytes(text)
    wrong = _NO_CHARACTER.search(source)
    if wrong is not None:
        raise LanguageError(
            f"U+{ord(wrong[0]):04X} is not an XML character",
            _NO_CHARACTER.sub("\ufffd", source),
            Span(*wrong.span()),
            "leave it out: XML cannot express it",
        )
    return source


def is_character(text: str) -> bool:
    """Return whether XML allows each character of the text."""
    return _NO_CHARACTER.search(text) is None


def _check_size(text: str | bytes) -> None:
    size = len(text)
    if size <= MAX_BYTES and isinstance(text, str):
        size = len(text.encode("utf-8", "surrogatepass"))
    if size > MAX_BYTES:
        # Without the text: the error must not keep in memory what is too large to parse.
        raise LanguageError(
            f"the text has {size:,} bytes, and at most {MAX_BYTES:,} are read",
            "",
            Span(0, 0),
            "split it: a later text reads units of an earlier one by `stream`",
        )


def _decoded_bytes(text: bytes) -> str:
    mark, name, codec = next(
        encoding for encoding in (*_MARKS, *_UNMARKED) if text.startswith(encoding[0])
    )
    if not codec:
        raise _unread(name, "", Span(0, 0))
    body = text if (mark, name, codec) in _UNMARKED else text.removeprefix(mark)
    # The declaration is ASCII, so it is readable even if the encoding is wrong.
    source = body.decode(codec, "replace")
    _check_declared(source, name)
    try:
        return body.decode(codec)
    except UnicodeDecodeError as error:
        start = len(body[: error.start].decode(codec))
        raise LanguageError(
            f"these bytes are not {name}", source, Span(start, start + 1), _AS_UTF_8
        ) from None


def _check_declared(source: str, name: str) -> None:
    """Check that the declared encoding is that of the bytes."""
    declared = _DECLARED.match(source)
    if declared is None or declared[1].lower() in _NAMES[name]:
        return
    if any(declared[1].lower() in names for names in _NAMES.values()):
        raise LanguageError(
            f"the text is {name}, but declares the encoding `{abbreviate(declared[1])}`",
            source,
            Span(*declared.span(1)),
            f'declare encoding="{name}", or leave the encoding out',
        )
    raise _unread(declared[1], source, Span(*declared.span(1)))


def _unread(name: str, source: str, span: Span) -> LanguageError:
    return LanguageError(
        f"the encoding `{abbreviate(name)}` is not supported", source, span, _AS_UTF_8
    )
