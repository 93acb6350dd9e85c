"""JSON models of the graph of what runs."""

from __future__ import annotations

from urllib.parse import quote

from pydantic import BaseModel, Field

from ...engine.model.graph import Graph, Node, NodeKind

PATHS = {
    NodeKind.STREAM: "streams",
    NodeKind.UNIT: "units",
    NodeKind.REQUEST: "events",
    NodeKind.QUERY: "queries",
    NodeKind.SUBSCRIPTION: "subscriptions",
}


class NodeModel(BaseModel):
    """A node of the graph."""

    id: str = Field(description="its address, which GET returns with all else")
    kind: NodeKind
    name: str
    text: str = Field(
        description="the features of a stream, the transformation of a unit, the kind of a "
        "query, what a request or subscription asks for"
    )
    state: str = Field(
        description="running, failed; of a stream also idle, ended; of a query also ended; of a "
        "subscription to a feature also stale, waiting"
    )


class EdgeModel(BaseModel):
    """Samples go from a node to another; both are ids."""

    start: str = Field(alias="from")
    end: str = Field(alias="to")


class GraphModel(BaseModel):
    """Streams, units and requests that run, and which reads which."""

    nodes: list[NodeModel]
    edges: list[EdgeModel]

    @classmethod
    def of(cls, graph: Graph) -> GraphModel:
        nodes = [
            NodeModel(
                id=_id(each), kind=each.kind, name=each.name, text=each.text, state=each.state
            )
            for each in graph.nodes
        ]
        edges = [EdgeModel(**{"from": _id(a), "to": _id(b)}) for a, b in graph.edges]
        return cls(nodes=nodes, edges=edges)


def _id(node: Node) -> str:
    return f"/{PATHS[node.kind]}/{quote(node.name, safe='')}"
