"""Sets of objects and the streams made of theirs, straight from [DyKnow10 Def. 4.6, 4.7].

A set stream is [(available time, labels)] in order.
"""


def held(sets, time):
    """The set that is known at ``time``."""
    found = [labels for at, labels in sets if at <= time]
    return found[-1] if found else ()


def lives(label, sets):
    """The lives of an object: (first moment, first moment after it or None)."""
    found, begun = [], None
    for at, labels in sets:
        if label in labels:
            begun = at if begun is None else begun
        elif begun is not None:
            found.append((begun, at))
            begun = None
    return found if begun is None else [*found, (begun, None)]


def within(life, times):
    """Those of ``times`` that are in a life."""
    return [t for t in times if t >= life[0] and (life[1] is None or t < life[1])]


def merged(samples):
    """(available, valid, label, value) of (time, label, value): by time, then by label, then in the
    order of each stream."""
    ordered = sorted(samples, key=lambda sample: sample[:2])
    return [(time, time, label, value) for time, label, value in ordered]
