"""Progression of a formula over the states of a part: each new state decides what it can, at the
starts that wait for it.

New states pass the nodes of the program, operands first. At each state a node looks at the rows
that its operands have decided there (*events*), and at the starts whose interval is over. So a
state costs what it decides, and some steps a node: not the states kept.

``statuses``  int64 (nodes, places): what each node has at ``rows``, a slice (`layout.status`).
              The *column* of a node is its part of these; ``mine``, ``lefts`` and ``rights`` are
              the columns of a node and its operands
``events``    int64 (nodes, rows): what each node has decided (`layout.event_of`), in order of
              the moment; ``found`` int64 (nodes,): their number
``cursors``   int64 (nodes, `CURSORS`): what a node knows of its rows
``begin``, ``stop``, ``is_new``: the new rows; without ``is_new`` one whose horizon has changed
``base``      the number of the first row among all states of the part; a row's is its moment

The file is long because each operator, of the future and of the past, has a function of its own.
"""

from __future__ import annotations

from typing import Any, Final

from ..programs import (
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
    UNTIL,
)
from ..time_searches import ahead, back, behind, is_later, is_near, is_over, reach
from ..windows import NEVER
from .layout import (
    CLOSED,
    HOLDS,
    IN_A_WORD,
    INTERVAL_END,
    LAST_FAILED,
    LAST_OPEN,
    LAST_POSSIBLE,
    LAST_TRUE,
    LOW,
    NEXT,
    OF_STATE,
    PENDING,
    RULED_OUT_FROM,
    RULED_OUT_TO,
    UNKNOWN,
    event_of,
    is_by,
    is_decided_by,
    makes,
    row_of,
    status,
    when,
)


def fill(
    nodes: Any, kinds: Any, atoms: Any, statuses: Any, rows: Any, begin: Any, stop: Any, base: Any,
    events: Any, found: Any,
) -> None:  # fmt: skip
    """Begin new rows: what nodes `OF_STATE` have there, and that the others wait."""
    for node in range(len(nodes)):
        operation = nodes[node, OPERATION]
        left, right = nodes[node, LEFT_T], nodes[node, RIGHT_T]
        found[node] = 0
        mine = statuses[node, rows]
        if not kinds[node] & OF_STATE:
            for row in range(begin, stop):
                mine[row] = PENDING
            continue
        if operation == ATOM:
            word, shift = nodes[node, NUMBER] // IN_A_WORD, 2 * (nodes[node, NUMBER] % IN_A_WORD)
            wanted = (HOLDS | UNKNOWN if nodes[node, IS_UPPER] else HOLDS) << shift
            for row in range(begin, stop):
                side = 0 if atoms[word, row] & wanted else 1
                mine[row] = status(base + row, side)
        elif operation == OR:
            lefts = statuses[left >> 1, rows]
            rights = statuses[right >> 1, rows]
            for row in range(begin, stop):
                side = (lefts[row] ^ left) & (rights[row] ^ right) & 1
                mine[row] = status(base + row, side)
        elif operation == SPREAD:
            lefts = statuses[left >> 1, rows]
            for row in range(begin, stop):
                side = (lefts[row] ^ left) & 1
                mine[row] = status(base + row, side)
        else:  # TRUTH
            for row in range(begin, stop):
                mine[row] = status(base + row, 0)
        for row in range(begin, stop):
            side = mine[row] & 1
            events[node, row - begin] = event_of(base + row, row, side)
        found[node] = max(stop - begin, 0)


