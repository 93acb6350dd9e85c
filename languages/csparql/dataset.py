"""FROM clauses: static graphs and streams, of C-SPARQL and of RSP-QL ([Events14 §III.A], SPEC §5).

C-SPARQL has ``FROM <g>`` and ``FROM STREAM <s> […]``. RSP-QL has ``FROM NAMED WINDOW <w> ON <s>
[…]``, whose triples only ``WINDOW <w> {…}`` reads, and ``FROM WINDOW <w> ON <s> […]``, which is
FROM STREAM with an unused name.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import Final

from ...sparql.cursor import Cursor
from ...sparql.tokens import Token
from ..errors import LanguageError, Span
from .ast import StreamClause, Window
from .windows import EXAMPLE, Every, read_window

_NAMED_EXAMPLE: Final = "write `FROM NAMED WINDOW :w ON <stream> [RANGE PT5S STEP PT1S]`"


class Source(Enum):
    """The clause that names a stream."""

    STREAM = "FROM STREAM"
    WINDOW = "FROM WINDOW"
    NAMED_WINDOW = "FROM NAMED WINDOW"


@dataclass(frozen=True, slots=True)
class StreamSource:
    """A clause that names a stream, as written. ``name`` is the name of its window, if it
    has one."""

    source: Source
    iri: Token
    name: Token | None
    window: Window | None
    span: Span


@dataclass(slots=True)
class Dataset:
    """The tokens of the FROM clauses, in their order."""

    static: list[Token] = field(default_factory=list)
    static_named: list[Token] = field(default_factory=list)
    streams: list[StreamSource] = field(default_factory=list)

    @property
    def has_windows(self) -> bool:
        """True if a clause of RSP-QL names a stream."""
        return any(source.source is not Source.STREAM for source in self.streams)

    def of(self, kind: Source) -> list[StreamSource]:
        return [source for source in self.streams if source.source is kind]


def read_from(at: Cursor, dataset: Dataset, every: Every) -> None:
    """Read any form of FROM clause, after the word FROM."""
    first = at.last_token
    if at.is_word("STREAM"):
        at.take()
        dataset.streams.append(_stream(at, first, Source.STREAM, None, every))
    elif at.is_word("WINDOW"):
        at.take()
        name = None if at.is_word("ON") else at.iri("FROM WINDOW")
        dataset.streams.append(_on_stream(at, first, Source.WINDOW, name, every))
    elif at.is_word("NAMED"):
        at.take()
        if at.is_word("STREAM"):
            raise at.error("a stream has no name, only its window has", at.here, _NAMED_EXAMPLE)
        if at.is_word("WINDOW"):
            at.take()
            name = at.iri("FROM NAMED WINDOW")
            dataset.streams.append(_on_stream(at, first, Source.NAMED_WINDOW, name, every))
        else:
            dataset.static_named.append(_static(at, "FROM NAMED"))
    else:
        dataset.static.append(_static(at, "FROM"))


def _static(at: Cursor, words: str) -> Token:
    iri = at.iri(words)
    if at.is_mark("["):
        raise at.error(
            "a static graph has no window", at.here, f"write `FROM STREAM {iri.text} […]`"
        )
    return iri


def _on_stream(
    at: Cursor, first: Token, source: Source, name: Token | None, every: Every
) -> StreamSource:
    if not at.is_word("ON"):
        raise at.expected("ON", _NAMED_EXAMPLE)
    at.take()
    if at.is_word("STREAM"):
        at.take()
    return _stream(at, first, source, name, every)


def _stream(
    at: Cursor, first: Token, source: Source, name: Token | None, every: Every
) -> StreamSource:
    iri = at.iri("FROM STREAM" if source is Source.STREAM else "ON")
    window = read_window(at, "a stream's window", every) if at.is_mark("[") else None
    return StreamSource(source, iri, name, window, Span(first.start, at.last_token.end))


def stream_clauses(at: Cursor, dataset: Dataset, default: Window | None) -> list[StreamClause]:
    """Resolve the IRIs of the clauses. A stream without a window gets that of the WINDOW clause."""
    clauses: list[StreamClause] = []
    streams: set[str] = set()
    windows: set[str] = set()
    graphs = {at.iri_of(token) for token in dataset.static_named}
    for source in dataset.streams:
        window = source.window or default
        if window is None:
            raise at.error("the stream has no window", source.iri, EXAMPLE)
        iri = at.iri_of(source.iri)
        if source.source is Source.STREAM:
            if iri in streams:
                raise _twice(at, source.iri)
            streams.add(iri)
        name = None
        if source.name is not None:
            name = at.iri_of(source.name)
            _check_name(at, source.name, name in windows, name in graphs)
            windows.add(name)
        if source.source is not Source.NAMED_WINDOW:
            name = None
        clauses.append(StreamClause(iri, window, source.span, name))
    return clauses


def _twice(at: Cursor, token: Token) -> LanguageError:
    return at.error(
        f"the stream `{token.text}` is named twice",
        token,
        "for two windows over one stream name them: `FROM NAMED WINDOW :w ON <stream> […]`",
    )


def _check_name(at: Cursor, token: Token, is_window: bool, is_graph: bool) -> None:
    if is_window:
        raise at.error(
            f"the window `{token.text}` occurs twice", token, "give each window its own name"
        )
    if is_graph:
        raise at.error(
            f"`{token.text}` is the name of a window and of a FROM NAMED graph",
            token,
            "give the window a name of its own",
        )
