"""Verdicts of a formula over the states of parts, each by itself: a compiled loop over the nodes of
a program (`sliced_program`), with moments as `windows` has them.

``nodes``    int64 (programs, nodes, fields): the program of one reading, and of both
``roots``    int64 (programs, 5): the tables of the whole formula: true and false in the lower
             reading, then in the upper one; and the number of nodes
``remembered``  int64 (programs, nodes): whether a node is one of a past without end of which it
             needs the first state alone that decides it (`formulas.is_remembered`)
``given``    uint8 (atoms + 1, n): of each new state `HOLDS` or `UNKNOWN` for each atom; last
             whether it may start
``margins``  float64 (atoms, n): with robustness, by how much each atom holds (`robustness`)
``times``    int64 (3, n): of each new state its valid time, its horizon, and when it left
``part``     int64 (n,): the part of each new state, in order
``states``   int64 (fields, places): the states kept; those of a part are one after the other. The
             fields of margins are floats
``parts``    int64 (parts, fields): where these are
``tables``   int64 (tables, rows): moments, two tables a node; with robustness then margins, which
             are floats, one a node and two. ``scratch`` int64 (8, rows)
``control``  int64: numbers, at the places below
``out``      int64 (n, 7): verdicts: the part, the valid times of the start, of the deciding state
             and of the witness, when the deciding state left, the value, and the margin, a float
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from ...streams.jit import Kernel
from ...streams.time import TIME_MAX, TIME_MIN
from .sliced_program import (
    ATOM,
    END,
    EVENTUALLY,
    IS_UPPER,
    LEFT_F,
    LEFT_T,
    NUMBER,
    ONCE,
    OPERATION,
    OR,
    PREVIOUS,
    RIGHT_F,
    RIGHT_T,
    SINCE,
    SPREAD,
    START,
    TRUTH,
    UNTIL,
)
from .sliced_times import SEARCHES, ahead, back, behind, is_later, is_near, is_over, reach
from .windows import (
    NEVER,
    deciding_state,
    least_in_queue,
    since_in_column,
    since_of_margins_in_column,
    until_in_column,
    until_of_margins_in_column,
)

HOLDS, UNKNOWN = 1, 2
TIED: Final = 2
"""In place of a value: moments say which it is."""
IN_A_WORD: Final = 31
"""The atoms in a word, two bits each."""
ANY_UNKNOWN: Final = sum(UNKNOWN << 2 * atom for atom in range(IN_A_WORD))
# The fields of a state: its valid time, horizon, when it left, whether its verdict is out, and from
# there on words of atoms; with robustness then the margin of each atom.
VALID, HORIZON, LEFT, IS_DONE, ATOMS = range(5)
# The fields of a part: its first place in ``states``, its states there, the places that it has; how
# many states it had by now, how many of those kept are without a verdict, the valid time before
# which each start has one; the verdicts by now.
FIRST, COUNT, PLACES, SEEN, OPEN, SETTLED, UNKNOWNS, FALSES, TRUES = range(9)
PART_FIELDS: Final = 9
# Whether each part has one start only; the verdicts in ``out`` may be violations alone; the most
# rows taken at once, and the most states of a part; the first table of margins, or 0; how far the
# formula reaches, and whether it looks back. Then what the loop says: places of ``states`` in use,
# verdicts in ``out``, true and unknown ones that are not, and what it stopped for, with the number
# that is needed.
IS_SINGLE, REPORTS_ALL, AT_ONCE, LIMIT, MARGIN_TABLES, REACH, LOOKS_BACK = range(7)
USED, EMITTED, UNREPORTED_TRUE, UNREPORTED_UNKNOWN, STOPPED_FOR, NEEDED = range(7, 13)
CONTROLS: Final = 13
NOTHING, PLACES_WANTED, ROWS_WANTED, ROOM_WANTED, IS_TOO_LONG = range(5)
"""What the loop may stop for: places in ``states``, rows of ``tables``, room in ``out``; a part has
too many states."""
FEWEST: Final = 8
"""The places of a part with few states."""
SIDES: Final = 2
"""The tables of a node: when it is true, and when it is false."""
# The rows of ``scratch``: those of `_evaluate` and `_fill_margins`; then of each state when it is
# decided (`NEVER`: it has no new verdict) and as what; for `_emit`.
FIRST_ROWS, LAST_ROWS, CLOSED, QUEUE, DECIDED, VALUES, PLACE, HINT = range(8)
SCRATCH: Final = 8


def words_of(atoms: int) -> int:
    """The words for so many atoms."""
    return (atoms + IN_A_WORD - 1) // IN_A_WORD


def _bounds(
    valid: Any, count: Any, is_past: Any, start: Any, end: Any, first: Any, last: Any
) -> None:
    """Write the rows in the interval of each row: the first, and the one after the last."""
    low = high = 0
    for row in range(count):
        if is_past:
            while low < row and not is_near(valid, low, row, end):
                low += 1
            while high <= row and is_later(valid, high, row, start):
                high += 1
        else:
            low, high = max(low, row), max(high, row)
            while low < count and not is_later(valid, row, low, start):
                low += 1
            while high < count and is_near(valid, row, high, end):
                high += 1
        first[row], last[row] = low, high


def _over(valid: Any, horizon: Any, count: Any, end: Any, closed: Any) -> None:
    """Write from which row on no later state is valid up to ``end`` after each row."""
    place = 0
    for row in range(count):
        place = max(place, row)
        while place < count and not is_over(valid, row, end, horizon[place]):
            place += 1
        closed[row] = place if place < count else NEVER


def _evaluate(
    nodes: Any, valid: Any, horizon: Any, atoms: Any, count: Any, is_whole: Any, tables: Any,
    scratch: Any,
) -> None:  # fmt: skip
    """Fill the tables of all nodes."""
    first, last, closed, queue = (
        scratch[FIRST_ROWS],
        scratch[LAST_ROWS],
        scratch[CLOSED],
        scratch[QUEUE],
    )
    columns = tables.T
    for node in range(len(nodes)):
        operation, start, end = nodes[node, OPERATION], nodes[node, START], nodes[node, END]
        true, false = SIDES * node, SIDES * node + 1
        left_t, left_f = nodes[node, LEFT_T], nodes[node, LEFT_F]
        right_t, right_f = nodes[node, RIGHT_T], nodes[node, RIGHT_F]
        if operation == ATOM:
            word, shift = nodes[node, NUMBER] // IN_A_WORD, 2 * (nodes[node, NUMBER] % IN_A_WORD)
            wanted = HOLDS | UNKNOWN if nodes[node, IS_UPPER] else HOLDS
            for row in range(count):
                holds = (atoms[word, row] >> shift) & wanted != 0
                tables[true, row] = row if holds else NEVER
                tables[false, row] = NEVER if holds else row
        elif operation == TRUTH:
            for row in range(count):
                tables[true, row], tables[false, row] = row, NEVER
        elif operation == OR:
            for row in range(count):
                tables[true, row] = min(tables[left_t, row], tables[right_t, row])
                tables[false, row] = max(tables[left_f, row], tables[right_f, row])
        elif operation == SPREAD:
            for row in range(count):
                tables[true, row], tables[false, row] = tables[left_t, row], tables[left_f, row]
        elif operation == PREVIOUS:
            for row in range(count - 1, 0, -1):
                tables[true, row] = max(tables[left_t, row - 1], row)
                tables[false, row] = max(tables[left_f, row - 1], row)
            tables[true, 0], tables[false, 0] = NEVER, 0 if is_whole else NEVER
        else:
            is_past = operation in (ONCE, SINCE)
            _bounds(valid, count, is_past, start, end, first, last)
            if not is_past:
                _over(valid, horizon, count, end, closed)
            if operation == UNTIL:
                until_in_column(
                    columns, left_t, columns, left_f, columns, right_t, columns, right_f, count,
                    first, last, closed, columns, true, columns, false,
                )  # fmt: skip
            elif operation == SINCE:
                since_in_column(
                    columns, left_t, columns, left_f, columns, right_t, columns, right_f, count,
                    first, last, columns, true, columns, false,
                )  # fmt: skip
            else:
                for side in range(SIDES):
                    operand = nodes[node, LEFT_T + side]
                    sign = 1 - 2 * side
                    least_in_queue(
                        columns, operand, count, first, last, queue, columns, true + side, sign,
                        NEVER,
                    )  # fmt: skip
                # What is known of a start is not known before it; a future interval ends at it or
                # later.
                for row in range(count):
                    tables[true, row] = max(tables[true, row], row)
                    at = row if is_past else closed[row]
                    tables[false, row] = max(tables[false, row], at)


def _interval(nodes: Any, node: Any, row: Any, valid: Any, count: Any) -> tuple[Any, Any]:
    """The rows in the interval of one row: the first, and the one after the last."""
    start, end = nodes[node, START], nodes[node, END]
    if nodes[node, OPERATION] in (ONCE, SINCE):
        return back(valid, row, end), behind(valid, row, start)
    return ahead(valid, row, start, count), reach(valid, row, end, count)


def _witness_of_until(
    nodes: Any, node: Any, is_true: Any, row: Any, valid: Any, horizon: Any, count: Any, tables: Any
) -> Any:
    """The row of the right part, or that at which the left one fails."""
    first, last = _interval(nodes, node, row, valid, count)
    is_past, closed = nodes[node, OPERATION] == SINCE, -1
    if not is_past:
        closed = row
        while closed < count and not is_over(valid, row, nodes[node, END], horizon[closed]):
            closed += 1
        # The end of all streams comes after the last state, and so after what fails there.
        if closed == count or (closed == count - 1 and horizon[closed] == TIME_MAX):
            closed = NEVER
    side = 0 if is_true else 1
    left, right = nodes[node, LEFT_T + side], nodes[node, RIGHT_T + side]
    return deciding_state(
        tables.T, tables.T, left, right, row, first, last, closed, is_true, is_past
    )


def _witness(
    nodes: Any, table: Any, row: Any, valid: Any, horizon: Any, count: Any, tables: Any, hint: Any
) -> Any:
    """The row of the witness of what a table has at a row, or -1; see `witness.Witnesses`."""
    while True:
        node, side = table // SIDES, table % SIDES
        operation = nodes[node, OPERATION]
        left, right = nodes[node, LEFT_T + side], nodes[node, RIGHT_T + side]
        if operation in (ATOM, TRUTH):
            return row
        if operation == OR:
            a, b = tables[left, row], tables[right, row]
            is_left = a >= b if side else a <= b
            table = left if is_left else right
        elif operation == SPREAD:
            table = left
        elif operation == PREVIOUS:
            if row == 0:
                return -1
            table, row = left, row - 1
        elif operation in (UNTIL, SINCE):
            return _witness_of_until(nodes, node, side == 0, row, valid, horizon, count, tables)
        else:
            if side:
                return -1
            return _first_by(nodes, node, row, valid, count, tables, hint)


def _first_by(
    nodes: Any, node: Any, row: Any, valid: Any, count: Any, tables: Any, hint: Any
) -> Any:
    """The first row in an interval at which the operand is known to hold when the node is, or -1.
    ``hint``: the node, row and moment of the last such question, and the row that was found."""
    operand, by = nodes[node, LEFT_T], tables[SIDES * node, row]
    other, last = _interval(nodes, node, row, valid, count)
    # Starts that one state decides come together: it is the first one for each of them.
    if hint[0] == node and hint[1] <= row and by <= hint[2]:
        other = max(other, hint[3])
    while other < last and tables[operand, other] > by:
        other += 1
    found = other if other < last else -1
    hint[0], hint[1], hint[2], hint[3] = node, row, by, found
    return found


def _decide_by_moments(roots: Any, is_done: Any, count: Any, tables: Any, scratch: Any) -> None:
    """Write when the states that have no verdict yet are decided, and as what."""
    true, false = tables[roots[0]], tables[roots[3]]
    other_false, other_true = tables[roots[1]], tables[roots[2]]
    for row in range(count):
        moment = min(true[row], false[row])
        if roots[0] != roots[2]:
            moment = min(moment, max(other_false[row], other_true[row]))
        scratch[DECIDED, row] = NEVER if is_done[row] else moment
        value = 1 if true[row] <= moment else 0 if false[row] <= moment else -1
        scratch[VALUES, row] = value


def _fill_margins(
    nodes: Any, valid: Any, atoms: Any, margins: Any, count: Any, tables: Any, scratch: Any
) -> None:
    """Fill the tables of margins, one a node, that of a negated operand being the opposite."""
    first, last, queue = scratch[FIRST_ROWS], scratch[LAST_ROWS], scratch[QUEUE]
    columns = tables.T
    for node in range(len(nodes)):
        operation, start, end = nodes[node, OPERATION], nodes[node, START], nodes[node, END]
        left, right = nodes[node, LEFT_T] // SIDES, nodes[node, RIGHT_T] // SIDES
        sign = 1 - 2 * (nodes[node, LEFT_T] % SIDES)
        other = 1 - 2 * (nodes[node, RIGHT_T] % SIDES)
        if operation == ATOM:
            number = nodes[node, NUMBER]
            word, shift = number // IN_A_WORD, 2 * (number % IN_A_WORD)
            unknown = np.inf if nodes[node, IS_UPPER] else -np.inf
            for row in range(count):
                is_known = (atoms[word, row] >> shift) & UNKNOWN == 0
                tables[node, row] = margins[number, row] if is_known else unknown
        elif operation == TRUTH:
            for row in range(count):
                tables[node, row] = np.inf
        elif operation == OR:
            for row in range(count):
                tables[node, row] = max(sign * tables[left, row], other * tables[right, row])
        elif operation == SPREAD:
            for row in range(count):
                tables[node, row] = sign * tables[left, row]
        elif operation == PREVIOUS:
            for row in range(count - 1, 0, -1):
                tables[node, row] = sign * tables[left, row - 1]
            tables[node, 0] = -np.inf
        else:
            _bounds(valid, count, operation in (ONCE, SINCE), start, end, first, last)
            if operation in (EVENTUALLY, ONCE):
                # The greatest of the opposite is the opposite of the least.
                least_in_queue(
                    columns, left, count, first, last, queue, columns, node, -sign, np.inf
                )
                for row in range(count):
                    tables[node, row] *= sign
                continue
            # Without the signs, in the two tables after those of nodes.
            a, b = len(tables) - 2, len(tables) - 1
            for row in range(count):
                tables[a, row] = sign * tables[left, row]
                tables[b, row] = other * tables[right, row]
            if operation == SINCE:
                since_of_margins_in_column(
                    columns, a, columns, b, count, first, last, columns, node
                )
            else:
                until_of_margins_in_column(
                    columns, a, columns, b, count, first, last, columns, node
                )


def _decide_by_margins(
    roots: Any, is_done: Any, valid: Any, horizon: Any, count: Any, tables: Any, scratch: Any,
    control: Any,
) -> tuple[Any, Any]:  # fmt: skip
    """As `_decide_by_moments`: once its interval is over, a verdict is the sign of its margin, or
    `TIED`. Return the rows of which moments are needed for that, or for a witness: the first, and
    the one after the last."""
    _over(valid, horizon, count, control[REACH], scratch[CLOSED])
    low_row, high_row = count, 0
    for row in range(count):
        closed = scratch[CLOSED, row]
        scratch[DECIDED, row] = NEVER if is_done[row] else closed
        if is_done[row] or closed >= NEVER:
            continue
        low, high = _margin(roots[0], row, tables), _margin(roots[2], row, tables)
        value = 1 if low > 0 else 0 if high < 0 else -1
        if low == 0 or high == 0:
            value = TIED
        scratch[VALUES, row] = value
        if value == TIED or value == 0 or (value == 1 and control[REPORTS_ALL]):
            low_row, high_row = min(low_row, row), max(high_row, closed + 1)
    return 0 if control[LOOKS_BACK] else low_row, high_row


def _margin(table: Any, row: Any, tables: Any) -> Any:
    """The margin of a node, or the opposite, at a row."""
    return tables[table // SIDES, row] * (1 - 2 * (table % SIDES))


def _break_ties(roots: Any, begin: Any, end: Any, tables: Any, scratch: Any) -> None:
    """A margin of 0 does not tell `>` from `>=`: moments do."""
    for row in range(begin, end):
        if scratch[DECIDED, row] < NEVER and scratch[VALUES, row] == TIED:
            is_true = tables[roots[0], row - begin] < NEVER
            is_false = tables[roots[3], row - begin] < NEVER
            scratch[VALUES, row] = 1 if is_true else 0 if is_false else -1


def _emit(
    own: Any, nodes: Any, roots: Any, valid: Any, horizon: Any, left: Any, is_done: Any,
    count: Any, begin: Any, end: Any, parts: Any, tables: Any, margins: Any, scratch: Any,
    control: Any, out: Any, out_margins: Any,
) -> None:  # fmt: skip
    """Count the verdicts that are new; write those to report, in order of the deciding state, then
    of the start. ``tables`` have the rows from ``begin`` on, up to ``end``."""
    decided, values, place = scratch[DECIDED], scratch[VALUES], scratch[PLACE]
    hint = scratch[HINT]
    hint[0] = -1
    for row in range(count):
        place[row] = 0
    for row in range(count):
        if decided[row] >= NEVER:
            continue
        is_done[row] = 1
        parts[own, UNKNOWNS + 1 + values[row]] += 1
        if values[row] == 0 or control[REPORTS_ALL]:
            place[decided[row]] += 1
            continue
        decided[row] = NEVER
        if values[row] == 1:
            control[UNREPORTED_TRUE] += 1
        else:
            control[UNREPORTED_UNKNOWN] += 1
    at = control[EMITTED]
    for row in range(count):
        number = place[row]
        place[row] = at
        at += number
    control[EMITTED] = at
    for row in range(count):
        moment = decided[row]
        if moment >= NEVER:
            continue
        at = place[moment]
        place[moment] += 1
        value, witness = values[row], -1
        if value >= 0:
            root = roots[0] if value else roots[3]
            witness = begin + _witness(
                nodes, root, row - begin, valid[begin:end], horizon[begin:end], end - begin, tables,
                hint,
            )  # fmt: skip
        out[at, 0], out[at, 1], out[at, 2] = own, valid[row], valid[moment]
        out[at, 3] = valid[witness] if witness >= begin else TIME_MIN
        out[at, 4], out[at, 5] = left[moment], value
        if control[MARGIN_TABLES]:
            # Adding 0 makes 0 of -0.
            margin = _margin(roots[0] if value == 1 else roots[2], row, margins) + 0.0
            out_margins[at, 6] = margin if value >= 0 else np.nan


def _keep(
    nodes: Any, remembered: Any, part: Any, count: Any, tables: Any, scratch: Any, states: Any,
    parts: Any,
) -> None:  # fmt: skip
    """Drop the states of a part that no verdict to come needs."""
    first = parts[part, FIRST]
    valid = states[VALID, first : first + count]
    # The last state stays: a horizon may follow, and past operators look back from it.
    oldest, is_open = count - 1, 0
    for row in range(count - 1, -1, -1):
        if not states[IS_DONE, first + row]:
            oldest = row
            is_open += 1
    parts[part, OPEN] = is_open
    parts[part, SETTLED] = valid[oldest] if is_open else valid[oldest] + 1
    # The first row that each node looks at from there on, the whole formula first.
    reached, is_kept, keep = scratch[0], scratch[1], oldest
    for node in range(len(nodes)):
        reached[node] = oldest
    for node in range(len(nodes) - 1, -1, -1):
        operation, row = nodes[node, OPERATION], reached[node]
        if operation == PREVIOUS:
            row = max(row - 1, 0)
        elif operation in (ONCE, SINCE) and not remembered[node]:
            row = back(valid, row, nodes[node, END])
        keep = min(keep, row)
        if operation not in (ATOM, TRUTH):
            left = nodes[node, LEFT_T] // SIDES
            reached[left] = min(reached[left], row)
        if operation in (OR, UNTIL, SINCE):
            right = nodes[node, RIGHT_T] // SIDES
            reached[right] = min(reached[right], row)
    # Of a past without end the first state that decides it is remembered: it stays before these.
    for row in range(keep):
        is_kept[row] = 0
    for node in range(len(nodes)):
        if remembered[node]:
            row = 0
            while row < keep and tables[nodes[node, LEFT_T], row] >= NEVER:
                row += 1
            if row < keep:
                is_kept[row] = 1
    begin = keep
    for row in range(keep - 1, -1, -1):
        if is_kept[row]:
            begin -= 1
            for field in range(len(states)):
                states[field, first + begin] = states[field, first + row]
    parts[part, COUNT] = count - begin
    if count - begin > begin:
        parts[part, FIRST] += begin
        parts[part, PLACES] -= begin
        return
    # Moved to the front, fewer than those that go: then the part needs no other places.
    for field in range(len(states)):
        for row in range(count - begin):
            states[field, first + row] = states[field, first + begin + row]


def _add(
    row: Any, end: Any, given: Any, margins: Any, times: Any, states: Any, state_margins: Any,
    place: Any, is_first: Any, is_single: Any,
) -> None:  # fmt: skip
    """Put new states of a part into places."""
    for new in range(row, end):
        states[VALID, place], states[HORIZON, place] = times[0, new], times[1, new]
        states[LEFT, place] = times[2, new]
        for field in range(ATOMS, len(states)):
            states[field, place] = 0
        for atom in range(len(given) - 1):
            bits = int(given[atom, new]) << 2 * (atom % IN_A_WORD)
            states[ATOMS + atom // IN_A_WORD, place] |= bits
        for atom in range(len(margins)):
            state_margins[len(states) - len(margins) + atom, place] = margins[atom, new]
        may_start = given[len(given) - 1, new] and (is_first or not is_single)
        states[IS_DONE, place] = 0 if may_start else 1
        is_first = False
        place += 1


def _stop(control: Any, what: Any, needed: Any) -> None:
    control[STOPPED_FOR], control[NEEDED] = what, needed


def _parts_loop(
    nodes: Any, roots: Any, remembered: Any, given: Any, margins: Any, times: Any, part: Any,
    begin: Any, is_new: Any, states: Any, state_margins: Any, parts: Any, tables: Any,
    table_margins: Any, scratch: Any, control: Any, out: Any, out_margins: Any,
) -> Any:  # fmt: skip
    """Take states from ``begin`` on; or, without ``is_new``, the horizon of the last state of each
    of these parts. Return the one before which it stopped, or their number."""
    _stop(control, NOTHING, 0)
    at = begin
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
        if count > tables.shape[1]:
            _stop(control, ROWS_WANTED, count)
            return at
        if control[EMITTED] + count > len(out):
            _stop(control, ROOM_WANTED, count)
            return at
        if count > parts[own, PLACES]:
            places = max(FEWEST, 2 * count)
            to = control[USED]
            if to + places > states.shape[1]:
                _stop(control, PLACES_WANTED, places)
                return at
            control[USED] += places
            for field in range(len(states)):
                for row in range(kept):
                    states[field, to + row] = states[field, parts[own, FIRST] + row]
            parts[own, FIRST], parts[own, PLACES] = to, places
        first = parts[own, FIRST]
        if is_new:
            is_first = parts[own, SEEN] == 0
            _add(
                at, end, given, margins, times, states, state_margins, first + kept, is_first,
                control[IS_SINGLE],
            )  # fmt: skip
            parts[own, COUNT] = count
            parts[own, SEEN] += more
        else:
            last = first + count - 1
            states[HORIZON, last] = max(states[HORIZON, last], times[1, at])
        words, unknown = (len(given) + IN_A_WORD - 2) // IN_A_WORD, 0
        for field in range(ATOMS, ATOMS + words):
            for row in range(count):
                unknown |= states[field, first + row]
        program = 1 if unknown & ANY_UNKNOWN else 0
        mine = slice(first, first + count)
        valid, horizon, left = states[VALID, mine], states[HORIZON, mine], states[LEFT, mine]
        used = nodes[program, : roots[program, 4]]
        atoms, is_done = states[ATOMS : ATOMS + words, mine], states[IS_DONE, mine]
        is_whole, mine_margins = parts[own, SEEN] == count, table_margins[control[MARGIN_TABLES] :]
        begin_row, end_row = 0, count
        if control[MARGIN_TABLES]:
            _fill_margins(
                used, valid, atoms, state_margins[ATOMS + words :, mine], count, mine_margins,
                scratch,
            )  # fmt: skip
            begin_row, end_row = _decide_by_margins(
                roots[program], is_done, valid, horizon, count, mine_margins, scratch, control
            )
        if begin_row < end_row:
            rows = slice(begin_row, end_row)
            _evaluate(
                used, valid[rows], horizon[rows], atoms[:, rows], end_row - begin_row,
                is_whole and begin_row == 0, tables, scratch,
            )  # fmt: skip
        if control[MARGIN_TABLES]:
            _break_ties(roots[program], begin_row, end_row, tables, scratch)
        else:
            _decide_by_moments(roots[program], is_done, count, tables, scratch)
        _emit(
            own, used, roots[program], valid, horizon, left, is_done, count, begin_row, end_row,
            parts, tables, mine_margins, scratch, control, out, out_margins,
        )  # fmt: skip
        _keep(used, remembered[program], own, count, tables, scratch, states, parts)
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
        parts[part, FIRST], parts[part, PLACES] = to, places
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
        number, table, floats, table, table, floats, table, row, table, floats,
    )  # fmt: skip


def _move_signature() -> Any:
    types, table, _ = _types()
    return types.int64(table, table, table)


_CALLED: Final = (
    *SEARCHES, least_in_queue, until_in_column, since_in_column, until_of_margins_in_column,
    since_of_margins_in_column, deciding_state, _bounds, _over, _evaluate, _interval,
    _witness_of_until, _witness, _first_by, _decide_by_moments, _margin, _fill_margins,
    _decide_by_margins, _break_ties, _emit, _keep, _add, _stop,
)  # fmt: skip
_parts = Kernel(_parts_loop, _parts_signature, allocates=False, calls=_CALLED)
_move = Kernel(_move_loop, _move_signature, allocates=False)


def take(*arguments: Any, size: int) -> int:
    """Run the loop, as `_parts_loop` says. ``size``: as of `Kernel.run`."""
    return int(_parts.run(*arguments, size=size))


def move(*arguments: Any) -> int:
    """Copy states, as `_move_loop` says."""
    return int(_move.run(*arguments))
