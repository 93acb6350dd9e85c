"""Laws of the plans of least weight and of best quality, against every plan there is.

The definition here enumerates: one producer for each goal, all choices, those without a cycle.
"""

from math import fsum
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dyknow.matching.optimum import knuth, landmarks, reductions
from dyknow.matching.optimum.best_quality import best_quality
from dyknow.matching.optimum.hypergraph import Hypergraph, HypergraphError
from dyknow.matching.optimum.least_weight import least_weight

LIMITS = settings(deadline=None, max_examples=150)
NEAR = 1e-9


def hypergraph(goals, producers):
    """From (goal, inputs, weight, quality) each."""
    starts = np.cumsum([0, *(len(inputs) for _, inputs, _, _ in producers)])
    return Hypergraph(
        goals,
        np.array([goal for goal, _, _, _ in producers], np.int32),
        starts.astype(np.int32),
        np.array([i for _, inputs, _, _ in producers for i in inputs], np.int32),
        np.array([weight for _, _, weight, _ in producers], np.float64),
        np.array([quality for _, _, _, quality in producers], np.float64),
    )


@st.composite
def problems(draw):
    goals = draw(st.integers(1, 7))
    goal = st.integers(0, goals - 1)
    inputs = st.lists(goal, max_size=draw(st.integers(1, 4)))
    weight = draw(
        st.sampled_from(
            [
                st.integers(0, 3),
                st.integers(0, 9),
                st.floats(0, 5),
                st.sampled_from([1e-30, 1, 1e30]),
            ]
        )
    )
    quality = st.sampled_from([0.0, 0.25, 0.3, 0.5, 0.9, 1.0])
    producer = st.tuples(goal, inputs, weight, quality)
    # Some goals for nothing but a weight, or most graphs have no plan.
    source = st.tuples(goal, st.just([]), weight, quality)
    producers = draw(st.lists(source, min_size=1, max_size=3))
    producers += draw(st.lists(producer, max_size=12 - len(producers)))
    roots = draw(st.lists(goal, min_size=1, max_size=3))
    return goals, draw(st.permutations(producers)), roots


def plans(goals, producers, roots):
    """Every plan, as goal → producer for what it uses."""
    alternatives = [[p for p, each in enumerate(producers) if each[0] == g] for g in range(goals)]

    def extended(picks):
        wanted = {*roots, *(i for p in picks.values() for i in producers[p][1])} - set(picks)
        if not wanted:
            yield picks
        else:
            goal = min(wanted)
            for producer in alternatives[goal]:
                yield from extended(picks | {goal: producer})

    for picks in extended({}):
        if closure(picks, producers, roots) is not None:
            yield picks


def closure(picks, producers, roots):
    """What the roots use of the picks; None if something is not picked, or got from itself."""
    plan, path = {}, set()

    def visit(goal):
        if goal in path or goal not in picks:
            return False
        if goal in plan:
            return True
        path.add(goal)
        fine = all(visit(needed) for needed in producers[picks[goal]][1])
        path.discard(goal)
        plan[goal] = picks[goal]
        return fine

    return plan if all(visit(root) for root in roots) else None


def weight_of(plan, producers):
    return fsum(producers[p][2] for p in plan.values())


def quality_of(plan, producers, goal):
    _, inputs, _, quality = producers[plan[goal]]
    return quality * min((quality_of(plan, producers, i) for i in inputs), default=1.0)


def check(choice, producers, roots):
    """The choice is a plan, and uses nothing else."""
    assert all(producers[p][0] == goal for goal, p in choice.producers.items())
    assert closure(choice.producers, producers, roots) == choice.producers
    assert list(choice.producers) == sorted(choice.producers)
    assert all(type(x) is int for pair in choice.producers.items() for x in pair)


@given(problems())
@LIMITS
def test_the_least_weight_is_the_least_of_all_plans(problem):
    goals, producers, roots = problem
    choice = least_weight(hypergraph(goals, producers), roots)
    every = [weight_of(plan, producers) for plan in plans(goals, producers, roots)]
    assert (choice is None) == (not every)
    if choice is not None:
        check(choice, producers, roots)
        assert choice.value == weight_of(choice.producers, producers)
        assert choice.proven
        assert choice.value == pytest.approx(min(every), rel=NEAR, abs=0)
        assert choice.bound <= min(every)


@given(problems(), st.integers(0, 300))
@LIMITS
def test_with_little_effort_plans_are_valid_and_bounds_are_true(problem, effort):
    goals, producers, roots = problem
    choice = least_weight(hypergraph(goals, producers), roots, effort)
    if choice is not None:
        check(choice, producers, roots)
        best = min(weight_of(plan, producers) for plan in plans(goals, producers, roots))
        assert choice.bound <= best <= choice.value * (1 + NEAR)
        assert choice.value == weight_of(choice.producers, producers)
        if choice.proven:
            assert choice.value == pytest.approx(best, rel=NEAR, abs=0)


@given(problems())
@LIMITS
def test_the_best_quality_is_the_best_of_all_plans_for_every_goal_used(problem):
    goals, producers, roots = problem
    choice = best_quality(hypergraph(goals, producers), roots)
    assert (choice is None) == (not any(True for _ in plans(goals, producers, roots)))
    if choice is not None:
        check(choice, producers, roots)
        assert choice.proven
        own = {goal: quality_of(choice.producers, producers, goal) for goal in choice.producers}
        assert choice.value == choice.bound == min(own[root] for root in roots)
        for goal, quality in own.items():
            assert quality == max(
                quality_of(plan, producers, goal) for plan in plans(goals, producers, [goal])
            )


