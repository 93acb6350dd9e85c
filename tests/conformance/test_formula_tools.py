"""RTAMT and Reelay evaluate the same formulas over samples at 1 Hz, and say the same.

These tools do not know that a recording has an end. So starts are compared whose intervals the
recording has whole.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from random import Random

import numpy as np
import pytest

from dyknow.engine.engine import Engine
from dyknow.languages.mtl import check_mtl, parse_monitor
from dyknow.reasoning.mtl.evaluator import MonitorEvaluator
from dyknow.reasoning.states.states import States, Values
from dyknow.streams.time import SECOND

VOCABULARY = Engine(epoch="tools").ontology.vocabulary
RULE = "always [0s, 10s] (speed(uav1) > 100 -> eventually [0s, 5s] speed(uav1) < 90)"
REACH = 15


def speeds(count: int, seed: int = 7) -> np.ndarray:
    """A walk around 95 km/h."""
    steps = np.random.default_rng(seed).normal(0, 6, count)
    found, speed = np.empty(count), 95.0
    for i, step in enumerate(steps):
        speed += step + (95 - speed) * 0.1
        found[i] = speed
    return found


def evaluated(formula: str, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Whether the formula is true at each second, and its robustness; in batches of states."""
    text = f"monitor m = {formula} with robustness"
    evaluator = MonitorEvaluator(check_mtl(parse_monitor(text), text, VOCABULARY))
    (term,) = evaluator.terms
    true, robustness = np.zeros(len(values), np.int8), np.empty(len(values))
    parts = []
    for first in range(0, len(values), 1_000):
        part = values[first : first + 1_000]
        valid = SECOND * np.arange(first, first + len(part), dtype=np.int64)
        known = Values(part, np.ones(len(part), np.bool_))
        parts.append(evaluator.push(States(valid, valid, {}, {}, {term: known})))
    for found in (*parts, evaluator.end()):
        start = found.start_time // SECOND
        true[start] = found.value
        robustness[start] = found.robustness
    assert set(true.tolist()) <= {0, 1}
    return true.astype(bool), robustness


def verdicts(formula: str, values: np.ndarray) -> np.ndarray:
    return evaluated(formula, values)[0]


def by_rtamt(formula: str, values: np.ndarray, *, online: bool = False) -> np.ndarray:
    """The robustness at each second."""
    rtamt = pytest.importorskip("rtamt", reason="rtamt is not installed (pip install rtamt)")
    specification = rtamt.StlDiscreteTimeSpecification()
    specification.declare_var("speed", "float")
    specification.declare_var("out", "float")
    specification.spec = f"out = {formula}"
    specification.parse()
    if online:
        specification.pastify()
        rows = enumerate(values.tolist())
        return np.array([specification.update(i, [("speed", value)]) for i, value in rows])
    told = specification.evaluate({"time": list(range(len(values))), "speed": values.tolist()})
    return np.array([robustness for _, robustness in told])


def by_reelay(formula: str, values: np.ndarray) -> np.ndarray:
    reelay = pytest.importorskip("reelay", reason="reelay is not installed (pip install reelay)")
    monitor = reelay.discrete_timed_monitor(pattern=formula, semantics="boolean", condense=False)
    return np.array([monitor.update({"speed": value})["value"] for value in values.tolist()])


def test_violations_of_100_000_samples_by_rtamt() -> None:
    values = speeds(100_000)
    told = by_rtamt("always[0,10]((speed>100) -> (eventually[0,5](speed<90)))", values)
    own, robustness = evaluated(RULE, values)
    whole = slice(None, -REACH)
    assert np.count_nonzero(~own[whole]) == 56_376
    assert np.array_equal(own[whole], told[whole] > 0)
    assert np.array_equal(robustness[whole], told[whole])


def test_violations_of_100_000_samples_by_reelay() -> None:
    """Reelay knows the past: the rule, fifteen seconds later."""
    values = speeds(100_000)
    past = "historically[0:10]((once[5:5]{speed > 100}) -> (once[0:5]{speed < 90}))"
    told = by_reelay(past, values)
    assert np.array_equal(verdicts(RULE, values)[:-REACH], told[REACH:])


def test_rtamt_online_says_it_as_late_as_its_reach() -> None:
    """Its online monitors refuse `->`, and shift the formula into the past."""
    values = speeds(5_000)
    text = "always[0,10]((not(speed>100)) or (eventually[0,5](speed<90)))"
    told = by_rtamt(text, values, online=True)
    assert np.array_equal(evaluated(RULE, values)[1][:-REACH], told[REACH:])


