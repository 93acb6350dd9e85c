"""Streams made of streams made of streams against the composition of their definitions, whatever
is published or ended first ([DyKnow10 Def. 5.10, 5.11, 5.33-5.35], SPEC §1)."""

from typing import NamedTuple

import joint_definition as definition
from hypothesis import given, settings
from hypothesis import strategies as st
from playing import play

from dyknow.engine.processes.registry import Processes

LIMITS = settings(deadline=None, max_examples=150)
NEVER = -(2**63) - 1
SOURCES = ("a", "b", "c")
PROCESSES = Processes()


class Made(NamedTuple):
    """A stream by its definition: rows are (available, valid, values), ``known`` is up to when it
    told everything before its end, ``width`` how many values a sample has."""

    rows: list[tuple[int, int, tuple[float | None, ...]]]
    known: int
    width: int

    @property
    def times(self):
        return [row[:2] for row in self.rows]


def mixed(n, a, b):
    """What the unit Mix gives for its n-th tuple."""
    if a is None or n % 4 == 0:
        return None
    return a * 10 + (0 if b is None else b) + n / 1000


@PROCESSES.computational_unit("float", ["float", "float"])
def Mix(time, samples, state):
    n = (state or 0) + 1
    return mixed(n, *(None if sample is None else sample.value for sample in samples)), n


# -- definitions ---------------------------------------------------------------------------------


def monotone(made):
    """``with monotone order``: samples whose valid time decreases are left out."""
    rows = []
    for row in made.rows:
        if not rows or row[1] >= rows[-1][1]:
            rows.append(row)
    return Made(rows, made.known, made.width)


def picked(inputs, chosen):
    values = []
    for made, k in zip(inputs, chosen, strict=True):
        values += [None] * made.width if k is None else made.rows[k][2]
    return tuple(values)


def made_of(inputs, rows):
    known = max([made.known for made in inputs] + [row[0] for row in rows])
    return Made(rows, known, sum(made.width for made in inputs))


def join(inputs):
    tuples = definition.join([made.times for made in inputs])
    return made_of(inputs, [(t, v, picked(inputs, chosen)) for t, v, chosen in tuples])


def mix(inputs):
    rows = []
    for n, (t, _, chosen) in enumerate(definition.join([made.times for made in inputs]), 1):
        samples = [None if k is None else m.rows[k] for m, k in zip(inputs, chosen, strict=True)]
        value = mixed(n, *(None if s is None else s[2][0] for s in samples))
        if value is not None:
            rows.append((t, max(s[1] for s in samples if s is not None), (value,)))
    return made_of(inputs, rows)._replace(width=1)


def sync(inputs, strict, period, delay, exact):
    states, _, _ = definition.synchronize(
        [made.times for made in inputs],
        [made.known for made in inputs],
        strict,
        period,
        delay,
        None,
        None,
        exact,
    )
    return made_of(inputs, [(t, v, picked(inputs, chosen)) for t, v, chosen in states])


# -- networks ------------------------------------------------------------------------------------


@st.composite
def networks(draw):
    """(what each source says, KPL of the network, each label's stream by its definition)."""
    made, lines = {}, []
    for source in SOURCES:
        available = sorted(draw(st.sets(st.integers(0, 12), max_size=5)))
        rows = [(t, draw(st.integers(0, 12)), (float(draw(st.integers(0, 3))),)) for t in available]
        made[source] = Made(rows, available[-1] if available else NEVER, 1)
    said = {source: made[source].rows for source in SOURCES}
    floats = list(SOURCES)
    for label in ("k", "l", "m", "n")[: draw(st.integers(1, 4))]:
        kind = draw(st.sampled_from(["join", "sync", "mix"]))
        labels = st.sampled_from(floats if kind == "mix" else list(made))
        terms, inputs, strict = [], [], []
        for _ in range(2):
            name, is_monotone = draw(labels), draw(st.booleans())
            terms.append(f"s_{name}" + " with monotone order" * is_monotone)
            inputs.append(monotone(made[name]) if is_monotone else made[name])
            strict.append(is_monotone)
        written = ", ".join(terms)
        match kind:
            case "join":
                made[label] = join(inputs)
            case "mix":
                made[label] = mix(inputs)
                floats.append(label)
            case "sync":
                period = draw(st.none() | st.integers(1, 4))
                delay = draw(st.none() | st.integers(0, 5))
                exact = draw(st.booleans())
                made[label] = sync(inputs, strict, period, delay, exact)
                written += "; any change" if period is None else f"; sample every {period}"
                written += "" if delay is None else f", max delay {delay}"
                written += "" if exact else ", use most recent"
        lines.append(f"strmgen s_{label} = {'Mix' if kind == 'mix' else kind}({written})")
    return said, "\n".join(lines), made


@LIMITS
@given(st.data(), networks())
def test_networks_are_the_composition_of_their_definitions(data, network):
    said, text, made = network
    rows = {name: [(t, v, {"value": x}) for t, v, (x,) in made] for name, made in said.items()}
    sources = "compunit float Mix(float, float)\n" + "\n".join(
        f"source float {name}\nstrmgen s_{name} = {name}" for name in SOURCES
    )
    engine = play(data.draw, PROCESSES, sources, "unit ns\n" + text, rows)
    for label, expected in made.items():
        rows = engine.generator(f"s_{label}").stream.all().rows()
        assert [(t, v, tuple(values.values())) for t, v, values in rows] == expected.rows, label
