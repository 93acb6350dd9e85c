"""The errors of converters: of samples <-> triples, and of bytes -> samples."""

from __future__ import annotations


class ConversionError(ValueError):
    """An annotation that cannot be compiled to columns, or a batch that it does not fit.

    ``row`` counts from 0 within the batch and ``field`` names the field; either may be None.
    ``hint`` says what to do next (may be empty).
    """

    def __init__(
        self, message: str, *, row: int | None = None, field: str | None = None, hint: str = ""
    ) -> None:
        super().__init__(message)
        self.message = message
        self.row = row
        self.field = field
        self.hint = hint

    def __str__(self) -> str:
        place = "" if self.row is None else f"row {self.row}: "
        return f"{place}{self.message}" + (f" ({self.hint})" if self.hint else "")


class WireError(ValueError):
    """Bytes that are no batch of samples; the decoder took nothing of the batch.

    ``line`` counts from 1 (records, in a format without lines); None if the error has no line.
    ``hint`` says what to do next (may be empty).
    """

    def __init__(self, line: int | None, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.line = line
        self.message = message
        self.hint = hint

    def __str__(self) -> str:
        place = "" if self.line is None else f"line {self.line}: "
        return f"{place}{self.message}" + (f" ({self.hint})" if self.hint else "")


class AheadOfClock(WireError):
    """A sample, the first of its batch, is stamped further ahead of the clock than its stream
    allows; ``latest`` (ns) is the greatest available time that the stream takes now."""

    def __init__(self, line: int | None, message: str, hint: str, latest: int) -> None:
        super().__init__(line, message, hint)
        self.latest = latest


class EmptyTable(WireError):
    """A recording without a sample."""
