"""Draws the graph of what runs from the configuration and the requests."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Protocol

from ...languages.ssl.annotation import Content
from ...rdf.namespaces import shorten
from ...streams.generator import StreamGenerator
from ..configuration.configuration import Configuration
from ..model.graph import Edge, Graph, Node, NodeKind


class Requesters(Protocol):
    """A kind of requests."""

    def nodes(self) -> Iterator[tuple[Node, str]]:
        """Yield the node of each request, and the stream that it reads."""


def graph_of(
    configuration: Configuration,
    contents_of: Callable[[str], tuple[Content, ...]],
    requesters: Iterable[Requesters],
) -> Graph:
    """Return the graph; ``contents_of`` returns the contents of a stream by its name.

    Cost: O(streams + units), and O(upstream units) a request.
    """
    streams = {
        name: Node(NodeKind.STREAM, name, _features(contents_of(name)), _state(generator))
        for name, generator in configuration.streams.items()
    }
    nodes: list[Node] = [*streams.values()]
    edges: list[Edge] = []
    for unit in configuration.units.values():
        state = "running" if unit.failure is None else "failed"
        node = Node(NodeKind.UNIT, unit.name, unit.transformation, state)
        nodes.append(node)
        edges += [(streams[source.name], node) for source in unit.sources if source.name in streams]
        if unit.output.name in streams:
            edges.append((node, streams[unit.output.name]))
    for each in requesters:
        for node, stream in each.nodes():
            nodes.append(node)
            if stream in streams:
                edges.append((streams[stream], node))
    return Graph(tuple(nodes), tuple(edges))


def _features(contents: tuple[Content, ...]) -> str:
    return ", ".join(dict.fromkeys(shorten(content.feature) for content in contents))


def _state(generator: StreamGenerator) -> str:
    if generator.is_ended:
        return "ended"
    return "idle" if generator.is_idle else "running"