@given(problems(), st.randoms())
@LIMITS
def test_numbering_the_producers_anew_changes_no_value(problem, random):
    goals, producers, roots = problem
    shuffled = random.sample(producers, len(producers))
    again = random.sample(roots, len(roots)) + roots
    for find in (least_weight, best_quality):
        one = find(hypergraph(goals, producers), roots)
        other = find(hypergraph(goals, shuffled), again)
        assert (one is None) == (other is None)
        if one is not None:
            assert one.value == pytest.approx(other.value, rel=NEAR, abs=0)


@given(problems())
@LIMITS
def test_without_compiled_loops_the_same_plans_come_out(problem):
    goals, producers, roots = problem
    graph = hypergraph(goals, producers)
    compiled = [find(graph, roots) for find in (least_weight, best_quality)]
    with pytest.MonkeyPatch.context() as patch:
        for module in (knuth, landmarks, reductions):
            patch.setattr(module, "JIT", False)
        assert [find(graph, roots) for find in (least_weight, best_quality)] == compiled


def layered(seed, goals, layers, least, most, weights):
    """Three producers a goal, inputs from the layer below or from anywhere above (cycles)."""
    random = Random(seed)
    layer = [goal * layers // goals for goal in range(goals)]
    producers = []
    for goal in range(goals):
        below = [g for g in range(goals) if layer[g] == layer[goal] - 1]
        for _ in range(3):
            count = random.randint(least, most) if below else 0
            inputs = [
                random.choice(below) if random.random() < 0.9 else random.randrange(goals)
                for _ in range(count)
            ]
            producers.append((goal, inputs, weights(random), random.random()))
    return producers


def least_of_all(producers, roots):
    """The definition, but for plans that already weigh too much before they are whole."""
    best = float("inf")

    def extend(picks, weight):
        nonlocal best
        wanted = {*roots, *(i for p in picks.values() for i in producers[p][1])} - set(picks)
        if weight >= best:
            return
        if wanted:
            goal = max(wanted)
            for producer, (derived, _, more, _) in enumerate(producers):
                if derived == goal:
                    extend(picks | {goal: producer}, weight + more)
        elif closure(picks, producers, roots) is not None:
            best = weight

    extend({}, 0.0)
    return best


@pytest.mark.parametrize("seed", range(40))
def test_branching_finds_the_least_too(seed):
    """Graphs of which the first bound is mostly not enough."""
    weights = (lambda r: r.randint(1, 9)) if seed % 2 else (lambda r: r.uniform(1, 9))
    producers = layered(seed, 13, 4, 2, 3, weights)
    roots = [10, 12]
    best = least_of_all(producers, roots)
    for effort in (0, 100, 1_000, 3_000, 10_000, 10**7):
        choice = least_weight(hypergraph(13, producers), roots, effort)
        check(choice, producers, roots)
        assert choice.bound <= best <= choice.value * (1 + NEAR)
    assert choice.proven
    assert choice.value == pytest.approx(best, rel=NEAR)


def test_a_large_graph_with_cycles_is_answered_with_a_plan():
    producers = layered(0, 3333, 8, 1, 3, lambda r: max(0.0, r.uniform(-1, 9)))
    producers.append((3332, [3332, 0, 0], 0.0, 1.0))
    graph, roots = hypergraph(3333, producers), [3330, 3332]
    for effort in (0, 10**5, 10**6):
        choice = least_weight(graph, roots, effort)
        check(choice, producers, roots)
        assert 0 < choice.bound <= choice.value == weight_of(choice.producers, producers)
        assert choice == least_weight(graph, roots, effort)
    quality = best_quality(graph, roots)
    check(quality, producers, roots)
    assert quality.value == min(quality_of(quality.producers, producers, root) for root in roots)


def test_what_is_shared_counts_once():
    shared = [(0, [], 5.0, 1.0), (1, [0], 1.0, 1.0), (2, [0], 1.0, 1.0), (3, [1, 2], 0.0, 1.0)]
    apart = [(1, [], 4.0, 1.0), (2, [], 4.0, 1.0)]
    choice = least_weight(hypergraph(4, shared + apart), [3])
    assert (choice.producers, choice.value) == ({0: 0, 1: 1, 2: 2, 3: 3}, 7.0)


def test_producers_without_weight_make_no_cycle():
    producers = [(0, [1], 0.0, 1.0), (1, [0], 0.0, 1.0), (1, [], 2.0, 0.5)]
    for find in (least_weight, best_quality):
        assert find(hypergraph(2, producers), [0]).producers == {0: 0, 1: 2}
        assert find(hypergraph(2, producers[:2]), [0]) is None


def test_the_smallest_graphs():
    empty = hypergraph(0, [])
    for find in (least_weight, best_quality):
        assert find(empty, []).producers == {}
        assert find(hypergraph(1, []), [0]) is None
        with pytest.raises(HypergraphError):
            find(empty, [0])
    assert least_weight(empty, []).value == 0.0


@pytest.mark.parametrize(
    "changed",
    [
        {"derives": np.array([2], np.int32)},
        {"inputs": np.array([-1], np.int32)},
        {"starts": np.array([0, 2], np.int32)},
        {"weights": np.array([-1.0])},
        {"weights": np.array([np.inf])},
        {"weights": np.array([np.nan])},
        {"qualities": np.array([1.5])},
        {"qualities": np.array([0.5, 0.5])},
    ],
)
def test_a_graph_that_contradicts_itself_is_refused(changed):
    parts = {
        "goals": 2,
        "derives": np.array([1], np.int32),
        "starts": np.array([0, 1], np.int32),
        "inputs": np.array([0], np.int32),
        "weights": np.array([1.0]),
        "qualities": np.array([1.0]),
    }
    Hypergraph(**parts)
    with pytest.raises(HypergraphError):
        Hypergraph(**(parts | changed))
