"""The error of all languages: message, place, caret, hint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

LONGEST_LINE: Final = 200
"""Characters of a source line that an error shows. A client that sent a long line need not get all
of it back."""


@dataclass(frozen=True, slots=True)
class Span:
    """A range of a source text: half-open character offsets ``[start, end)``."""

    start: int
    end: int


class LanguageError(ValueError):
    """A language refused a text. Nothing of the text took effect.

    ``message`` states the problem, ``hint`` the next step (may be empty). ``line`` and ``column``
    count characters from 1. `render` draws the line with a caret under the place.
    """

    def __init__(self, message: str, source: str, span: Span, hint: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.source = source
        self.span = span
        self.hint = hint

    @property
    def line(self) -> int:
        return self.source.count("\n", 0, self.span.start) + 1

    @property
    def column(self) -> int:
        return self.span.start - (self.source.rfind("\n", 0, self.span.start) + 1) + 1

    def render(self) -> str:
        """Return message, place, source line, a caret under the span, and the hint."""
        begin = self.source.rfind("\n", 0, self.span.start) + 1
        end = self.source.find("\n", begin)
        text = self.source[begin:] if end < 0 else self.source[begin:end]
        width = max(1, min(self.span.end, begin + len(text)) - self.span.start)
        first = self.span.start - begin
        if len(text) > LONGEST_LINE:
            # Cut a long line down to the surroundings of the place.
            cut = max(0, first - LONGEST_LINE // 2)
            rest = text[cut:]
            text = ("…" if cut else "") + rest[:LONGEST_LINE]
            text += "…" if len(rest) > LONGEST_LINE else ""
            first += (1 if cut else 0) - cut
            width = max(1, min(width, len(text) - first))
        # The margin repeats tabs, so that the caret stands under its character.
        margin = "".join("\t" if c == "\t" else " " for c in text[:first])
        lines = [
            f"line {self.line}, column {self.column}: {self.message}",
            f"  {text}",
            f"  {margin}{'^' * width}",
        ]
        if self.hint:
            lines.append(f"hint: {self.hint}")
        return "\n".join(lines)

    def __str__(self) -> str:
        return self.render()
