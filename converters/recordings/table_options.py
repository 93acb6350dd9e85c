"""How a recorded table is read, where its own text does not say it."""

from __future__ import annotations

from dataclasses import dataclass

from ..inference import TimeReader


@dataclass(frozen=True, slots=True)
class TableOptions:
    """The options of a table; None: found out from the table.

    ``time_column``: default ``valid``, ``timestamp``, ``time`` or ``t``. ``time_unit`` of numeric
    times: ``s ms us ns``, default by their magnitude; ``abstract_unit`` if they are small.
    ``time_format`` of times that are texts: a pattern of ``strptime``, or ``day-first``; default
    ISO-8601. ``delimiter`` of CSV: default by the header.
    """

    time_column: str | None = None
    time_unit: str | None = None
    time_format: str | None = None
    delimiter: str | None = None
    abstract_unit: str = "s"

    def times(self) -> TimeReader:
        """A reader of the table's times. Raises `WireError` for an unknown unit or format."""
        return TimeReader(self.time_unit, self.abstract_unit, self.time_format)


GUESSED = TableOptions()
"""All is found out from the table."""
