"""join and state synchronization straight from their definitions, in plain Python integers.

[DyKnow10 Def. 5.5, 5.6, 5.11], SPEC §1. Slow on purpose; shares nothing with the product. A stream
is a list of (t_a, t_v) in order of t_a; a sample is named by its index in that list, its sequence
number. Samples of one t_a are one instant; of these the one with the greatest number is the last.
"""

LEAST, GREATEST = -(2**63), 2**63 - 1


def last_avail(stream, t):
    """Def. 5.6: the sample with the greatest available time <= t, or None."""
    rows = [k for k, (a, _) in enumerate(stream) if a <= t]
    return max(rows, key=lambda k: (stream[k][0], k), default=None)


def most_recent_at(stream, t, tq):
    """Def. 5.6: of those available at tq and valid at most at t, the most recent, or None."""
    rows = [k for k, (a, v) in enumerate(stream) if a <= tq and v <= t]
    return max(rows, key=lambda k: (stream[k][1], stream[k][0], k), default=None)


def join(streams):
    """Def. 5.11: [(t, t, (sample of each or None))]."""
    times = sorted({a for stream in streams for a, _ in stream})
    return [(t, t, tuple(last_avail(stream, t) for stream in streams)) for t in times]


def synchronize(streams, promised, monotone, period, delay, start, end, exact):
    """SPEC §1: (states, told, incomplete) when all inputs have ended.

    States are (t_a, t_v, (sample of each or None)); told are {(t_a, input, sample, why)}.
    ``promised[i]`` is the time up to which input i told everything before its end.
    """
    told = set()
    inputs = []
    for i, stream in enumerate(streams):
        rows = []
        for k, (a, v) in enumerate(stream):
            if monotone[i] and any(stream[j][1] > v for j in rows):
                told.add((a, i, k, "order"))
            else:
                rows.append(k)
        inputs.append(rows)
    ends = [time + 1 for time in promised]
    end_of_all = max(ends)

    def satisfied(i, t, now):
        if ends[i] <= now and ends[i] < end_of_all:
            return True
        seen = [streams[i][k][1] for k in inputs[i] if streams[i][k][0] <= now]
        return any(v == t or (monotone[i] and v >= t) for v in seen)

    instants = sorted({streams[i][k][0] for i, rows in enumerate(inputs) for k in rows} | {*ends})

    def due(t):
        for now in instants:
            if all(satisfied(i, t, now) for i in range(len(streams))):
                moment = now
                break
        else:
            moment = None
        limits = [moment] if moment is not None else []
        if delay is not None:
            limits.append(min(t + delay, GREATEST))
        return min(limits, default=None)

    def state(t, leaves):
        values = []
        for i, rows in enumerate(inputs):
            own = [streams[i][k] for k in rows]
            k = most_recent_at(own, t, leaves)
            values.append(None if k is None or (exact and own[k][1] != t) else rows[k])
        return leaves, t, tuple(values)

    first = LEAST if start is None else start
    last = GREATEST if end is None else end
    states, incomplete = [], 0

    def leaves_at(t):
        c = due(t)
        if c is None:
            return None
        leaves = max(c, states[-1][0] + 1) if states else c
        return leaves if leaves <= GREATEST else None

    arrivals = [(streams[i][k][0], i, k, streams[i][k][1]) for i, r in enumerate(inputs) for k in r]
    if period is not None:
        never = []
        if arrivals:
            newest = [
                max((streams[i][k][1], streams[i][k][0]) for k in r)
                for i, r in enumerate(inputs)
                if r
            ]
            news = max(v for v, _ in newest), max(a for _, a in newest)
        if start is None and arrivals:
            a, least = min((a, v) for a, _, _, v in arrivals)
            if delay is not None:
                least = max(least, a - delay)
            start = -(-least // period) * period
        t = start
        blocked = False
        while t is not None and t <= last:
            leaves = None if blocked else leaves_at(t)
            blocked = leaves is None
            # After the end: to the end of the duration, or until the last news is in.
            if (blocked or leaves >= end_of_all) and end is None:
                if not arrivals:
                    break
                seen = states and states[-1][1] >= news[0] and states[-1][0] >= news[1]
                if seen or (never and never[-1] >= news[0]):
                    break
            if blocked:
                never.append(t)
                incomplete += 1
            else:
                states.append(state(t, leaves))
            t += period
        for a, i, k, v in arrivals:
            fitting = [s for s in states if (s[1] == v if exact else s[1] >= v)]
            if fitting and fitting[0][0] < a:
                over = delay is not None and a > fitting[0][1] + delay
                told.add((a, i, k, "max delay" if over else "available time"))
        return states, told, incomplete
    if delay is None and not all(monotone):
        due_at = {v: due(v) for _, _, _, v in arrivals if first <= v <= last}
        complete = [t for t, c in due_at.items() if c is not None]
        for t in sorted(complete, key=lambda t: (due_at[t], t)):
            leaves = leaves_at(t)
            if leaves is not None:
                states.append(state(t, leaves))
        gone = {t: leaves for leaves, t, _ in states}
        told |= {
            (a, i, k, "available time") for a, i, k, v in arrivals if v in gone and gone[v] < a
        }
        return states, told, len(due_at) - len(states)
    waiting = set()
    for now in [*sorted({a for a, *_ in arrivals}), None]:
        while waiting:
            t = min(waiting)
            leaves = leaves_at(t)
            if leaves is None or (now is not None and leaves >= now):
                break
            waiting.remove(t)
            states.append(state(t, leaves))
        for a, i, k, v in arrivals:
            if a != now:
                continue
            within = first <= v <= last
            if within and delay is not None and a > v + delay:
                told.add((a, i, k, "max delay"))
            elif states and v <= states[-1][1] and (within or not exact):
                told.add((a, i, k, "available time"))
            elif within:
                waiting.add(v)
    return states, told, len(waiting)
