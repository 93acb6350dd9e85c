"""The parts of SASE+ patterns, and the concepts that their types are (SPEC §8)."""

from __future__ import annotations

from typing import Final

from ...rdf.namespaces import local_name
from ..errors import LanguageError, Span
from ..hints import meant, suggest_name
from ..mtl.ast import Symbol
from ..mtl.checked import Kind, kind_of
from ..ontology_names import OntologyNames
from . import ast
from .checked import TIME, VALUE, EventType

MOST_PARTS: Final = 16
MOST_TYPES: Final = 64
MOST_CONDITIONS: Final = 256
MOST_RESULTS: Final = 256
_LONGEST: Final = 1 << 60
"""Windows are shorter (36 years), so that sums of times stay within 64 bits."""


class Parts:
    """The parts of a pattern by their names, and the meaning of their types. All methods raise
    `LanguageError`."""

    def __init__(self, pattern: ast.Pattern, names: OntologyNames) -> None:
        self.pattern = pattern
        self.names = names
        self.of_name = {part.name: part for part in pattern.parts}
        self.there = tuple(part for part in pattern.parts if not part.is_negated)
        self._check()
        self.types = tuple(tuple(map(self._event_type, part.types)) for part in pattern.parts)

    def error(self, message: str, span: Span, hint: str = "") -> LanguageError:
        return LanguageError(message, self.names.source, span, hint)

    def part(self, name: str, span: Span) -> ast.Part:
        if name not in self.of_name:
            hint = suggest_name(name, self.of_name)
            raise self.error(f"the pattern has no part `{name}`", span, hint)
        return self.of_name[name]

    @property
    def stream(self) -> str:
        """The name of the stream of FROM; empty: matching finds the streams. An IRI names a stream
        by its last part, as in C-SPARQL's FROM STREAM."""
        written = self.pattern.stream
        if written is None or written.text.isidentifier():
            return "" if written is None else written.text
        iri = self.names.iris(written.text, written.span)[0]
        return local_name(iri).removesuffix(".trdf")

    def is_object(self, part: str, attribute: str) -> bool:
        """Whether an attribute of a part is an object."""
        index = list(self.of_name).index(part)
        return all(each.argument(attribute) is not None for each in self.types[index])

    def kind(self, part: str, attribute: str) -> Kind | None:
        """The kind of an attribute, as far as the ontology says."""
        if attribute == TIME:
            return Kind.TIME
        if self.is_object(part, attribute):
            return Kind.OBJECT
        types = self.types[list(self.of_name).index(part)]
        return types[0].kind if attribute == VALUE else None

    def _event_type(self, symbol: Symbol) -> EventType:
        names, vocabulary = self.names, self.names.vocabulary
        sort = names.find_sort(symbol.text, symbol.span)
        if sort is not None:
            return EventType(sort, is_sort=True)
        iris = names.iris(symbol.text, symbol.span)
        found = next((i for i in iris if vocabulary.is_feature(i) or vocabulary.is_event(i)), None)
        if found is None:
            raise self.error(
                f"the ontology knows no feature, event or sort `{symbol.text}`",
                symbol.span,
                meant(vocabulary.suggest(symbol.text)) or "declare it in the ontology",
            )
        info = vocabulary.feature(found)
        if info is None:
            return EventType(found, is_sort=False)
        kind = None if info.range is None else kind_of(info.range)
        if kind is None and info.unit is not None:
            kind = Kind.NUMBER
        return EventType(found, False, kind, info.unit or (), info.arity)

    def _check(self) -> None:
        pattern = self.pattern
        self._check_size()
        seen: set[str] = set()
        for part in pattern.parts:
            if part.name in seen:
                raise self.error(f"`{part.name}` is a part twice", part.span, "rename the second")
            seen.add(part.name)
        if not self.there:
            raise self.error(
                "a pattern needs an event that happens",
                pattern.parts[0].span,
                "write one without `~`: the others are absent before, between or after such events",
            )
        within = pattern.within
        if within is None:
            raise self.error(
                "a pattern without WITHIN would keep its events for ever",
                Span(pattern.span.start, pattern.span.start + len("PATTERN")),
                "write how long a match may last: `WITHIN 12 hours`",
            )
        if isinstance(within, int):
            check_within(within, pattern, self.names.source)

    def _check_size(self) -> None:
        pattern = self.pattern
        types = [each for part in pattern.parts for each in part.types]
        for what, some, most in (
            ("parts", pattern.parts, MOST_PARTS),
            ("types", types, MOST_TYPES),
            ("conditions", (*pattern.where, *pattern.having), MOST_CONDITIONS),
            ("results", pattern.items, MOST_RESULTS),
        ):
            if len(some) > most:
                raise self.error(
                    f"a pattern has at most {most} {what}",
                    some[most].span,
                    "divide it into patterns that read each other",
                )


def check_within(within: int, pattern: ast.Pattern, source: str) -> None:
    """Raise `LanguageError` for a window (ns) into which a match does not fit, or that is too
    long."""
    count = sum(not part.is_negated for part in pattern.parts)
    if within < count - 1:
        raise LanguageError(
            f"{count} events that follow each other do not fit into WITHIN",
            source,
            pattern.span,
            "write a longer time",
        )
    if within >= _LONGEST:
        raise LanguageError(
            "WITHIN exceeds 36 years", source, pattern.span, "write a shorter time, such as 365d"
        )
