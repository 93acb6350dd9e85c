"""The compiled loops that store the triples of windows for joins of patterns (`window_rows`).

A triple is a row of numbers: its *slot* (a predicate in a graph that the query names), the id of
its subject, its object as tag and bits (`relation.TermValues.encode`), its time and its window. A
row stays from the first evaluation whose window contains it to the last. It is linked to the
previous rows with the same slot, subject, object or triple. Such a chain goes from the newest row
to the oldest, so a search stops at the first expired row, and nothing is unlinked. Each loop is the
same in plain Python (``py_func``).

The hashes of a row are written out at each use, since compiled code can only call compiled code;
`join_kernel` has them too.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...streams.jit import Kernel

# The columns of a row that a join reads, in half a cache line: its slot with tag and state
# (`PLACE`), its subject, the bits of its object (low, high), and its predecessor in each chain.
PLACE, SUBJECT, LOW, HIGH, LINKS = 0, 1, 2, 3, 4
ROW = 8
BY_SLOT, BY_SUBJECT, BY_OBJECT, BY_TRIPLE = 0, 1, 2, 3
WAYS = 4
SLOT_MASK, TAG_SHIFT, TAG_MASK, STATE_SHIFT = 0xFFFF, 16, 0xFF, 24
SEEN_MASK = 0x7F00FFFF
"""Masks the slot and the visibility of a place."""
# Columns that only `select_rows` needs. ROOT: the row that represents all equal triples, COPIES:
# their number in the windows. DERIVED: the row follows from the sort of an annotation.
WINDOW, ROOT, COPIES, DERIVED = 0, 1, 2, 3

VISIBLE, GONE, COPY, COVERED = 0, 1, 2, 3
"""Visible to joins; expired; represented by an equal row (equal triples count once); represented by
a static triple, or by the classes of its sort."""

SORT_SLOT = SLOT_MASK
"""The slot of a row that states the sort of its subject, as a number."""

# Counters: rows, rows that have not expired, the first row that may be visible, visible rows that
# have expired but represent others, the first and the last pending row.
COUNT, KEPT, FLOOR, LASTING, FIRST_PENDING, LAST_PENDING, MARKS = 0, 1, 2, 3, 4, 5, 6

LOST = -2
"""The new position of a row that was removed."""

DONE, UNORDERED = 0, -1
"""The results of `select_rows`; otherwise the number of rows that need space."""


def _append_pending(
    # New rows, part by part (window, slot, kind, length); ``by`` orders them by time.
    parts: Any,
    subjects: Any,
    words: Any,
    times: Any,
    by: Any,
    # By term: its tag and bits (`relation.TermValues.encode`).
    term_tags: Any,
    term_bits: Any,
    pending: Any,
    pending_bits: Any,
    pending_times: Any,
    start: int,
) -> None:
    """Write new rows to the pending rows from ``start`` on."""
    part_of = np.empty(times.shape[0], np.int32)
    row = 0
    for p in range(parts.shape[0]):
        for _ in range(parts[p, 3]):
            part_of[row] = p
            row += 1
    for n in range(by.shape[0]):
        row = by[n]
        p = part_of[row]
        pending[start + n, 0] = parts[p, 0]
        pending[start + n, 1] = parts[p, 1]
        pending[start + n, 2] = subjects[row]
        tag, word = parts[p, 2], words[row]
        if tag == 0:
            tag, word = np.int64(term_tags[word]), term_bits[word]
        pending[start + n, 3] = tag
        pending_bits[start + n] = word
        pending_times[start + n] = times[row]


def _select_rows(
    # By window its bounds; by annotated sort the windows, slots and classes that it implies.
    lows: Any,
    highs: Any,
    sort_starts: Any,
    sort_windows: Any,
    sort_slots: Any,
    sort_classes: Any,
    # Rows that no evaluation has seen, in order of time: window, slot, subject, tag; bits; times.
    pending: Any,
    pending_bits: Any,
    pending_times: Any,
    # By slot: whether equal triples count once, which chains are needed (a bit each).
    once: Any,
    needed: Any,
    # The static rows and where their chains begin.
    static_rows: Any,
    static_heads: Any,
    static_sizes: Any,
    rows: Any,
    times: Any,
    details: Any,
    heads: Any,
    sizes: Any,
    # By slot: the number of visible rows, of all that ever were, the first that may be visible, the
    # expired ones that represent others. By window: the rows before have expired; and by slot: the
    # number of rows that have not.
    visible: Any,
    entered: Any,
    floors: Any,
    lasting: Any,
    swept: Any,
    inside: Any,
    marks: Any,
) -> int:
    """Expire rows at or below the low bound of their window; insert pending ones in its bounds."""
    slot_count = visible.shape[0]
    for w in range(swept.shape[0]):
        i = swept[w]
        while i < marks[COUNT]:
            if details[i, WINDOW] == w:
                # Rows of a window are in order of time, so the first that stays ends the sweep.
                if times[i] > lows[w]:
                    break
                state = rows[i, PLACE] >> STATE_SHIFT
                if state in (VISIBLE, COPY):
                    root = details[i, ROOT]
                    slot = rows[root, PLACE] & SLOT_MASK
                    inside[w, slot] -= 1
                    details[root, COPIES] -= 1
                    if state == COPY:
                        rows[i, PLACE] = GONE << STATE_SHIFT
                        marks[KEPT] -= 1
                    # The row has expired but equal rows have not, so it stays visible for them.
                    elif details[root, COPIES] > 0:
                        marks[LASTING] += 1
                        lasting[slot] += 1
                    if details[root, COPIES] == 0:
                        visible[slot] -= 1
                        rows[root, PLACE] = GONE << STATE_SHIFT
                        marks[KEPT] -= 1
                        if root != i:
                            marks[LASTING] -= 1
                            lasting[slot] -= 1
                elif state == COVERED:
                    rows[i, PLACE] = GONE << STATE_SHIFT
                    marks[KEPT] -= 1
            i += 1
        swept[w] = i
    first, stop = marks[FIRST_PENDING], marks[LAST_PENDING]
    top = highs[0]
    for w in range(1, highs.shape[0]):
        top = max(top, highs[w])
    # Check whether each slot's rows are in order of (time, window, tag), and count them.
    last_time = np.full(slot_count + 1, -9223372036854775807, np.int64)
    last_place = np.zeros(slot_count + 1, np.int64)
    wanted = np.int64(0)
    end = first
    while end < stop and pending_times[end] <= top:
        w, slot, time = pending[end, 0], pending[end, 1], pending_times[end]
        end += 1
        if time > highs[w] or time <= lows[w]:
            continue
        wanted += 1
        if slot == SORT_SLOT:
            sort = pending_bits[end - 1]
            wanted += sort_starts[sort + 1] - sort_starts[sort]
            slot = slot_count
        place = np.int64(w) * 256 + pending[end - 1, 3]
        # Solutions follow the order of rows, which must not depend on how rows came.
        if time < last_time[slot] or (time == last_time[slot] and place < last_place[slot]):
            return UNORDERED
        last_time[slot], last_place[slot] = time, place
    # Nothing has been inserted yet, so the caller can make room and call again.
    if marks[COUNT] + wanted > rows.shape[0]:
        return int(wanted)
    for at in range(first, end):
        w, time = pending[at, 0], pending_times[at]
        if time > highs[w] or time <= lows[w]:
            continue
        subject = pending[at, 2]
        part, last_part = np.int64(-1), np.int64(0)
        if pending[at, 1] == SORT_SLOT:
            part = sort_starts[pending_bits[at]] - 1
            last_part = sort_starts[pending_bits[at] + 1]
        base = part
        while part < last_part:
            # Insert the row itself first, then the facts that its sort implies.
            if part == base:
                slot, tag, word = pending[at, 1], pending[at, 3], pending_bits[at]
            else:
                if sort_windows[part] != w:
                    part += 1
                    continue
                slot, tag, word = sort_slots[part], 0, sort_classes[part]
            n = marks[COUNT]
            state, root = VISIBLE, n
            same = slot + (tag << TAG_SHIFT)
            low, high = ((word & 0xFFFFFFFF) ^ 0x80000000) - 0x80000000, word >> 32
            if slot == SORT_SLOT:
                state = COVERED
            elif once[slot]:
                mixed = ((word ^ high ^ (word >> 45)) & 0x7FFFFFFF) * 40503 + slot * 9973
                mixed = mixed + np.int64(subject) * 2246822519 + tag * 131
                mixed = mixed ^ (mixed >> 16)
                j = static_heads[
                    (mixed & (static_sizes[BY_TRIPLE] - 1)) + static_sizes[WAYS + BY_TRIPLE]
                ]
                while j >= 0:
                    if (
                        static_rows[j, SUBJECT] == subject
                        and static_rows[j, PLACE] == same
                        and static_rows[j, HIGH] == high
                        and static_rows[j, LOW] == low
                    ):
                        state = COVERED
                        break
                    j = static_rows[j, LINKS + BY_TRIPLE]
                if state == VISIBLE:
                    j = heads[(mixed & (sizes[BY_TRIPLE] - 1)) + sizes[WAYS + BY_TRIPLE]]
                    while j >= 0:
                        if (
                            rows[j, SUBJECT] == subject
                            and rows[j, PLACE] == same
                            and rows[j, HIGH] == high
                            and rows[j, LOW] == low
                        ):
                            state, root = COPY, j
                            break
                        j = rows[j, LINKS + BY_TRIPLE]
            rows[n, PLACE] = same + (state << STATE_SHIFT)
            rows[n, SUBJECT] = subject
            rows[n, LOW] = low
            rows[n, HIGH] = high
            times[n] = time
            details[n, WINDOW] = w
            details[n, ROOT] = root
            details[n, COPIES] = 0
            details[n, DERIVED] = 0 if part == base else 1
            details[root, COPIES] += 1
            marks[COUNT] = n + 1
            marks[KEPT] += 1
            part += 1
            if state in (VISIBLE, COPY):
                inside[w, slot] += 1
            if state != VISIBLE:
                continue
            visible[slot] += 1
            entered[slot] += 1
            key = np.int64(slot)
            if needed[slot] & 1:
                rows[n, LINKS + BY_SLOT] = heads[key + sizes[WAYS + BY_SLOT]]
                heads[key + sizes[WAYS + BY_SLOT]] = n
            if needed[slot] & 2:
                # The slots of a subject have neighbouring buckets, as do neighbouring ids.
                key = np.int64(subject)
                key = (key + (key >> 8)) * slot_count + slot
                bucket = (key & (sizes[BY_SUBJECT] - 1)) + sizes[WAYS + BY_SUBJECT]
                rows[n, LINKS + BY_SUBJECT] = heads[bucket]
                heads[bucket] = n
            if needed[slot] & 4:
                # Products stay below 63 bits, so that plain Python gives the same hash.
                mixed = ((word ^ high ^ (word >> 45)) & 0x7FFFFFFF) * 40503 + slot * 9973
                bucket = (mixed ^ (mixed >> 16)) & (sizes[BY_OBJECT] - 1)
                bucket += sizes[WAYS + BY_OBJECT]
                rows[n, LINKS + BY_OBJECT] = heads[bucket]
                heads[bucket] = n
            if needed[slot] & 8:
                mixed = ((word ^ high ^ (word >> 45)) & 0x7FFFFFFF) * 40503 + slot * 9973
                mixed = mixed + np.int64(subject) * 2246822519 + tag * 131
                bucket = (mixed ^ (mixed >> 16)) & (sizes[BY_TRIPLE] - 1)
                bucket += sizes[WAYS + BY_TRIPLE]
                rows[n, LINKS + BY_TRIPLE] = heads[bucket]
                heads[bucket] = n
    # Rows beyond the high bound of their window stay pending, before the others.
    free = end
    for at in range(end - 1, first - 1, -1):
        if pending_times[at] > highs[pending[at, 0]]:
            free -= 1
            for k in range(4):
                pending[free, k] = pending[at, k]
            pending_bits[free] = pending_bits[at]
            pending_times[free] = pending_times[at]
    marks[FIRST_PENDING] = free
    marks[FLOOR] = marks[COUNT]
    for slot in range(slot_count):
        floors[slot] = marks[COUNT]
        for w in range(swept.shape[0]):
            if inside[w, slot] > 0:
                floors[slot] = min(floors[slot], swept[w])
        # A row that stays for equal ones may be older than the sweep of any window.
        if lasting[slot] > 0:
            floors[slot] = 0
        marks[FLOOR] = min(marks[FLOOR], floors[slot])
    return DONE


def _pack(rows: Any, times: Any, details: Any, swept: Any, marks: Any, moved: Any) -> None:
    """Move the remaining rows together. ``moved`` receives the new position of each row, or `LOST`.
    They must be linked again."""
    count, kept = marks[COUNT], np.int64(0)
    for w in range(swept.shape[0]):
        before = np.int64(0)
        for i in range(swept[w]):
            if rows[i, PLACE] >> STATE_SHIFT != GONE:
                before += 1
        swept[w] = before
    for i in range(count):
        if rows[i, PLACE] >> STATE_SHIFT == GONE:
            moved[i] = LOST
            continue
        moved[i] = kept
        for k in range(LINKS):
            rows[kept, k] = rows[i, k]
        times[kept] = times[i]
        for k in range(4):
            details[kept, k] = details[i, k]
        kept += 1
    for n in range(kept):
        # A root stays as long as it stands for a row, so it has a new position.
        details[n, ROOT] = moved[details[n, ROOT]]
    marks[COUNT] = kept
    marks[FLOOR] = 0


def _link(rows: Any, needed: Any, heads: Any, sizes: Any, count: int) -> None:
    """Link all visible rows, oldest first; write the heads of the chains to ``heads``."""
    slot_count = needed.shape[0]
    heads[:] = -1
    for n in range(count):
        if rows[n, PLACE] >> STATE_SHIFT == VISIBLE:
            slot, tag = rows[n, PLACE] & SLOT_MASK, rows[n, PLACE] >> TAG_SHIFT
            subject, high = rows[n, SUBJECT], np.int64(rows[n, HIGH])
            word = (high << 32) | (np.int64(rows[n, LOW]) & 0xFFFFFFFF)
            key = np.int64(slot)
            if needed[slot] & 1:
                rows[n, LINKS + BY_SLOT] = heads[key + sizes[WAYS + BY_SLOT]]
                heads[key + sizes[WAYS + BY_SLOT]] = n
            if needed[slot] & 2:
                # The slots of a subject have neighbouring buckets, as do neighbouring ids.
                key = np.int64(subject)
                key = (key + (key >> 8)) * slot_count + slot
                bucket = (key & (sizes[BY_SUBJECT] - 1)) + sizes[WAYS + BY_SUBJECT]
                rows[n, LINKS + BY_SUBJECT] = heads[bucket]
                heads[bucket] = n
            if needed[slot] & 4:
                # Products stay below 63 bits, so that plain Python gives the same hash.
                mixed = ((word ^ high ^ (word >> 45)) & 0x7FFFFFFF) * 40503 + slot * 9973
                bucket = (mixed ^ (mixed >> 16)) & (sizes[BY_OBJECT] - 1)
                bucket += sizes[WAYS + BY_OBJECT]
                rows[n, LINKS + BY_OBJECT] = heads[bucket]
                heads[bucket] = n
            if needed[slot] & 8:
                mixed = ((word ^ high ^ (word >> 45)) & 0x7FFFFFFF) * 40503 + slot * 9973
                mixed = mixed + np.int64(subject) * 2246822519 + tag * 131
                bucket = (mixed ^ (mixed >> 16)) & (sizes[BY_TRIPLE] - 1)
                bucket += sizes[WAYS + BY_TRIPLE]
                rows[n, LINKS + BY_TRIPLE] = heads[bucket]
                heads[bucket] = n


def _select_rows_signature() -> Any:
    from numba import types

    int32s, int64s, int32_rows = types.int32[::1], types.int64[::1], types.int32[:, ::1]
    chains = (int32s, int64s)
    return types.int64(
        *(int64s,) * 6,
        int32_rows,
        int64s,
        int64s,
        types.boolean[::1],
        int64s,
        int32_rows,
        *chains,
        int32_rows,
        int64s,
        int32_rows,
        *chains,
        *(int64s,) * 5,
        types.int64[:, ::1],
        int64s,
    )


def _append_pending_signature() -> Any:
    from numba import types

    int64s, int32_rows = types.int64[::1], types.int32[:, ::1]
    return types.void(
        types.int64[:, ::1],
        types.int32[::1],
        *(int64s,) * 3,
        types.int8[::1],
        int64s,
        int32_rows,
        *(int64s,) * 2,
        types.int64,
    )


def _pack_signature() -> Any:
    from numba import types

    int64s, int32_rows = types.int64[::1], types.int32[:, ::1]
    return types.void(int32_rows, int64s, int32_rows, int64s, int64s, int64s)


def _link_signature() -> Any:
    from numba import types

    int32s, int64s = types.int32[::1], types.int64[::1]
    return types.void(types.int32[:, ::1], int64s, int32s, int64s, types.int64)


def chain_heads(
    rows: int, needed: NDArray[np.int64]
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Return empty chain heads for this number of rows, and by way the number of buckets and their
    start. A way has as many buckets as rows if any slot needs it."""
    some = int(np.bitwise_or.reduce(needed))
    buckets = 1 << max(3, rows).bit_length()
    ways = range(BY_SUBJECT, WAYS)
    sizes = [len(needed), *(buckets if some & (1 << way) else 1 for way in ways)]
    starts = np.cumsum([0, *sizes])
    heads = np.full(int(starts[-1]), -1, np.int32)
    return heads, np.array([*sizes, *starts[:-1]], np.int64)


append_pending = Kernel(_append_pending, _append_pending_signature)
select_rows = Kernel(_select_rows, _select_rows_signature)
pack = Kernel(_pack, _pack_signature)
link = Kernel(_link, _link_signature)
