"""Converts libxml2's errors to plain messages at the right place.

These are the errors that the scan in `markup` does not detect: references to invalid characters,
repeated attributes, prefixes, the XML declaration. libxml2 reports where it stopped, which is the
end of the mistake; its column counts characters.
"""

from __future__ import annotations

import re
from bisect import bisect_left
from typing import Final

from lxml.etree import ErrorTypes

from ..errors import LanguageError, Span
from .markup import NAMESPACE, XSI, Markup, Tag, abbreviate

_NO_CHARACTER: Final = (
    ErrorTypes.ERR_INVALID_CHAR,
    ErrorTypes.ERR_INVALID_CHARREF,
    ErrorTypes.ERR_INVALID_DEC_CHARREF,
    ErrorTypes.ERR_INVALID_HEX_CHARREF,
)
_TWICE: Final = (ErrorTypes.ERR_ATTRIBUTE_REDEFINED, ErrorTypes.NS_ERR_ATTRIBUTE_REDEFINED)
_NO_NAME: Final = (ErrorTypes.ERR_NAME_REQUIRED, ErrorTypes.NS_ERR_QNAME)


def malformed_error(
    markup: Markup, code: int, message: str, line: int, column: int
) -> LanguageError:
    """Convert an error of libxml2; ``code`` is one of its ErrorTypes, line and column
    count from 1."""
    source = markup.source
    end = _offset(source, line, column)
    declaration = source.find("?>") + 2 if source.startswith("<?xml") else 0
    if end <= declaration:
        text = "the XML declaration is malformed"
        hint = 'write `<?xml version="1.0" encoding="UTF-8"?>`, or leave it out'
        return LanguageError(text, source, Span(0, declaration), hint)
    if code in _TWICE:
        return _given_twice(markup, end)
    if code == ErrorTypes.NS_ERR_UNDEFINED_NAMESPACE:
        return _undeclared_prefix(markup, message, end)
    if code in _NO_NAME:
        tag = _tag_before(markup, end)
        text = f"the tag `{abbreviate(tag.name)}` has a name that XML does not allow"
        hint = "a name begins with a letter or `_`, and has one `:` at most, after a prefix"
        return LanguageError(text, source, tag.name_span, hint)
    if code in _NO_CHARACTER and (start := source.rfind("&", 0, end)) >= 0:
        close = max(source.find(";", start) + 1, start + 1)
        text = f"`{abbreviate(source[start:close])}` is not an XML character"
        return LanguageError(
            text, source, Span(start, close), "leave it out: XML cannot express it"
        )
    if code == ErrorTypes.ERR_HYPHEN_IN_COMMENT:
        start = source.rfind("--", 0, end + 2)
        text = "`--` is not allowed in a comment"
        return LanguageError(text, source, Span(start, start + 2), "write `- -`")
    if code == ErrorTypes.ERR_MISPLACED_CDATA_END:
        start = max(source.find("]]>", max(end - 3, 0)), 0)
        text = "`]]>` ends a CDATA section, but none is open"
        return LanguageError(text, source, Span(start, start + 3), "write `]]&gt;`")
    text = re.sub(r",? line \d+, column \d+$", "", message).strip()
    return LanguageError(
        f"this is not well-formed XML: {abbreviate(text)}",
        source,
        Span(max(end - 1, 0), end),
        "correct the text here or just before",
    )


def _given_twice(markup: Markup, end: int) -> LanguageError:
    """Return the error for an attribute, ending here, whose name occurs before."""
    tag = _tag_before(markup, end)
    again = [one for one in markup.attributes(tag) if one.span.start < end][-1]
    text = f"`{abbreviate(again.name)}` is given twice"
    return LanguageError(text, markup.source, again.span, "an element has each attribute once")


def _undeclared_prefix(markup: Markup, message: str, end: int) -> LanguageError:
    tag = _tag_before(markup, end)
    match = re.match(r"Namespace prefix (\S+) ", message)
    prefix = match[1] if match else tag.name.partition(":")[0]
    names = {tag.name: tag.name_span, **{one.name: one.span for one in markup.attributes(tag)}}
    found = [place for name, place in names.items() if name.startswith(f"{prefix}:")]
    start = found[0].start if found else tag.name_span.start
    namespace = {"xsi": XSI}.get(prefix, NAMESPACE)
    return LanguageError(
        f"the prefix `{abbreviate(prefix)}` is not declared",
        markup.source,
        Span(start, start + len(prefix)),
        f'declare it in the first element: xmlns:{abbreviate(prefix)}="{namespace}"',
    )


def _tag_before(markup: Markup, end: int) -> Tag:
    after = bisect_left(markup.tags, end, key=lambda tag: tag.span.start)
    return markup.tags[max(after - 1, 0)]


def _offset(source: str, line: int, column: int) -> int:
    """Return the offset of a line and column, clamped to the text."""
    start = 0
    for _ in range(line - 1):
        start = source.find("\n", start) + 1 or start
    return min(start + max(column - 1, 0), len(source))