def progress(
    nodes: Any, kinds: Any, valid: Any, horizon: Any, statuses: Any, rows: Any, begin: Any,
    stop: Any, is_new: Any, base: Any, cursors: Any, events: Any, found: Any,
) -> None:  # fmt: skip
    """Let each node decide what it can."""
    for node in range(len(nodes)):
        operation = nodes[node, OPERATION]
        if kinds[node] & OF_STATE:
            continue
        mine = statuses[node, rows]
        lefts = statuses[nodes[node, LEFT_T] >> 1, rows]
        rights = statuses[nodes[node, RIGHT_T] >> 1, rows]
        own = cursors[node]
        if operation == OR:
            _either(nodes, node, mine, lefts, rights, events, found)
        elif operation == EVENTUALLY:
            _eventually(
                nodes, node, valid, horizon, mine, lefts, begin, stop, base, own, events, found
            )
        elif operation == UNTIL:
            _until(
                nodes, node, valid, horizon, mine, lefts, rights, begin, stop, base, own, events,
                found,
            )  # fmt: skip
        elif operation in (ONCE, SINCE):
            _past(
                nodes, node, valid, mine, lefts, rights, begin, stop, is_new, base, own, events,
                found,
            )  # fmt: skip
        elif operation == PREVIOUS:
            _previous(nodes, node, mine, lefts, begin, stop, is_new, base, events, found)
        else:  # SPREAD
            _same(nodes, node, mine, events, found)


def _decide(mine: Any, node: Any, row: Any, now: Any, side: Any, events: Any, found: Any) -> None:
    mine[row] = status(now, side)
    events[node, found[node]] = event_of(now, row, side)
    found[node] += 1


def _next_events(node: Any, now: Any, event: Any, events: Any, found: Any) -> Any:
    """The number of the node's events by now, after those before ``event``."""
    while event < found[node] and when(events[node, event]) <= now:
        event += 1
    return event


def _either(
    nodes: Any, node: Any, mine: Any, lefts: Any, rights: Any, events: Any, found: Any
) -> None:
    left, right = nodes[node, LEFT_T], nodes[node, RIGHT_T]
    left_false, right_false = nodes[node, LEFT_F], nodes[node, RIGHT_F]
    a, b = left >> 1, right >> 1
    count, others = found[a], found[b]
    event = other = 0
    while event < count or other < others:
        # The earlier one.
        one = events[a, event] if event < count else NEVER
        another = events[b, other] if other < others else NEVER
        is_left = one <= another
        if is_left:
            event, is_true = event + 1, makes(one, left)
        else:
            one, other, is_true = another, other + 1, makes(another, right)
        at, now = row_of(one), when(one)
        if mine[at] != PENDING:
            continue
        if is_true:
            _decide(mine, node, at, now, 0, events, found)
        elif is_by(rights, right_false, at, now) if is_left else is_by(lefts, left_false, at, now):
            _decide(mine, node, at, now, 1, events, found)


def _same(nodes: Any, node: Any, mine: Any, events: Any, found: Any) -> None:
    true = nodes[node, LEFT_T]
    changed = true >> 1
    for event in range(found[changed]):
        one = events[changed, event]
        side = 0 if makes(one, true) else 1
        _decide(mine, node, row_of(one), when(one), side, events, found)


def _previous(
    nodes: Any, node: Any, mine: Any, lefts: Any, begin: Any, stop: Any, is_new: Any, base: Any,
    events: Any, found: Any,
) -> None:  # fmt: skip
    true = nodes[node, LEFT_T]
    changed, event = true >> 1, 0
    for row in range(begin, stop):
        now = base + row
        if is_new and now == 0:
            _decide(mine, node, row, now, 1, events, found)
        until = _next_events(changed, now, event, events, found)
        # The row before may be decided since long, or just now.
        if is_new and row > 0 and is_decided_by(lefts, row - 1, now):
            side = (lefts[row - 1] ^ true) & 1
            _decide(mine, node, row, now, side, events, found)
        while event < until:
            at = row_of(events[changed, event]) + 1
            if at <= row and mine[at] == PENDING:
                _decide(mine, node, at, now, (lefts[at - 1] ^ true) & 1, events, found)
            event += 1


def _lowest(mine: Any, row: Any, low: Any) -> Any:
    """The first start from ``low`` on that may wait; the row after the last one if none does."""
    while low <= row and mine[low] != PENDING:
        low += 1
    return low


