"""A match printed as a tree for people."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias, assert_never

from ..ontology.units import format_unit
from ..rdf.namespaces import local_name
from .plan import (
    Compute,
    Detect,
    Edge,
    Node,
    Port,
    SelectObject,
    SelectObjects,
    Supply,
    SupplySource,
    Synchronize,
    UseStream,
    below_of,
    nodes_of_supply,
)
from .plan_text import conversion_text, stream_text
from .tree import Alternative, Match, Outcome
from .want import Want

MOST_LINES = 500
"""Lines of a match at most; one more gives the number of the others."""
DEEPEST = 60
"""Steps above each other in `steps`: parsers of JSON limit its depth."""


@dataclass(frozen=True, slots=True)
class Step:
    """A line of a match as a value, for interfaces that draw the tree themselves.

    ``verdict``: chosen, possible, not tried or failed; empty for what a chosen line rests on.
    ``cost``: what it adds to the cost of the plan; None of what is not in the plan.
    """

    text: str
    verdict: str = ""
    reason: str = ""
    stream: str | None = None
    transformation: str | None = None
    parts: tuple[Step, ...] = ()
    cost: float | None = None


class _Use(NamedTuple):
    """A node where it is read, of which ``ports`` are used; ``role`` stands before its line."""

    node: Node
    ports: tuple[Port, ...]
    role: str = ""


_Item: TypeAlias = _Use | Alternative | str
"""The content of a line."""
_Line: TypeAlias = tuple[str, str, _Item]
"""The prefix of a line, that of the lines below it, and its content."""

_BRANCH, _LAST, _DOWN, _PAST = "├─ ", "└─ ", "│  ", "   "


def render(match: Match) -> str:
    """The plan chosen (or what is missing), then what else was considered and why not.

    ::

        speed of dyknow:uav1 [km.h-1]
        └─ chosen: coordinatesToSpeed : latitude, longitude ⇒ speed   (m.s-1 → km.h-1 × 3.6)
           └─ select icao24 = uav1
              └─ stream positions : latitude [deg], longitude [deg] for every UAV = icao24

    A node in several places is shown where it comes first, with a number (``#1``) to which the
    other places refer. At most `MOST_LINES` lines, and one with the number of the others.
    Law: lines are at most the title, the edges of the plan, and the alternatives.
    """
    sources = () if match.supply is None else match.supply.sources
    rest = [alternative for alternative in match.tree if alternative.outcome is not Outcome.CHOSEN]
    below: list[_Item] = [_Use(source.node, (source.port,), "chosen: ") for source in sources]
    if match.supply is None and not rest:
        below += match.missing
    below += rest
    shared = _shared(match.supply)
    numbers: dict[Node, int] = {}
    lines = [_title(match.want, sources)]
    more = 0
    waiting = _hung(below, "")
    while waiting:
        head, down, item = waiting.pop()
        text, parts = _described(item, shared, numbers)
        if len(lines) < MOST_LINES:
            lines.append(head + text)
        else:
            more, down = more + 1, ""
        waiting += _hung(parts, down)
    if more:
        lines.append(f"… {more} more line{'s' if more > 1 else ''}")
    return "\n".join(lines)


def steps(match: Match, cost: Callable[[Node], float]) -> Step:
    """The tree of `render` as a value: the title with the lines below it. ``cost``: of a node.

    At most `MOST_LINES` steps, and at most `DEEPEST` above each other.
    """
    sources = () if match.supply is None else match.supply.sources
    rest = [alternative for alternative in match.tree if alternative.outcome is not Outcome.CHOSEN]
    below: list[_Item] = [_Use(source.node, (source.port,)) for source in sources]
    if match.supply is None and not rest:
        below += match.missing
    left = MOST_LINES
    counted: set[Node] = set()

    def made(items: Sequence[_Item], depth: int, verdict: str = "") -> tuple[Step, ...]:
        nonlocal left
        found = []
        for item in items if depth < DEEPEST else ():
            if left <= 0:
                break
            left -= 1
            found.append(step(item, depth, verdict))
        return tuple(found)

    def step(item: _Item, depth: int, verdict: str) -> Step:
        match item:
            case str():
                return Step(item, "failed")
            case Alternative(text, outcome, reason, parts, stream):
                return Step(text, str(outcome), reason, stream, None, made(parts, depth + 1))
            case _Use(node, ports, _):
                text, uses = _node(node, ports)
                stream = node.stream if isinstance(node, UseStream) else None
                unit = node.transformation if isinstance(node, Compute) else None
                own = 0.0 if node in counted else cost(node)  # A unit that is read twice runs once.
                counted.add(node)
                return Step(text, verdict, "", stream, unit, made(uses, depth + 1), own)
            case _:
                assert_never(item)

    return Step(
        _title(match.want, sources),
        parts=made(below, 0, str(Outcome.CHOSEN)) + made(rest, 0),
    )


def _hung(parts: Sequence[_Item], down: str) -> list[_Line]:
    """The parts below something whose lines begin with ``down``, the last one first."""
    last = len(parts) - 1
    return [
        (
            down + (_LAST if place == last else _BRANCH),
            down + (_PAST if place == last else _DOWN),
            part,
        )
        for place, part in reversed(list(enumerate(parts)))
    ]


def _title(want: Want, sources: Sequence[SupplySource]) -> str:
    unit = sources[0].port.target if sources else ()
    text = f"{local_name(want.feature)} of {want.whose}"
    return text + (f" [{format_unit(unit)}]" if unit else "")


def _shared(supply: Supply | None) -> set[Node]:
    """The nodes that stand in several places and rest on others."""
    if supply is None:
        return set()
    places = Counter(source.node for source in supply.sources)
    for node in nodes_of_supply(supply):
        places.update(below_of(node))
    return {node for node, count in places.items() if count > 1 and below_of(node)}


def _described(
    item: _Item, shared: Set[Node], numbers: dict[Node, int]
) -> tuple[str, Sequence[_Item]]:
    """The line of an item, and the items below it. A shared node gets its number in ``numbers``
    when it comes first."""
    match item:
        case str():
            return item, ()
        case Alternative(text, outcome, reason, parts, _):
            return f"{outcome}: {text}" + (f" — {reason}" if reason else ""), parts
        case _Use(node, ports, role):
            text, below = _node(node, ports)
            if node not in shared:
                return role + text, below
            if node in numbers:
                return f"{role}{text}   #{numbers[node]}, as above", ()
            numbers[node] = len(numbers) + 1
            return f"{role}{text}   #{numbers[node]}", below
        case _:
            assert_never(item)


def _node(node: Node, ports: tuple[Port, ...]) -> tuple[str, Sequence[_Use]]:
    """The line of ``node``, of which ``ports`` are used, and the nodes that it uses."""
    match node:
        case UseStream(stream, contents):
            fields = tuple(port.source_field for port in ports)
            return stream_text(stream, contents, fields, ports), ()
        case SelectObject(source, id_field, object):
            return f"select {id_field} = {local_name(object)}", (_Use(source, ports),)
        case SelectObjects(source, id_field):
            return f"select the {id_field} that requests ask for", (_Use(source, ports),)
        case Synchronize(inputs):
            return "synchronize", _uses(inputs)
        case Detect(event, _, _, sources):
            return f"event {event}", [_Use(part.node, (part.port,)) for part in sources]
        case Compute(transformation, inputs, output):
            names = [local_name(port.feature) for edge in inputs for port in edge.ports]
            head = f"{transformation} : {', '.join(names) or '∅'} ⇒ {local_name(output.feature)}"
            changes = ", ".join(filter(None, map(conversion_text, ports)))
            return f"{head}   ({changes})" if changes else head, _uses(inputs)
        case _:
            assert_never(node)


def _uses(inputs: Sequence[Edge]) -> list[_Use]:
    return [_Use(edge.node, edge.ports) for edge in inputs]
