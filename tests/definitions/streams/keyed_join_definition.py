"""join object by object straight from its definition, in plain Python integers.

Slow on purpose; shares nothing with the product. A stream is a list of (t_a, t_v, key) in order of
t_a, where the key None is no_value; a sample is named by its index in that list. One tuple an
object and instant, with the last sample of each input.
"""


def last_avail(stream, t, key=None):
    """The last sample with available time <= t, of those with ``key`` if there is one."""
    rows = [k for k, (a, _, own) in enumerate(stream) if a <= t and key in (None, own)]
    return max(rows, key=lambda k: (stream[k][0], k), default=None)


def keyed_join(streams, keyed):
    """[(t, valid, (sample of each))]."""
    if not any(keyed):
        objects = {None}
        bring = range(len(streams))
    else:
        bring = [i for i, each in enumerate(keyed) if each]
        objects = {key for i in bring for _, _, key in streams[i] if key is not None}
    moments = {}
    for i in bring:
        for t, _, key in streams[i]:
            if key in objects:
                moments.setdefault((t, key), i)  # inputs come in order: this is the first of them
    given = []
    for t, key in sorted(moments, key=lambda moment: (moment[0], moments[moment])):
        rows = [
            last_avail(stream, t, key if each else None)
            for stream, each in zip(streams, keyed, strict=True)
        ]
        if None in rows:
            continue
        valid = max(stream[k][1] for stream, k in zip(streams, rows, strict=True))
        given.append((t, valid, tuple(rows)))
    return given
