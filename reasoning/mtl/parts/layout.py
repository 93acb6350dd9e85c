"""Where the loops over parts (`loop`) have what they know of states, parts and nodes."""

from __future__ import annotations

from typing import Any, Final

from ..windows import NEVER

HOLDS, UNKNOWN = 1, 2
"""What a state has for an atom, two bits."""
IN_A_WORD: Final = 31
"""The atoms in a word."""
ANY_UNKNOWN: Final = sum(UNKNOWN << 2 * atom for atom in range(IN_A_WORD))

# The fields of a state: its valid time, horizon, when it left, whether its verdict is out, and from
# there on words of atoms; then what each node has there (`status`), or with robustness the margin
# of each atom.
VALID, HORIZON, LEFT, IS_DONE, ATOMS = range(5)

SIDES: Final = 2
"""The tables of a node: where it is true, and where it is false. Table ``SIDES * node + side``."""
ROW_BITS: Final = 24
MOST_ROWS: Final = (1 << ROW_BITS) - 1
"""The most states of a part."""
PENDING: Final = 0
"""What a node has at a state as long as it is not decided."""

REMEMBERED, OF_STATE = 1, 2
"""What a node is: one of a past without end of which it needs the first state alone that decides it
(`formulas.is_remembered`); one that its own state decides."""

# The cursors of a node, rows of its part. Those of the future: before `LOW` all starts are decided,
# before `CLOSED` the interval of each is over; the rows from the interval of `LOW` up to `NEXT` are
# ruled out. Those of the past, of the newest start: the row after its interval; the last row there
# that is true, and that is not ruled out. The last row at which the left part fails, and at which
# it is not true; of `once` the rows known to be ruled out, from one up to the other.
LOW, CLOSED, NEXT, LAST_TRUE, LAST_FAILED, LAST_OPEN = range(6)
INTERVAL_END, LAST_POSSIBLE, RULED_OUT_FROM, RULED_OUT_TO = CLOSED, NEXT, LAST_FAILED, LAST_OPEN
CURSORS: Final = 6


def words_of(atoms: int) -> int:
    """The words for so many atoms."""
    return (atoms + IN_A_WORD - 1) // IN_A_WORD


def status(moment: Any, side: Any) -> Any:
    """What a node has at a state from the moment on at which it is decided."""
    return moment << 2 | 2 | side


def event_of(moment: Any, row: Any, side: Any) -> Any:
    """That a node is decided at a row: a number, in order of the moment."""
    return (moment << ROW_BITS | row) << 1 | side


def row_of(event: Any) -> Any:
    """The row at which it is decided."""
    return (event >> 1) & MOST_ROWS


def when(event: Any) -> Any:
    """The moment at which it is decided."""
    return event >> (ROW_BITS + 1)


def makes(event: Any, table: Any) -> Any:
    """Whether the node of a table becomes true (or false) by an event of its own."""
    return (event ^ table) & 1 == 0


def is_decided_by(column: Any, row: Any, now: Any) -> Any:
    """Whether a node is decided at a row at a moment."""
    return column[row] != PENDING and column[row] >> 2 <= now


def is_by(column: Any, table: Any, row: Any, now: Any) -> Any:
    """Whether a node is known to be true (or false) at a row at a moment."""
    found = column[row]
    return found & 3 == (2 | (table & 1)) and found >> 2 <= now


def moment_of(column: Any, table: Any, row: Any) -> Any:
    """The moment at which a node became true (or false) at a row, or `NEVER`."""
    found = column[row]
    return found >> 2 if found & 3 == (2 | (table & 1)) else NEVER