def _eventually(
    nodes: Any, node: Any, valid: Any, horizon: Any, mine: Any, operand: Any, begin: Any, stop: Any,
    base: Any, own: Any, events: Any, found: Any,
) -> None:  # fmt: skip
    true, false = nodes[node, LEFT_T], nodes[node, LEFT_F]
    start, end = nodes[node, START], nodes[node, END]
    changed, event = true >> 1, 0
    low, closed, next = own[LOW], own[CLOSED], own[NEXT]
    for row in range(begin, stop):
        now = base + row
        until = _next_events(changed, now, event, events, found)
        low = _lowest(mine, row, low)
        first, done = 0, -1
        for each_event in range(event, until):
            at = row_of(events[changed, each_event])
            if at < low or not makes(events[changed, each_event], true):
                continue
            last = behind(valid, at, start) - 1
            lowest = low if is_near(valid, low, at, end) else back(valid, at, end)
            # Starts from ``first`` to ``done`` are decided.
            if lowest < first:
                done = -1
            first = lowest
            for each in range(max(lowest, done + 1), last + 1):
                if mine[each] == PENDING:
                    _decide(mine, node, each, now, 0, events, found)
            done = max(done, last)
        low, closed, next = _close(
            nodes, node, changed, false, valid, horizon, mine, operand, row, now, low, closed, next,
            event, until, events, found,
        )  # fmt: skip
        event = until
    own[LOW], own[CLOSED], own[NEXT] = low, closed, next


def _close(
    nodes: Any, node: Any, changed: Any, false: Any, valid: Any, horizon: Any, mine: Any,
    operand: Any, row: Any, now: Any, low: Any, before: Any, next: Any, event: Any, until: Any,
    events: Any, found: Any,
) -> tuple[Any, Any, Any]:  # fmt: skip
    """Decide the starts whose interval is over, with an operand that is false at all of it.
    ``low``, ``before`` and ``next``: the node's cursors; the new ones are returned. ``event`` and
    ``until``: the operand's events of now."""
    start, end = nodes[node, START], nodes[node, END]
    closed = before
    while closed <= row and is_over(valid, closed, end, horizon[row]):
        closed += 1
    if low < closed:
        low = _lowest(mine, row, low)
    if low >= closed:
        return low, closed, next
    next = max(next, ahead(valid, low, start, row + 1))
    while next <= row and is_by(operand, false, next, now):
        next += 1
    for each in range(max(before, low), closed):
        if mine[each] != PENDING:
            continue
        open, first = next, ahead(valid, each, start, row + 1)
        if first > open:
            open = first
            while (
                open <= row and is_near(valid, each, open, end) and is_by(operand, false, open, now)
            ):
                open += 1
        if open > row or not is_near(valid, each, open, end):
            _decide(mine, node, each, now, 1, events, found)
    if low >= before:
        return low, closed, next
    done_from, done_to = 0, 0
    for each_event in range(event, until):
        at = row_of(events[changed, each_event])
        if at < low or not makes(events[changed, each_event], false) or done_from <= at < done_to:
            continue
        # The run of false rows around it, and the starts whose interval is in it.
        lowest, after = low, next
        done_from = 0
        if at > next:
            open, after = at - 1, at + 1
            while is_by(operand, false, open, now):
                open -= 1
            while after <= row and is_by(operand, false, after, now):
                after += 1
            done_from, lowest = open + 1, max(low, behind(valid, open, start))
        done_to = after
        for each in range(lowest, min(behind(valid, after - 1, start), before)):
            if mine[each] == PENDING:
                if after <= row and is_near(valid, each, after, end):
                    break
                _decide(mine, node, each, now, 1, events, found)
    return low, closed, next


