"""The graph of what runs: streams, the units between them, and the requests that read them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from .errors import UnknownNode


class NodeKind(StrEnum):
    """What a node stands for; a request is one for an event."""

    STREAM = "stream"
    UNIT = "unit"
    REQUEST = "request"
    QUERY = "query"
    SUBSCRIPTION = "subscription"


@dataclass(frozen=True, slots=True)
class Node:
    """A node of the graph. ``text``: the features of a stream, the transformation of a unit, or
    what a request asks for; ``state``: running, idle, ended, failed, or that of a subscription to a
    feature."""

    kind: NodeKind
    name: str
    text: str
    state: str


Edge = tuple[Node, Node]
"""Samples go from the first node to the second."""


@dataclass(frozen=True, slots=True)
class Graph:
    """Nodes and edges: from streams to the units and requests that read them, and from units to the
    streams that they make."""

    nodes: tuple[Node, ...]
    edges: tuple[Edge, ...]

    def around(self, name: str, depth: int | None) -> Graph:
        """The nodes called ``name``, all that feeds them and all that they feed, at most ``depth``
        edges away (None: any number), with the edges between these nodes.

        Raises `UnknownNode`. Cost: linear in nodes and edges.
        """
        starts = [node for node in self.nodes if node.name == name]
        if not starts:
            raise UnknownNode(f"nothing that runs is called {name!r}")
        reached = _reached(starts, self.edges, depth)
        reached |= _reached(starts, ((end, start) for start, end in self.edges), depth)
        return Graph(
            tuple(node for node in self.nodes if node in reached),
            tuple(edge for edge in self.edges if reached.issuperset(edge)),
        )


def _reached(starts: Iterable[Node], edges: Iterable[Edge], depth: int | None) -> set[Node]:
    following: dict[Node, list[Node]] = defaultdict(list)
    for start, end in edges:
        following[start].append(end)
    found, front = set(starts), set(starts)
    while front and depth != 0:
        front = {end for start in front for end in following[start]} - found
        found |= front
        depth = None if depth is None else depth - 1
    return found