# -- random formulas -------------------------------------------------------------------------


@dataclass(frozen=True)
class Drawn:
    """A formula in three languages; of no meaning in one if its text is empty. ``ahead`` and
    ``back``: seconds that it looks from a start."""

    own: str
    rtamt: str
    reelay: str
    ahead: int
    back: int


def atom(draw: Random) -> Drawn:
    limit, sign = draw.choice([88, 93, 97, 102]) + 0.5, draw.choice("<>")
    return Drawn(
        f"speed(uav1) {sign} {limit}",
        f"(speed {sign} {limit})",
        f"{{speed {sign} {limit}}}",
        0,
        0,
    )


def interval(draw: Random) -> tuple[int, int]:
    # Reelay 25 takes [0:0] for an interval without an end.
    low = draw.choice([0, 0, 1, 3])
    return low, max(1, low + draw.choice([0, 1, 2, 5]))


def one(draw: Random, depth: int, *, past: bool) -> Drawn:
    a = formula(draw, depth - 1, past=past)
    low, high = interval(draw)
    match draw.choice(["not", "past", "past", *([] if past else ["future", "future"])]):
        case "not":
            return Drawn(f"not ({a.own})", f"(not {a.rtamt})", f"(not {a.reelay})", a.ahead, a.back)
        case "past":
            word = draw.choice(["once", "historically"])
            return Drawn(
                f"{word} [{low}s, {high}s] ({a.own})",
                f"({word}[{low},{high}] {a.rtamt})",
                f"({word}[{low}:{high}] {a.reelay})",
                a.ahead,
                a.back + high,
            )
        case _:
            word = draw.choice(["always", "eventually"])
            return Drawn(
                f"{word} [{low}s, {high}s] ({a.own})",
                f"({word}[{low},{high}] {a.rtamt})",
                "",
                a.ahead + high,
                a.back,
            )


def two(draw: Random, depth: int, *, past: bool) -> Drawn:
    a, b = (formula(draw, depth - 1, past=past) for _ in "ab")
    low, high = interval(draw)
    ahead, back = max(a.ahead, b.ahead), max(a.back, b.back)
    match draw.choice(["and", "or", "->", "since", *([] if past else ["until"])]):
        case "since":
            return Drawn(
                f"({a.own}) since [{low}s, {high}s] ({b.own})",
                f"({a.rtamt} since[{low},{high}] {b.rtamt})",
                f"({a.reelay} since[{low}:{high}] {b.reelay})",
                ahead,
                back + high,
            )
        case "until":
            return Drawn(
                f"({a.own}) until [{low}s, {high}s] ({b.own})",
                f"({a.rtamt} until[{low},{high}] {b.rtamt})",
                "",
                ahead + high,
                back,
            )
        case word:
            return Drawn(
                f"({a.own}) {word} ({b.own})",
                f"({a.rtamt} {word} {b.rtamt})",
                f"({a.reelay} {word} {b.reelay})",
                ahead,
                back,
            )


def formula(draw: Random, depth: int, *, past: bool) -> Drawn:
    if depth == 0:
        return atom(draw)
    return draw.choice([one, two])(draw, depth, past=past)


def compared(seed: int, evaluate: Callable[[Drawn, np.ndarray], np.ndarray], *, past: bool) -> int:
    """Compare a drawn formula with a tool; return the number of false verdicts."""
    draw = Random(seed)
    drawn = formula(draw, draw.choice([1, 2, 3]), past=past)
    values = speeds(200, seed)
    told = evaluate(drawn, values)
    own, robustness = evaluated(drawn.own, values)
    whole = slice(drawn.back, len(values) - drawn.ahead)
    expected = own if told.dtype == bool else robustness
    assert np.array_equal(expected[whole], told[whole]), drawn
    return int(np.count_nonzero(~own[whole]))


def test_random_formulas_by_rtamt() -> None:
    count = [compared(seed, lambda d, v: by_rtamt(d.rtamt, v), past=False) for seed in range(150)]
    assert len([each for each in count if 0 < each < 150]) > 50


def test_random_formulas_of_the_past_by_reelay() -> None:
    count = [compared(seed, lambda d, v: by_reelay(d.reelay, v), past=True) for seed in range(300)]
    assert len([each for each in count if 0 < each < 150]) > 100