def _until(
    nodes: Any, node: Any, valid: Any, horizon: Any, mine: Any, lefts: Any, rights: Any, begin: Any,
    stop: Any, base: Any, own: Any, events: Any, found: Any,
) -> None:  # fmt: skip
    start, end = nodes[node, START], nodes[node, END]
    left, left_false = nodes[node, LEFT_T], nodes[node, LEFT_F]
    right, right_false = nodes[node, RIGHT_T], nodes[node, RIGHT_F]
    left_changed, right_changed = left >> 1, right >> 1
    event, other = 0, 0
    low, closed, next = own[LOW], own[CLOSED], own[NEXT]
    for row in range(begin, stop):
        now = base + row
        until = _next_events(left_changed, now, event, events, found)
        other_until = _next_events(right_changed, now, other, events, found)
        low = _lowest(mine, row, low)
        # The right part holds: the starts before it, as far back as the left part does.
        for each_event in range(other, other_until):
            at = row_of(events[right_changed, each_event])
            if at < low or not makes(events[right_changed, each_event], right):
                continue
            lowest = low if is_near(valid, low, at, end) else back(valid, at, end)
            open = at - 1
            while open >= lowest and is_by(lefts, left, open, now):
                open -= 1
            for each in range(max(lowest, open + 1), behind(valid, at, start)):
                if mine[each] == PENDING:
                    _decide(mine, node, each, now, 0, events, found)
            low = _lowest(mine, row, low)
        for each_event in range(event, until):
            at = row_of(events[left_changed, each_event])
            if makes(events[left_changed, each_event], left_false):
                own[LAST_FAILED] = max(own[LAST_FAILED], at)
                if at >= low:
                    _left_fails(nodes, node, valid, mine, rights, at, low, now, events, found)
            elif low <= at < row:
                _left_holds(
                    nodes, node, valid, mine, lefts, rights, at, row, low, now, events, found
                )
        # The right part fails: then the left one may have failed before the right one could hold.
        if own[LAST_FAILED] >= low:
            done_from, done_to = 0, 0
            for each_event in range(other, other_until):
                at = row_of(events[right_changed, each_event])
                if at < low or not makes(events[right_changed, each_event], right_false):
                    continue
                if not done_from <= at < done_to:
                    done_from, done_to = _right_fails(
                        nodes, node, valid, mine, lefts, rights, at, row, low, now, own, events,
                        found,
                    )  # fmt: skip
        low, closed, next = _close(
            nodes, node, right_changed, right_false, valid, horizon, mine, rights, row, now, low,
            closed, next, other, other_until, events, found,
        )  # fmt: skip
        event, other = until, other_until
    own[LOW], own[CLOSED], own[NEXT] = low, closed, next


def _left_fails(
    nodes: Any, node: Any, valid: Any, mine: Any, rights: Any, at: Any, low: Any, now: Any,
    events: Any, found: Any,
) -> None:  # fmt: skip
    """The left part of `until` fails: so do the starts before which the right one cannot hold."""
    end, right_false = nodes[node, END], nodes[node, RIGHT_F]
    lowest = low if is_near(valid, low, at, end) else back(valid, at, end)
    open = at
    while open >= lowest and is_by(rights, right_false, open, now):
        open -= 1
    if open >= lowest:
        lowest = max(lowest, behind(valid, open, nodes[node, START]))
    for each in range(lowest, at + 1):
        if mine[each] == PENDING:
            _decide(mine, node, each, now, 1, events, found)


def _left_holds(
    nodes: Any, node: Any, valid: Any, mine: Any, lefts: Any, rights: Any, at: Any, row: Any,
    low: Any, now: Any, events: Any, found: Any,
) -> None:  # fmt: skip
    """The left part of `until` is known to hold at an earlier row: the right one may hold after it,
    for the starts from which on the left one holds."""
    start, end = nodes[node, START], nodes[node, END]
    left, right = nodes[node, LEFT_T], nodes[node, RIGHT_T]
    # The left part holds from ``at`` up to ``reached``.
    reached = at + 1
    while reached <= row and not is_by(rights, right, reached, now):
        if not is_by(lefts, left, reached, now):
            return
        reached += 1
    lowest = at
    while lowest > low and is_by(lefts, left, lowest - 1, now):
        lowest -= 1
    for each in range(lowest, at + 1):
        if mine[each] != PENDING:
            continue
        first = ahead(valid, each, start, row + 1)
        while reached <= row and (reached < first or not is_by(rights, right, reached, now)):
            if not is_by(lefts, left, reached, now):
                return
            reached += 1
        if reached > row:
            return
        if is_near(valid, each, reached, end):
            _decide(mine, node, each, now, 0, events, found)


