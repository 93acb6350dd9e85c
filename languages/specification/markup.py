"""Finds the tags of an XML text, with their places, and explains broken ones.

libxml2 reports lines of elements at best, so this scan provides the places: the n-th tag here is
libxml2's n-th element. Texts that the scan refuses never reach libxml2: those with a DOCTYPE, and
thereby all entities, and those that nest too deeply. The scan is one pass; libxml2 refuses the
other malformed texts (`document`).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from dataclasses import field as attribute
from itertools import islice
from typing import Final, NoReturn

from ..errors import LanguageError, Span

NAMESPACE: Final = "http://www.dyknow.eu/ontology#Specification"
XSI: Final = "http://www.w3.org/2001/XMLSchema-instance"

MAX_DEPTH: Final = 100
"""The greatest depth of nested elements, `specification` and `insertions` included. Python
compares, prints and copies values of this depth by recursion."""

MOST_ATTRIBUTES: Final = 64
"""The greatest number of attributes of an element: libxml2 compares each with all others."""

BLANKS: Final = " \t\r\n"
_NAME: Final = r"""[^ \t\r\n<>/='"&]+"""
_ATTRIBUTE: Final = re.compile(rf"""[ \t\r\n]+({_NAME})[ \t\r\n]*=[ \t\r\n]*("[^"<]*"|'[^'<]*')""")
# Possessive quantifiers keep a broken tag at linear cost.
_START_TAG: Final = re.compile(rf"<({_NAME})(?:{_ATTRIBUTE.pattern})*+[ \t\r\n]*+(/?)>")
_END_TAG: Final = re.compile(rf"</({_NAME})[ \t\r\n]*>")
_WORD: Final = re.compile(_NAME)
_BARE_REFERENCE: Final = re.compile(
    r"&(?!(?:amp|lt|gt|quot|apos|#[0-9]+|#x[0-9A-Fa-f]+);)(?:#?[A-Za-z_][\w.-]*;)?"
)
# Markup with arbitrary contents: its beginning, its end, its name.
_OPAQUE: Final = (
    ("<!--", "-->", "comment"),
    ("<![CDATA[", "]]>", "CDATA section"),
    ("<?", "?>", "processing instruction"),
)


@dataclass(frozen=True, slots=True)
class Tag:
    """A start tag. ``name`` is as written, with its prefix; ``span`` reaches from ``<``
    to ``>``."""

    name: str
    span: Span

    @property
    def name_span(self) -> Span:
        return Span(self.span.start + 1, self.span.start + 1 + len(self.name))


@dataclass(frozen=True, slots=True)
class Attribute:
    """An attribute as written. ``value`` is the span between the quotes."""

    name: str
    span: Span
    value: Span

    @property
    def declares_namespace(self) -> bool:
        return self.name == "xmlns" or self.name.startswith("xmlns:")


@dataclass(frozen=True, slots=True)
class Markup:
    """The start tags in order; ``texts`` maps a tag to the offset of the first text
    directly in it."""

    source: str
    tags: tuple[Tag, ...]
    texts: dict[int, int]

    def attributes(self, tag: Tag) -> list[Attribute]:
        """Return the attributes of the tag in order, namespace declarations included."""
        found = _ATTRIBUTE.finditer(self.source, tag.name_span.end, tag.span.end)
        return [
            Attribute(match[1], Span(*match.span(1)), Span(match.start(2) + 1, match.end(2) - 1))
            for match in found
        ]


def scan(source: str) -> Markup:
    """Find the tags of the text. Cost: one pass.

    Raises `LanguageError` for a DOCTYPE, for too deep nesting, and for tags, comments or references
    that are broken, open, or closed in the wrong order.
    """
    scanner = _Scanner(source)
    position = 0
    while (start := source.find("<", position)) >= 0:
        scanner.text(position, start)
        position = scanner.markup(start)
    scanner.text(position, len(source))
    scanner.end()
    return Markup(source, tuple(scanner.tags), scanner.texts)


@dataclass(slots=True)
class _Scanner:
    source: str
    tags: list[Tag] = attribute(default_factory=list)
    texts: dict[int, int] = attribute(default_factory=dict)
    # Open tags, as indices into `tags`.
    open: list[int] = attribute(default_factory=list)

    def error(self, message: str, start: int, end: int, hint: str) -> LanguageError:
        return LanguageError(message, self.source, Span(start, end), hint)

    def text(self, start: int, end: int) -> None:
        """Check the text between two pieces of markup."""
        self.references(start, end)
        piece = self.source[start:end]
        blank = len(piece) - len(piece.lstrip(BLANKS))
        if blank < len(piece):
            self.characters(start + blank, start + len(piece.rstrip(BLANKS)))

    def characters(self, start: int, end: int) -> None:
        if not self.open:
            where = "after" if self.tags else "before"
            raise self.error(
                f"text is not allowed {where} the specification",
                start,
                end,
                "a text consists of one element `specification` and comments",
            )
        self.texts.setdefault(self.open[-1], start)

    def references(self, start: int, end: int) -> None:
        wrong = _BARE_REFERENCE.search(self.source, start, end)
        if wrong is None:
            return
        if wrong[0] == "&":
            raise self.error("`&` begins no reference", *wrong.span(), "write `&amp;` for `&`")
        raise self.error(
            f"there is no entity `{abbreviate(wrong[0])}`",
            *wrong.span(),
            "there are `&amp;` `&lt;` `&gt;` `&quot;` `&apos;` and numbers such as `&#233;`",
        )

    def markup(self, start: int) -> int:
        """Read the markup at ``start``; return its end."""
        for begin, end, what in _OPAQUE:
            if self.source.startswith(begin, start):
                return self.opaque(start, begin, end, what)
        if self.source.startswith("<!", start):
            self.declaration(start)
        if self.source.startswith("</", start):
            return self.end_tag(start)
        return self.start_tag(start)

    def opaque(self, start: int, begin: str, end: str, what: str) -> int:
        inner = start + len(begin)
        close = self.source.find(end, inner)
        if close < 0:
            raise self.error(f"the {what} is not closed", start, inner, f"close it with `{end}`")
        if begin == "<?" and start > 0 and re.compile(r"xml[ \t\r\n?]").match(self.source, inner):
            raise self.error(
                "the XML declaration must come first",
                start,
                close + len(end),
                "move it to the very beginning of the text, or leave it out",
            )
        if begin == "<![CDATA[" and self.source[inner:close].strip(BLANKS):
            self.characters(start, close + len(end))
        return close + len(end)

    def declaration(self, start: int) -> NoReturn:
        end = start + 2
        word = _WORD.match(self.source, end)
        end = end if word is None else word.end()
        if self.source[start + 2 : end].upper() == "DOCTYPE":
            raise self.error(
                "a DOCTYPE is refused",
                start,
                end,
                "leave it out: a specification has a schema of its own, and entities are not read",
            )
        raise self.error(
            f"`{self.source[start:end]}` begins no markup",
            start,
            end,
            "a comment is written `<!-- … -->`",
        )

    def end_tag(self, start: int) -> int:
        match = _END_TAG.match(self.source, start)
        if match is None:
            raise self.error(
                "the end tag is broken", start, start + 2, "an end tag is a name: `</spec:cu>`"
            )
        if not self.open:
            raise self.error(
                f"`</{abbreviate(match[1])}>` closes nothing",
                *match.span(),
                "leave it out, or open its element",
            )
        tag = self.tags[self.open.pop()]
        if tag.name != match[1]:
            line = self.source.count("\n", 0, tag.span.start) + 1
            raise self.error(
                f"expected `</{abbreviate(tag.name)}>`, found `</{abbreviate(match[1])}>`",
                *match.span(),
                f"`<{abbreviate(tag.name)}>` of line {line} is still open",
            )
        return match.end()

    def start_tag(self, start: int) -> int:
        match = _START_TAG.match(self.source, start)
        if match is None:
            self.broken_tag(start)
        self.references(*match.span())
        name = match[1]
        if self.tags and not self.open:
            raise self.error(
                f"`{abbreviate(name)}` follows the end of the specification",
                start + 1,
                start + 1 + len(name),
                "send each specification as a text of its own",
            )
        if len(self.open) == MAX_DEPTH:
            raise self.error(
                f"elements are nested more than {MAX_DEPTH} deep",
                *match.span(),
                "name a unit, and read it by `stream`",
            )
        most = islice(_ATTRIBUTE.finditer(self.source, start, match.end()), MOST_ATTRIBUTES + 1)
        if sum(1 for _ in most) > MOST_ATTRIBUTES:
            raise self.error(
                f"an element has more than {MOST_ATTRIBUTES} attributes",
                *match.span(),
                "the schema allows each attribute once",
            )
        if not match[4]:
            self.open.append(len(self.tags))
        self.tags.append(Tag(name, Span(*match.span())))
        return match.end()

    def end(self) -> None:
        if not self.tags:
            place = len(self.source.rstrip(BLANKS))
            raise self.error(
                "the text contains no specification",
                place,
                place,
                "it is an element: `<spec:specification …>…</spec:specification>`",
            )
        if self.open:
            tag = self.tags[self.open[-1]]
            name = abbreviate(tag.name)
            raise self.error(
                f"`{name}` is not closed",
                tag.name_span.start,
                tag.name_span.end,
                f"write `</{name}>` after its contents, or end the tag with `/>`",
            )

    def broken_tag(self, start: int) -> NoReturn:
        """Raise the error for the first mistake in a broken start tag."""
        name = _WORD.match(self.source, start + 1)
        if name is None:
            raise self.error("`<` begins no tag", start, start + 1, "write `&lt;` for `<`")
        position = name.end()
        while match := _ATTRIBUTE.match(self.source, position):
            position = match.end()
        place = re.compile(rf"[{BLANKS}]*").match(self.source, position)
        position = position if place is None else place.end()
        word = _WORD.match(self.source, position)
        if word is not None and (word[0][0].isalpha() or word[0][0] == "_"):
            self.broken_attribute(position, word)
        if position == len(self.source) or self.source[position] == "<":
            raise self.error(
                f"the tag `{abbreviate(name[0])}` has no end",
                *name.span(),
                "end it with `>` or `/>`",
            )
        raise self.error(
            f"`{self.source[position]}` is not allowed in a tag",
            position,
            position + 1,
            'a tag is a name and attributes: `<spec:cu type="gps" />`',
        )

    def broken_attribute(self, position: int, word: re.Match[str]) -> NoReturn:
        name = abbreviate(word[0])
        equals = re.compile(rf"[{BLANKS}]*=[{BLANKS}]*").match(self.source, word.end())
        if equals is None:
            message, hint = f"the attribute `{name}` has no value", f'write `{name}="…"`'
        elif self.source[position - 1] not in BLANKS:
            message, hint = f"a blank is missing before `{name}`", "separate attributes by blanks"
        elif self.source[equals.end() : equals.end() + 1] not in ('"', "'"):
            message, hint = f"the value of `{name}` is not in quotes", f'write `{name}="…"`'
        else:
            message = f"the value of `{name}` is not closed, or contains `<`"
            hint = "close it with its opening quote; write `&lt;` for `<`"
        raise self.error(message, *word.span(), hint)


def abbreviate(text: str) -> str:
    """Return a name or value for a message, shortened if it is long."""
    return text if len(text) <= 60 else f"{text[:60]}…"
