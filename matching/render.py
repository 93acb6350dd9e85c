"""A match printed as a tree for people."""

from __future__ import annotations

from collections.abc import Sequence
from typing import assert_never

from ..ontology.units import format_unit
from ..rdf.namespaces import local_name
from .plan import (
    Compute,
    Detect,
    Node,
    Port,
    SelectObject,
    SupplySource,
    Synchronize,
    UseStream,
)
from .tree import Alternative, Match, Outcome
from .want import Want
from .words import conversion_words, stream_words

_BRANCH, _LAST, _DOWN, _PAST = "├─ ", "└─ ", "│  ", "   "


def render(match: Match) -> str:
    """The plan chosen (or what is missing), then what else was considered and why not.

    ::

        speed of dyknow:uav1 [km.h-1]
        └─ chosen: coordinatesToSpeed : latitude, longitude ⇒ speed   (m.s-1 → km.h-1 × 3.6)
           └─ select icao24 = uav1
              └─ stream positions : latitude [deg], longitude [deg] for every UAV = icao24
    """
    sources = () if match.supply is None else match.supply.sources
    lines = [_title(match.want, sources)]
    rest = [alternative for alternative in match.tree if alternative.outcome is not Outcome.CHOSEN]
    blocks = [_source(source) for source in sources]
    if match.supply is None and not rest:
        blocks = [[reason] for reason in match.missing]
    blocks += [_alternative(alternative) for alternative in rest]
    for place, block in enumerate(blocks):
        lines += _indented(block, place == len(blocks) - 1)
    return "\n".join(lines)


def _title(want: Want, sources: Sequence[SupplySource]) -> str:
    unit = sources[0].port.target if sources else ()
    text = f"{local_name(want.feature)} of {want.whose}"
    return text + (f" [{format_unit(unit)}]" if unit else "")


def _indented(block: list[str], last: bool) -> list[str]:
    head, down = (_LAST, _PAST) if last else (_BRANCH, _DOWN)
    return [head + block[0], *(down + line for line in block[1:])]


def _source(source: SupplySource) -> list[str]:
    block = _node(source.node, (source.port,))
    return [f"chosen: {block[0]}", *block[1:]]


def _node(node: Node, ports: tuple[Port, ...]) -> list[str]:
    """A block of lines for ``node``, of which ``ports`` are used."""
    match node:
        case UseStream(stream, contents):
            fields = tuple(port.source_field for port in ports)
            return [stream_words(stream, contents, fields, ports)]
        case SelectObject(source, id_field, object):
            head = f"select {id_field} = {local_name(object)}"
            return [head, *_indented(_node(source, ports), last=True)]
        case Synchronize(inputs):
            block = ["synchronize"]
            for place, edge in enumerate(inputs):
                block += _indented(_node(edge.node, edge.ports), place == len(inputs) - 1)
            return block
        case Detect(event, _, _, sources):
            block = [f"event {event}"]
            for place, part in enumerate(sources):
                block += _indented(_node(part.node, (part.port,)), place == len(sources) - 1)
            return block
        case Compute(transformation, inputs, output):
            names = [local_name(port.feature) for edge in inputs for port in edge.ports]
            head = f"{transformation} : {', '.join(names) or '∅'} ⇒ {local_name(output.feature)}"
            changes = ", ".join(filter(None, map(conversion_words, ports)))
            block = [f"{head}   ({changes})" if changes else head]
            for place, edge in enumerate(inputs):
                block += _indented(_node(edge.node, edge.ports), place == len(inputs) - 1)
            return block
        case _:
            assert_never(node)


def _alternative(alternative: Alternative) -> list[str]:
    head = f"{alternative.outcome}: {alternative.text}"
    block = [f"{head} — {alternative.reason}" if alternative.reason else head]
    for place, part in enumerate(alternative.parts):
        inner = _alternative(part)
        block += _indented(inner, place == len(alternative.parts) - 1)
    return block