def _right_fails(
    nodes: Any, node: Any, valid: Any, mine: Any, lefts: Any, rights: Any, at: Any, row: Any,
    low: Any, now: Any, own: Any, events: Any, found: Any,
) -> tuple[Any, Any]:  # fmt: skip
    """The right part of `until` is known to fail: so do the starts after which the left one fails,
    before the right one can hold. Return the rows around it at which the right part fails: the
    first, and the one after the last."""
    start, end = nodes[node, START], nodes[node, END]
    left_false, right_false = nodes[node, LEFT_F], nodes[node, RIGHT_F]
    open, after = at - 1, at + 1
    while open >= low and is_by(rights, right_false, open, now):
        open -= 1
    while after <= row and is_by(rights, right_false, after, now):
        after += 1
    failed = min(after - 1, own[LAST_FAILED])
    while failed >= low and not is_by(lefts, left_false, failed, now):
        failed -= 1
    lowest = low if open < low else max(low, behind(valid, open, start))
    for each in range(lowest, min(behind(valid, after - 1, start) - 1, failed) + 1):
        if mine[each] == PENDING and is_near(valid, each, failed, end):
            _decide(mine, node, each, now, 1, events, found)
    return open + 1, after


def _past(
    nodes: Any, node: Any, valid: Any, mine: Any, lefts: Any, rights: Any, begin: Any, stop: Any,
    is_new: Any, base: Any, own: Any, events: Any, found: Any,
) -> None:  # fmt: skip
    has_left = nodes[node, OPERATION] == SINCE
    left, left_false = nodes[node, LEFT_T], nodes[node, LEFT_F]
    # `once` has its operand at the left.
    right, right_false = left, left_false
    if has_left:
        right, right_false = nodes[node, RIGHT_T], nodes[node, RIGHT_F]
    else:
        rights = lefts
    left_changed, right_changed = left >> 1, right >> 1
    event, other = 0, 0
    for row in range(begin, stop):
        now = base + row
        other_until = _next_events(right_changed, now, other, events, found)
        # The first of the earlier rows that are decided just now.
        earliest = row
        for each_event in range(other, other_until):
            at = row_of(events[right_changed, each_event])
            earliest = min(earliest, at)
            if at < own[INTERVAL_END] and makes(events[right_changed, each_event], right):
                own[LAST_TRUE] = max(own[LAST_TRUE], at)
        if has_left:
            until = _next_events(left_changed, now, event, events, found)
            for each_event in range(event, until):
                at = row_of(events[left_changed, each_event])
                earliest = min(earliest, at)
                if makes(events[left_changed, each_event], left_false):
                    own[LAST_FAILED] = max(own[LAST_FAILED], at)
            event = until
        if is_new:
            _new_past(
                nodes, node, valid, mine, lefts, rights, row, now, own, has_left, right,
                right_false, events, found,
            )  # fmt: skip
        if earliest < row or not is_new:
            low = own[LOW] = _lowest(mine, row, own[LOW])
            if has_left:
                for each in range(max(low, earliest), row + 1):
                    if mine[each] == PENDING:
                        _late_since(
                            nodes, node, valid, mine, lefts, rights, each, now, events, found
                        )
            else:
                _late_once(
                    nodes, node, valid, mine, lefts, row, low, now, own, other, other_until, events,
                    found,
                )  # fmt: skip
        other = other_until


