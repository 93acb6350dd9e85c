"""Verdicts of a formula over the states of parts, each by itself: a compiled loop over new states
and the nodes of a program (`programs`).

``nodes``    int64 (programs, nodes, fields): the program of one reading, and of both
``roots``    int64 (programs, 5): the tables of the whole formula: true and false in the lower
             reading, then in the upper one; and the number of nodes
``kinds``    int64 (programs, nodes): what each node is, `REMEMBERED` and `OF_STATE`
``given``    uint8 (atoms + 1, n): of each new state `HOLDS` or `UNKNOWN` for each atom; last
             whether it may start
``margins``  float64 (atoms, n): with robustness, by how much each atom holds (`robustness`)
``times``    int64 (3, n): of each new state its valid time, its horizon, and when it left
``part``     int64 (n,): the part of each new state, in order
``states``   int64 (fields, places): the states kept (`layout`); those of a part are one after
             the other. The fields of margins are floats
``parts``    int64 (parts, fields): where these are; ``cursors`` int64 (parts, nodes, `CURSORS`)
``tables``   int64 (tables, rows): the events of each node (`progression`); with robustness
             then statuses, one a node, then margins, which are floats, one a node and two.
             ``scratch`` int64 (6, rows)
``control``  int64: numbers, at the places below
``out``      int64 (n, 7): verdicts: the part, the valid times of the start, of the deciding state
             and of the witness, when the deciding state left, the value, and the margin, a float

The file is long because compiled code calls compiled code only: all steps of the loop stand here.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from ....streams.jit import Kernel
from ....streams.time import TIME_MIN
from ..programs import (
    ATOM,
    END,
    LEFT_T,
    ONCE,
    OPERATION,
    OR,
    PREVIOUS,
    RIGHT_T,
    SINCE,
    TRUTH,
    UNTIL,
)
from ..time_searches import SEARCHES, back
from ..windows import NEVER
from .layout import (
    ANY_UNKNOWN,
    ATOMS,
    CURSORS,
    HORIZON,
    IN_A_WORD,
    IS_DONE,
    LAST_POSSIBLE,
    LAST_TRUE,
    LEFT,
    REMEMBERED,
    UNKNOWN,
    VALID,
    is_by,
    moment_of,
    row_of,
    when,
    words_of,
)
from .margins import MARGINS, TIED, decide_by_margins, fill_margins, margin_of
from .progression import PROGRESSION, fill, progress
from .witness import WITNESS, witness

# The fields of a part: its first state in ``states``, its states, the places that it has and the
# first of them; how many states it had by now, how many of those kept are without a verdict, and
# the first of these; the valid time before which each start has one; the verdicts by now; the
# program that its statuses are of, or -1, and the last row with an unknown atom, or -1.
FIRST, COUNT, PLACES, PLACE, SEEN, OPEN, FIRST_OPEN, SETTLED, UNKNOWNS, FALSES, TRUES = range(11)
PROGRAM, LAST_UNKNOWN = 11, 12
PART_FIELDS: Final = 13
# Whether each part has one start only; the verdicts in ``out`` may be violations alone; the most
# rows taken at once, and the most states of a part; whether there are margins; how far the formula
# reaches, and whether it looks back. Then what the loop says: places of ``states`` in use, verdicts
# in ``out``, true and unknown ones that are not, and what it stopped for, with the number that is
# needed.
IS_SINGLE, REPORTS_ALL, AT_ONCE, LIMIT, HAS_MARGINS, REACH, LOOKS_BACK = range(7)
USED, EMITTED, UNREPORTED_TRUE, UNREPORTED_UNKNOWN, STOPPED_FOR, NEEDED = range(7, 13)
CONTROLS: Final = 13
NOTHING, PLACES_WANTED, ROWS_WANTED, ROOM_WANTED, IS_TOO_LONG = range(5)
"""What the loop may stop for: places in ``states``, rows of ``tables``, room in ``out``; a part has
too many states."""
FEWEST: Final = 8
"""The places of a part with few states."""
# The rows of ``scratch``: of each row when it is decided and as what, or for `_report` the new
# verdicts; of `witness` and `fill_margins`; the events of each node; the hint of `witness`, which
# outlasts a step.
DECIDED, VALUES, MOMENTS, _, FOUND, HINT = range(6)
SCRATCH: Final = 6
FEW_VERDICTS: Final = 32
"""So many are sorted by insertion."""


def _report(
    own: Any, nodes: Any, roots: Any, valid: Any, horizon: Any, left: Any, is_done: Any, count: Any,
    base: Any, statuses: Any, rows: Any, events: Any, found: Any, parts: Any, scratch: Any,
    control: Any, out: Any,
) -> None:  # fmt: skip
    """Write the verdicts of the events of the whole formula, in order of the deciding state, then
    of the start."""
    new_rows, lower, upper = scratch[DECIDED], roots[0] >> 1, roots[2] >> 1
    count_lower, count_upper = found[lower], found[upper] if upper != lower else 0
    lowers, uppers = statuses[lower, rows], statuses[upper, rows]
    event = other = 0
    while event < count_lower or other < count_upper:
        one = events[lower, event] if event < count_lower else NEVER
        another = events[upper, other] if other < count_upper else NEVER
        now, new = when(min(one, another)), 0
        while event < count_lower and when(events[lower, event]) == now:
            new = _decided(
                own, roots, lowers, uppers, events[lower, event], is_done, new_rows, new, parts,
                control,
            )  # fmt: skip
            event += 1
        while other < count_upper and when(events[upper, other]) == now:
            new = _decided(
                own, roots, lowers, uppers, events[upper, other], is_done, new_rows, new, parts,
                control,
            )  # fmt: skip
            other += 1
        if new > 1:
            _sort(new_rows, new, is_done)
        for place in range(new):
            at = new_rows[place]
            value, found_at = _value(roots, lowers, uppers, at, now), -1
            if value >= 0:
                found_at = witness(
                    nodes, roots[0] if value else roots[3], at, valid, horizon, count, base,
                    statuses, rows, scratch[MOMENTS : MOMENTS + 2], scratch[HINT],
                )  # fmt: skip
            _write(own, at, now - base, found_at, value, valid, left, control, out)


def _decided(
    own: Any, roots: Any, lowers: Any, uppers: Any, event: Any, is_done: Any, rows: Any, count: Any,
    parts: Any, control: Any,
) -> Any:  # fmt: skip
    """Add a start that has its verdict just now, if that is reported; return how many there are."""
    row = row_of(event)
    if is_done[row]:
        return count
    value = _value(roots, lowers, uppers, row, when(event))
    if value == TIED:
        return count
    is_done[row] = 1
    if not _counted(own, value, parts, control):
        return count
    rows[count] = row
    return count + 1


def _sort(rows: Any, count: Any, is_done: Any) -> None:
    if count > FEW_VERDICTS:
        # The starts between the first and the last of them.
        first, last = rows[0], rows[0]
        for place in range(count):
            at = rows[place]
            first, last = min(first, at), max(last, at)
            is_done[at] = 2
        to = 0
        for at in range(first, last + 1):
            if is_done[at] == 2:
                is_done[at] = 1
                rows[to] = at
                to += 1
        return
    for place in range(1, count):
        at, to = rows[place], place
        while to > 0 and rows[to - 1] > at:
            rows[to] = rows[to - 1]
            to -= 1
        rows[to] = at


def _value(roots: Any, lowers: Any, uppers: Any, row: Any, now: Any) -> Any:
    """The verdict of a start by now; `TIED` if it has none."""
    if is_by(lowers, roots[0], row, now):
        return 1
    if is_by(uppers, roots[3], row, now):
        return 0
    is_unknown = is_by(lowers, roots[1], row, now) and is_by(uppers, roots[2], row, now)
    return -1 if is_unknown else TIED


def _counted(own: Any, value: Any, parts: Any, control: Any) -> Any:
    """Count a verdict; return whether it is reported."""
    parts[own, UNKNOWNS + 1 + value] += 1
    parts[own, OPEN] -= 1
    if value == 0 or control[REPORTS_ALL]:
        return True
    control[UNREPORTED_TRUE if value == 1 else UNREPORTED_UNKNOWN] += 1
    return False


def _write(
    own: Any, row: Any, decided: Any, witness: Any, value: Any, valid: Any, left: Any, control: Any,
    out: Any,
) -> None:  # fmt: skip
    at = control[EMITTED]
    control[EMITTED] += 1
    out[at, 0], out[at, 1], out[at, 2] = own, valid[row], valid[decided]
    out[at, 3] = valid[witness] if witness >= 0 else TIME_MIN
    out[at, 4], out[at, 5] = left[decided], value


def _report_margins(
    own: Any, nodes: Any, roots: Any, valid: Any, horizon: Any, left: Any, is_done: Any, count: Any,
    begin: Any, end: Any, base: Any, statuses: Any, margins: Any, parts: Any, scratch: Any,
    control: Any, out: Any, out_margins: Any,
) -> None:  # fmt: skip
    """Write the verdicts that `decide_by_margins` has found; that is in order of the deciding
    state, then of the start. ``statuses`` have the rows from ``begin`` on, up to ``end``."""
    rows = slice(0, end - begin)
    lowers = statuses[roots[0] >> 1, rows]
    uppers = statuses[roots[2] >> 1, rows]
    for row in range(count):
        decided, value = scratch[DECIDED, row], scratch[VALUES, row]
        if decided >= NEVER:
            continue
        is_done[row] = 1
        if value == TIED:
            value = _value(roots, lowers, uppers, row - begin, NEVER)
            value = -1 if value == TIED else value
        if not _counted(own, value, parts, control):
            continue
        found_at = -1
        if value >= 0:
            found_at = witness(
                nodes, roots[0] if value else roots[3], row - begin, valid[begin:end],
                horizon[begin:end], end - begin, base, statuses, rows,
                scratch[MOMENTS : MOMENTS + 2], scratch[HINT],
            )  # fmt: skip
            found_at += begin if found_at >= 0 else 0
        # Adding 0 makes 0 of -0.
        margin = margin_of(roots[0] if value == 1 else roots[2], row, margins) + 0.0
        out_margins[control[EMITTED], 6] = margin if value >= 0 else np.nan
        _write(own, row, decided, found_at, value, valid, left, control, out)


def _keep(
    nodes: Any, kinds: Any, part: Any, count: Any, statuses: Any, rows: Any, cursors: Any,
    scratch: Any, states: Any, words: Any, parts: Any,
) -> None:  # fmt: skip
    """Drop the states of a part that no verdict to come needs."""
    first = parts[part, FIRST]
    valid = states[VALID, first : first + count]
    # The last state stays: a horizon may follow, and past operators look back from it.
    is_open, oldest = parts[part, OPEN] > 0, parts[part, FIRST_OPEN]
    while oldest < count - 1 and not (is_open and not states[IS_DONE, first + oldest]):
        oldest += 1
    parts[part, FIRST_OPEN] = oldest
    parts[part, SETTLED] = valid[oldest] if is_open else valid[oldest] + 1
    # The first row that each node looks at from there on, the whole formula first.
    reached, is_kept, keep = scratch[0], scratch[1], oldest
    for node in range(len(nodes)):
        reached[node] = oldest
    for node in range(len(nodes) - 1, -1, -1):
        operation, row = nodes[node, OPERATION], reached[node]
        if operation == PREVIOUS:
            row = max(row - 1, 0)
        elif operation in (ONCE, SINCE) and not kinds[node] & REMEMBERED:
            row = back(valid, row, nodes[node, END])
        keep = min(keep, row)
        if operation not in (ATOM, TRUTH):
            left = nodes[node, LEFT_T] >> 1
            reached[left] = min(reached[left], row)
        if operation in (OR, UNTIL, SINCE):
            right = nodes[node, RIGHT_T] >> 1
            reached[right] = min(reached[right], row)
    # Of a past without end the first state that decides it is remembered: it stays before these.
    for row in range(keep):
        is_kept[row] = 0
    begin = keep
    for node in range(len(nodes)):
        if kinds[node] & REMEMBERED:
            row, operand = 0, nodes[node, LEFT_T]
            column = statuses[operand >> 1, rows]
            while row < keep and moment_of(column, operand, row) == NEVER:
                row += 1
            if row < keep and not is_kept[row]:
                is_kept[row] = 1
                begin -= 1
    if not begin:
        return
    _move_cursors(nodes, kinds, begin, cursors)
    parts[part, FIRST_OPEN] -= begin
    last_unknown = parts[part, LAST_UNKNOWN]
    last_unknown = last_unknown - begin if last_unknown >= keep else -1
    to = keep
    for row in range(keep - 1, -1, -1):
        if is_kept[row]:
            to -= 1
            for field in range(len(states)):
                states[field, first + to] = states[field, first + row]
            if last_unknown < 0 and _has_unknown(states, first + to, words):
                last_unknown = to - begin
    parts[part, LAST_UNKNOWN] = last_unknown
    parts[part, COUNT] = count - begin
    parts[part, FIRST] += begin


def _has_unknown(states: Any, place: Any, words: Any) -> Any:
    """Whether a state has an unknown atom."""
    found = 0
    for field in range(ATOMS, ATOMS + words):
        found |= states[field, place]
    return found & ANY_UNKNOWN != 0


def _move_cursors(nodes: Any, kinds: Any, begin: Any, cursors: Any) -> None:
    """The first ``begin`` rows go."""
    for node in range(len(nodes)):
        for cursor in range(CURSORS):
            row = cursors[node, cursor]
            # What a past without end has found stays before the others.
            is_found = row >= 0 and kinds[node] & REMEMBERED
            least = -1 if _is_last(nodes, node, cursor) and not is_found else 0
            cursors[node, cursor] = max(row - begin, least)


def _is_last(nodes: Any, node: Any, cursor: Any) -> Any:
    """Whether a cursor is the last row of a kind, or -1."""
    is_past = nodes[node, OPERATION] in (ONCE, SINCE)
    return cursor >= LAST_TRUE or (is_past and cursor == LAST_POSSIBLE)


def _add(
    own: Any, row: Any, end: Any, given: Any, margins: Any, times: Any, states: Any,
    state_margins: Any, parts: Any, is_single: Any,
) -> None:  # fmt: skip
    """Put new states of a part behind those that it has."""
    is_first = parts[own, SEEN] == 0
    place = parts[own, FIRST] + parts[own, COUNT]
    shift = place - row
    for new in range(row, end):
        states[VALID, shift + new], states[HORIZON, shift + new] = times[0, new], times[1, new]
        states[LEFT, shift + new] = times[2, new]
        may_start = given[len(given) - 1, new] and not is_single
        states[IS_DONE, shift + new] = 0 if may_start else 1
        parts[own, OPEN] += 1 if may_start else 0
    if is_single and is_first and given[len(given) - 1, row]:
        states[IS_DONE, place] = 0
        parts[own, OPEN] = 1
    for word in range(words_of(len(given) - 1)):
        for new in range(row, end):
            states[ATOMS + word, shift + new] = 0
    for atom in range(len(given) - 1):
        word, unknown = ATOMS + atom // IN_A_WORD, 0
        for new in range(row, end):
            states[word, shift + new] |= int(given[atom, new]) << 2 * (atom % IN_A_WORD)
            unknown |= given[atom, new]
        if unknown & UNKNOWN:
            last = end - 1
            while last > row and not given[atom, last] & UNKNOWN:
                last -= 1
            last += parts[own, COUNT] - row
            parts[own, LAST_UNKNOWN] = max(parts[own, LAST_UNKNOWN], last)
    for atom in range(len(margins)):
        for new in range(row, end):
            state_margins[len(states) - len(margins) + atom, shift + new] = margins[atom, new]
    parts[own, COUNT] += end - row
    parts[own, SEEN] += end - row


def _stop(control: Any, what: Any, needed: Any) -> None:
    control[STOPPED_FOR], control[NEEDED] = what, needed


def _has_room(
    own: Any, count: Any, states: Any, parts: Any, tables: Any, control: Any, out: Any
) -> Any:
    """Whether there is room to evaluate so many states of a part."""
    if count > tables.shape[1]:
        _stop(control, ROWS_WANTED, count)
        return False
    if control[EMITTED] + count > len(out):
        _stop(control, ROOM_WANTED, count)
        return False
    return _has_places(own, count, states, parts, control)


def _has_places(own: Any, count: Any, states: Any, parts: Any, control: Any) -> Any:
    """Let a part have places for so many states behind each other; whether there are any."""
    kept, first, place = parts[own, COUNT], parts[own, FIRST], parts[own, PLACE]
    if first + count <= place + parts[own, PLACES]:
        return True
    to = place
    if count > parts[own, PLACES] or kept > first - place:
        # It needs other ones; otherwise those that have become free before it.
        places = max(FEWEST, 3 * count)
        to = control[USED]
        if to + places > states.shape[1]:
            _stop(control, PLACES_WANTED, places)
            return False
        control[USED] += places
        parts[own, PLACE], parts[own, PLACES] = to, places
    for field in range(len(states)):
        for row in range(kept):
            states[field, to + row] = states[field, first + row]
    parts[own, FIRST] = to
    return True


def _begin(nodes: Any, cursors: Any) -> None:
    """Put the cursors of a part before its first state."""
    for node in range(len(nodes)):
        for cursor in range(CURSORS):
            cursors[node, cursor] = -1 if _is_last(nodes, node, cursor) else 0


def _parts_loop(
    nodes: Any, roots: Any, kinds: Any, given: Any, margins: Any, times: Any, part: Any, begin: Any,
    is_new: Any, states: Any, state_margins: Any, parts: Any, cursors: Any, tables: Any,
    table_margins: Any, scratch: Any, control: Any, out: Any, out_margins: Any,
) -> Any:  # fmt: skip
    """Take states from ``begin`` on; or, without ``is_new``, the horizon of the last state of each
    of these parts. Return the one before which it stopped, or their number."""
    _stop(control, NOTHING, 0)
    at, most_nodes, has_margins = begin, nodes.shape[1], control[HAS_MARGINS]
    words = words_of(len(given) - 1)
    found, hint = scratch[FOUND], scratch[HINT]
    while at < len(part):
        own = part[at]
        kept, end = parts[own, COUNT], at + 1
        most = max(control[AT_ONCE], 4 * kept)
        if is_new:
            most = min(most, control[LIMIT] - kept)
            if most < 1:
                _stop(control, IS_TOO_LONG, 0)
                return at
            while end < len(part) and end - at < most and part[end] == own:
                end += 1
        more = end - at if is_new else 0
        count = kept + more
        if not _has_room(own, count, states, parts, tables, control, out):
            return at
        first = parts[own, FIRST]
        if not kept:
            parts[own, FIRST_OPEN], parts[own, PROGRAM], parts[own, LAST_UNKNOWN] = 0, -1, -1
        if is_new:
            _add(
                own, at, end, given, margins, times, states, state_margins, parts,
                control[IS_SINGLE],
            )  # fmt: skip
        else:
            last = first + count - 1
            states[HORIZON, last] = max(states[HORIZON, last], times[1, at])
        program = 1 if parts[own, LAST_UNKNOWN] >= 0 else 0
        used, root, own_cursors = nodes[program, : roots[program, 4]], roots[program], cursors[own]
        mine = slice(first, first + count)
        valid, horizon, left = states[VALID, mine], states[HORIZON, mine], states[LEFT, mine]
        atoms, is_done = states[ATOMS : ATOMS + words, mine], states[IS_DONE, mine]
        base, row, stop = parts[own, SEEN] - count, kept, count
        if has_margins:
            statuses = tables[most_nodes : 2 * most_nodes]
            own_margins = table_margins[2 * most_nodes :]
            fill_margins(
                used, valid, atoms, state_margins[ATOMS + words :, mine], count, own_margins,
                scratch[MOMENTS:],
            )  # fmt: skip
            row, stop = decide_by_margins(
                root, is_done, valid, horizon, count, own_margins, control[REACH],
                control[LOOKS_BACK], control[REPORTS_ALL], scratch[DECIDED], scratch[VALUES],
            )  # fmt: skip
            base = 0 if row == base == 0 else 1
        else:
            statuses = states[ATOMS + words :]
            own_margins = table_margins
        if has_margins or parts[own, PROGRAM] != program:
            # From the first state on: of another program, or of none.
            _begin(used, own_cursors)
            parts[own, PROGRAM] = program
            row = row if has_margins else 0
        shift = row if has_margins else 0
        stop = max(stop, shift)
        rows = slice(0, stop - shift) if has_margins else mine
        seen = slice(shift, stop)
        step_valid, step_horizon, step_atoms = valid[seen], horizon[seen], atoms[:, seen]
        own_kinds, row, stop = kinds[program], row - shift, stop - shift
        fill(used, own_kinds, step_atoms, statuses, rows, row, stop, base, tables, found)
        progress(
            used, own_kinds, step_valid, step_horizon, statuses, rows, max(min(row, stop - 1), 0),
            stop, row < stop, base, own_cursors, tables, found,
        )  # fmt: skip
        hint[0] = -1
        if has_margins:
            _report_margins(
                own, used, root, valid, horizon, left, is_done, count, shift, shift + stop, base,
                statuses, own_margins, parts, scratch, control, out, out_margins,
            )  # fmt: skip
        else:
            _report(
                own, used, root, valid, horizon, left, is_done, count, base, statuses, rows,
                tables, found, parts, scratch, control, out,
            )  # fmt: skip
        _keep(
            used, own_kinds, own, count, statuses, rows, own_cursors, scratch, states, words, parts
        )
        at = end
    return at


def _move_loop(old: Any, new: Any, parts: Any) -> Any:
    """Copy the states of all parts to other places; return how many are in use."""
    to = 0
    for part in range(len(parts)):
        count, first = parts[part, COUNT], parts[part, FIRST]
        if not count:
            parts[part, PLACES] = 0
            continue
        for field in range(len(old)):
            for row in range(count):
                new[field, to + row] = old[field, first + row]
        places = max(FEWEST, 2 * count)
        parts[part, FIRST], parts[part, PLACE], parts[part, PLACES] = to, to, places
        to += places
    return to


def _types() -> tuple[Any, Any, Any]:
    from numba import types

    return types, types.int64[:, ::1], types.int64[::1]


def _parts_signature() -> Any:
    types, table, row = _types()
    number, floats = types.int64, types.float64[:, ::1]
    return number(
        types.int64[:, :, ::1], table, table, types.uint8[:, ::1], floats, table, row, number,
        number, table, floats, table, types.int64[:, :, ::1], table, floats, table, row, table,
        floats,
    )  # fmt: skip


def _move_signature() -> Any:
    types, table, _ = _types()
    return types.int64(table, table, table)


_CALLED: Final = (
    *SEARCHES, *PROGRESSION, *WITNESS, *MARGINS, words_of, _decided, _sort, _value, _counted,
    _write, _report, _report_margins, _has_unknown, _move_cursors, _is_last, _keep, _add, _stop,
    _has_places, _has_room, _begin,
)  # fmt: skip
_parts = Kernel(_parts_loop, _parts_signature, allocates=False, calls=_CALLED)
_move = Kernel(_move_loop, _move_signature, allocates=False)


def take(*arguments: Any, size: int) -> int:
    """Run the loop, as `_parts_loop` says. ``size``: as of `Kernel.run`."""
    return int(_parts.run(*arguments, size=size))


def move(*arguments: Any) -> int:
    """Copy states, as `_move_loop` says."""
    return int(_move.run(*arguments))
