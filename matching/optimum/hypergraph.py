"""Goals and producers: the transformation tree as an AND/OR hypergraph ([Introspection15 §4.3]).

A *goal* is a node of the tree, a *producer* one way to derive it from other goals, its inputs. The
producers of a goal are alternatives; a producer needs all its inputs. A *plan* for some roots picks
exactly one producer for each goal that it uses (the roots, and the inputs of picked producers), in
such a way that no goal is derived from itself. `least_weight` and `best_quality` find plans.

`Net` is the form that both walk: it is indexed from goals to producers in both directions, and
names each input of a producer once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Ids: TypeAlias = NDArray[np.int32]
Flags: TypeAlias = NDArray[np.bool_]
Floats: TypeAlias = NDArray[np.float64]
Integers: TypeAlias = NDArray[np.int64]
Arrays: TypeAlias = tuple[Ids, Ids, Ids, Ids, Ids, Ids, Ids]

NEAR = 1e-9
"""The relative difference that rounding may make between a value and the bound that proves it."""


class HypergraphError(ValueError):
    """A hypergraph that contradicts itself, or a root that is not in it."""


@dataclass(frozen=True, slots=True, eq=False)
class Hypergraph:
    """Producers 0 … m-1 of goals 0 … ``goals`` - 1, m = ``len(derives)``."""

    goals: int
    derives: Ids
    """The goal of each producer."""
    starts: Ids
    """m + 1 places: the inputs of producer p are ``inputs[starts[p]:starts[p + 1]]``."""
    inputs: Ids
    """Goals; repeating one within a producer has no effect."""
    weights: Floats
    """Of each producer, at least 0; their sum is finite."""
    qualities: Floats
    """Of each producer, from 0 to 1."""

    def __post_init__(self) -> None:
        count = len(self.derives)
        if not (
            len(self.starts) == count + 1 and len(self.weights) == len(self.qualities) == count
        ):
            raise HypergraphError("a producer has one goal, one weight and one quality")
        if self.starts[0] != 0 or self.starts[-1] != len(self.inputs) or _falls(self.starts):
            raise HypergraphError("the starts of the inputs do not ascend from 0 to their number")
        for ids in (self.derives, self.inputs):
            if len(ids) and (ids.min() < 0 or ids.max() >= self.goals):
                raise HypergraphError(f"a goal is not in 0 … {self.goals - 1}")
        with np.errstate(over="ignore"):
            total = self.weights.sum()
        if not (np.isfinite(total) and (self.weights >= 0).all()):
            raise HypergraphError("weights are at least 0, and their sum is finite")
        if not ((self.qualities >= 0) & (self.qualities <= 1)).all():
            raise HypergraphError("qualities are from 0 to 1")


@dataclass(frozen=True, slots=True)
class Choice:
    """A plan."""

    producers: Mapping[int, int]
    """goal → its producer, for exactly the goals that the plan uses; goals ascend."""
    value: float
    """The total weight, or the least quality of a root."""
    bound: float
    """No plan weighs less; of a best quality, the value itself."""

    @property
    def proven(self) -> bool:
        """Whether no plan is better, except by rounding."""
        return self.bound >= self.value - NEAR * abs(self.value)


@dataclass(frozen=True, slots=True, eq=False)
class Net:
    """Producers and goals, indexed in both directions. Memory: 8 bytes an input, 8 a producer."""

    goals: int
    arrays: Arrays
    """derives, starts, inputs (as in a `Hypergraph`, but sorted and distinct), then by_starts, by
    (the producers of a goal, ascending) and use_starts, use (the producers that need it)."""

    @property
    def derives(self) -> Ids:
        return self.arrays[0]

    @property
    def starts(self) -> Ids:
        return self.arrays[1]

    @property
    def inputs(self) -> Ids:
        return self.arrays[2]

    @property
    def size(self) -> int:
        """The number of producers."""
        return len(self.arrays[0])

    @property
    def pass_steps(self) -> int:
        """The cost of one pass of `knuth`, in steps of search."""
        return self.size + 8 * self.goals

    def inputs_of(self, producer: int) -> Ids:
        return self.inputs[self.starts[producer] : self.starts[producer + 1]]

    def producers_of(self, goal: int) -> Ids:
        by_starts, by = self.arrays[3:5]
        return by[by_starts[goal] : by_starts[goal + 1]]


def net_of(graph: Hypergraph) -> Net:
    """The whole graph as a net. O(k log k) for k inputs."""
    count = len(graph.derives)
    owners = np.repeat(np.arange(count, dtype=np.int64), np.diff(graph.starts))
    keys = np.unique(owners * max(graph.goals, 1) + graph.inputs)
    owners, inputs = np.divmod(keys, max(graph.goals, 1))
    return _indexed(graph.goals, graph.derives, owners, inputs)


def restricted(net: Net, keep: Flags, given: Flags) -> tuple[Net, Integers, Integers]:
    """The net of the producers to ``keep`` and the goals they name, but for the ``given`` goals.

    Returns also the old number of each new producer, and the new one of each old goal (-1: none).
    """
    owners = np.repeat(np.arange(net.size), np.diff(net.starts))
    kept = keep[owners] & ~given[net.inputs]
    producers = np.flatnonzero(keep)
    named = np.zeros(net.goals, np.bool_)
    named[net.derives[producers]] = True
    named[net.inputs[kept]] = True
    goals = np.where(named, np.cumsum(named) - 1, -1)
    numbers = np.cumsum(keep) - 1
    count = int(named.sum())
    derives = goals[net.derives[producers]].astype(np.int32)
    return (
        _indexed(count, derives, numbers[owners[kept]], goals[net.inputs[kept]]),
        producers,
        goals,
    )


def checked_roots(graph: Hypergraph, roots: Sequence[int]) -> Ids:
    """The distinct roots, ascending; a HypergraphError for one that is no goal."""
    distinct = sorted({int(root) for root in roots})
    if distinct and not 0 <= distinct[0] <= distinct[-1] < graph.goals:
        raise HypergraphError(f"a root is not in 0 … {graph.goals - 1}")
    return np.array(distinct, np.int32)


def _falls(starts: Ids) -> bool:
    return bool((np.diff(starts) < 0).any())


def _indexed(goals: int, derives: Ids, owners: Integers, inputs: Integers) -> Net:
    """Index a net; ``owners``, ascending, are the producers of the inputs."""
    numbers = np.arange(len(derives), dtype=np.int32)
    starts = np.zeros(len(derives) + 1, np.int32)
    np.cumsum(np.bincount(owners, minlength=len(derives)), out=starts[1:])
    by_starts, by = _grouped(derives, numbers, goals)
    use_starts, use = _grouped(inputs, owners.astype(np.int32), goals)
    # The compiled loops take arrays of exactly this type (`signature`).
    narrow = np.array(inputs, np.int32)
    whose = np.array(derives, np.int32)
    return Net(goals, (whose, starts, narrow, by_starts, by, use_starts, use))


def _grouped(keys: NDArray[np.integer], items: Ids, groups: int) -> tuple[Ids, Ids]:
    starts = np.zeros(groups + 1, np.int32)
    np.cumsum(np.bincount(keys, minlength=groups), out=starts[1:])
    return starts, items[np.argsort(keys, kind="stable")]


def signature(result: str, *arguments: str) -> Callable[[], Any]:
    """The numba signature of a loop over a net (`jit.Kernel`)."""

    def types_of() -> Any:
        from numba import types

        tuple_of: Any = types.UniTuple
        kinds = {
            "net": tuple_of(types.int32[::1], 7),
            "flags": types.boolean[::1],
            "ids": types.int32[::1],
            "floats": types.float64[::1],
            "float": types.float64,
            "int": types.int64,
            "truth": types.boolean,
            "void": types.void,
            "pair": tuple_of(types.float64, 2),
        }
        return kinds[result](*(kinds[name] for name in arguments))

    return types_of