def _new_past(
    nodes: Any, node: Any, valid: Any, mine: Any, lefts: Any, rights: Any, row: Any, now: Any,
    own: Any, has_left: Any, right: Any, right_false: Any, events: Any, found: Any,
) -> None:  # fmt: skip
    """Decide a new start, if its past does."""
    start, end, last = nodes[node, START], nodes[node, END], own[INTERVAL_END]
    while last <= row and is_later(valid, last, row, start):
        if is_by(rights, right, last, now):
            own[LAST_TRUE] = last
        if not is_by(rights, right_false, last, now):
            own[LAST_POSSIBLE] = last
        last += 1
    own[INTERVAL_END] = last
    true, possible, open, failed = own[LAST_TRUE], own[LAST_POSSIBLE], -1, -1
    while possible >= 0 and is_near(valid, possible, row, end):
        if not is_by(rights, right_false, possible, now):
            break
        possible -= 1
    own[LAST_POSSIBLE] = possible
    if has_left:
        left, open, failed = nodes[node, LEFT_T], own[LAST_OPEN], own[LAST_FAILED]
        if not is_by(lefts, left, row, now):
            open = row
        while open >= 0 and is_near(valid, open, row, end) and is_by(lefts, left, open, now):
            open -= 1
        own[LAST_OPEN] = open
    if true >= max(open, 0) and is_near(valid, true, row, end):
        _decide(mine, node, row, now, 0, events, found)
    elif possible < max(failed, 0) or not is_near(valid, possible, row, end):
        _decide(mine, node, row, now, 1, events, found)


def _late_once(
    nodes: Any, node: Any, valid: Any, mine: Any, operand: Any, row: Any, low: Any, now: Any,
    own: Any, event: Any, until: Any, events: Any, found: Any,
) -> None:  # fmt: skip
    """Decide the starts that wait, by the operand's events of now."""
    true, false = nodes[node, LEFT_T], nodes[node, LEFT_F]
    start, end = nodes[node, START], nodes[node, END]
    for each_event in range(event, until):
        one = events[true >> 1, each_event]
        at = row_of(one)
        if makes(one, true):
            first, last = ahead(valid, at, start, row + 1), reach(valid, at, end, row + 1)
            for each in range(max(low, first), last):
                if mine[each] == PENDING:
                    _decide(mine, node, each, now, 0, events, found)
    for each_event in range(event, until):
        one = events[true >> 1, each_event]
        at = row_of(one)
        if makes(one, true) or own[RULED_OUT_FROM] <= at < own[RULED_OUT_TO]:
            continue
        # The run of false rows around it, and the starts whose interval is in it.
        open, after = at - 1, at + 1
        while open >= 0 and is_by(operand, false, open, now):
            open = own[RULED_OUT_FROM] if open == own[RULED_OUT_TO] - 1 else open
            open -= 1
        while after <= row and is_by(operand, false, after, now):
            after += 1
        own[RULED_OUT_FROM], own[RULED_OUT_TO] = open + 1, after
        first = low if open < 0 else max(low, reach(valid, open, end, row + 1))
        last = row + 1 if after > row else ahead(valid, after, start, row + 1)
        for each in range(first, last):
            if mine[each] == PENDING:
                _decide(mine, node, each, now, 1, events, found)


def _late_since(
    nodes: Any, node: Any, valid: Any, mine: Any, lefts: Any, rights: Any, row: Any, now: Any,
    events: Any, found: Any,
) -> None:  # fmt: skip
    """Decide a start that waits, if its past does by now: from the newest row back."""
    first = back(valid, row, nodes[node, END])
    last = behind(valid, row, nodes[node, START])
    holds, has_failed, is_possible = True, False, False
    at = row
    while at >= first and (holds or not (is_possible or has_failed)):
        if at < last:
            if holds and is_by(rights, nodes[node, RIGHT_T], at, now):
                _decide(mine, node, row, now, 0, events, found)
                return
            is_possible = is_possible or not is_by(rights, nodes[node, RIGHT_F], at, now)
        holds = holds and is_by(lefts, nodes[node, LEFT_T], at, now)
        has_failed = has_failed or is_by(lefts, nodes[node, LEFT_F], at, now)
        at -= 1
    if not is_possible:
        _decide(mine, node, row, now, 1, events, found)


PROGRESSION: Final = (
    event_of, row_of, when, makes, status, is_by, is_decided_by, _decide, _next_events, _either,
    _same, _previous, _lowest, _eventually, _close, _until, _left_fails, _left_holds, _right_fails,
    _past, _new_past, _late_once, _late_since, fill, progress,
)  # fmt: skip
"""For `Kernel`, which compiles them into the loop that calls `fill` and `progress`."""
