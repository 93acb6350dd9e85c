"""Plans of which much rests on the same: what is done with them costs distinct nodes, not paths.

Forty layers of two have 2^40 paths: what walked each would not end.
"""

from copy import deepcopy
from dataclasses import replace

import pytest

from dyknow.engine.planning.request_sharing import _with_selections
from dyknow.languages.ssl.annotation import (
    Content,
    PortAnnotation,
    Role,
    StreamAnnotation,
)
from dyknow.matching.match import Match, match, render
from dyknow.matching.plan import (
    SelectObject,
    UseStream,
    below_of,
    expanded,
    nodes_of,
    nodes_of_supply,
)
from dyknow.matching.render import MOST_LINES
from dyknow.matching.space import StreamSpace, TransformationDescription
from dyknow.matching.tree import Alternative, Outcome
from dyknow.matching.want import Want
from dyknow.rdf.namespaces import DYKNOW

LAYERS = 40


def port(feature, field=None):
    return PortAnnotation(field or feature, DYKNOW + feature, (), ())


def space(units, ends):
    """A stream of the features ``ends``, and the transformations ``units``."""
    role = Role(DYKNOW + "Thing", None, "id")
    contents = tuple(Content(DYKNOW + feature, f"v{feature}", (), (role,)) for feature in ends)
    return StreamSpace((StreamAnnotation("ends", contents, ""),), tuple(units))


def mesh(vocabulary, layers=LAYERS, width=2, strategy="fast"):
    """The match of a feature made of all features of the layer below, each of which is made of
    all of the next one's."""
    units = [
        TransformationDescription(
            f"t{layer}_{place}",
            tuple(port(f"f{layer + 1}_{i}", f"x{i}") for i in range(width)),
            port(f"f{layer}_{place}"),
        )
        for layer in range(layers)
        for place in range(width)
    ]
    ends = [f"f{layers}_{place}" for place in range(width)]
    return match(Want(DYKNOW + "f0_0"), space(units, ends), vocabulary, strategy)


@pytest.mark.parametrize("strategy", ["fast", "cost", "quality", "weighted:cost=1,quality=1"])
def test_a_plan_is_printed_in_lines_of_its_distinct_nodes(vocabulary, strategy):
    found = mesh(vocabulary, strategy=strategy)
    nodes = nodes_of_supply(found.supply)
    edges = sum(len(below_of(node)) for node in nodes)
    lines = render(found).splitlines()
    assert len(lines) <= 1 + len(found.supply.sources) + edges
    for transformation in {f"t{layer}_{i} :" for layer in range(1, LAYERS) for i in range(2)}:
        told = [line for line in lines if transformation in line]
        assert told, transformation
        assert sum(not line.endswith(", as above") for line in told) == 1


def test_what_is_shared_has_a_number(vocabulary):
    assert render(mesh(vocabulary, layers=3)).splitlines() == [
        "f0_0 of every dyknow:Thing",
        "└─ chosen: t0_0 : f1_0, f1_1 ⇒ f0_0",
        "   └─ synchronize",
        "      ├─ t1_0 : f2_0, f2_1 ⇒ f1_0",
        "      │  └─ synchronize   #1",
        "      │     ├─ t2_0 : f3_0, f3_1 ⇒ f2_0",
        "      │     │  └─ stream ends : f3_0, f3_1 for every Thing = id",
        "      │     └─ t2_1 : f3_0, f3_1 ⇒ f2_1",
        "      │        └─ stream ends : f3_0, f3_1 for every Thing = id",
        "      └─ t1_1 : f2_0, f2_1 ⇒ f1_1",
        "         └─ synchronize   #1, as above",
    ]


def test_a_print_has_so_many_lines_and_says_how_many_more():
    parts = tuple(Alternative(f"p{i}", Outcome.FAILED) for i in range(MOST_LINES))
    tree = (Alternative("all", Outcome.FAILED, "", parts),)
    lines = render(Match(Want(DYKNOW + "speed"), "fast", None, tree, ())).splitlines()
    assert len(lines) == MOST_LINES + 1
    assert lines[-1] == "… 2 more lines"
    shorter = (replace(tree[0], parts=parts[:-2]),)
    lines = render(Match(Want(DYKNOW + "speed"), "fast", None, shorter, ())).splitlines()
    assert len(lines) == MOST_LINES
    assert lines[-1].endswith(f"failed: p{MOST_LINES - 3}")


def test_plans_that_were_made_apart_are_compared_by_distinct_nodes(vocabulary):
    one, another = (mesh(vocabulary).supply for _ in range(2))
    assert one.sources[0].node is not another.sources[0].node
    assert one == another
    assert len({*nodes_of_supply(one), *nodes_of_supply(another)}) == len(nodes_of_supply(one))
    # Found equal once, they are still unlike a third one; in which order they are asked is nothing.
    other = mesh(vocabulary, layers=LAYERS - 1).supply
    assert one != other
    assert other != another


def test_equal_nodes_are_those_with_equal_fields(vocabulary):
    """The twin: fields compared along every path, of a plan that has few."""
    many = [mesh(vocabulary, layers, width) for layers in (1, 2, 3) for width in (1, 2, 3)]
    nodes = [node for found in many for node in nodes_of_supply(found.supply)]
    nodes += [
        deepcopy(node) for found in many[::2] for node in nodes_of(found.supply.sources[0].node)
    ]
    for one in nodes:
        for another in nodes:
            assert (one == another) is (repr(one) == repr(another))


def test_a_long_chain_is_compared(vocabulary):
    def chain():
        units = [
            TransformationDescription(f"t{i}", (port(f"f{i + 1}"),), port(f"f{i}"))
            for i in range(200)
        ]
        return match(Want(DYKNOW + "f0"), space(units, ["f200"]), vocabulary).supply

    assert chain() == chain()


def selecting(supply):
    """The supply with its streams selected by an object."""
    streams = {node: node for node in nodes_of_supply(supply) if isinstance(node, UseStream)}
    made = {node.stream: SelectObject(node, "id", DYKNOW + "uav1") for node in streams}
    return expanded(supply, made)


def test_selecting_together_costs_distinct_nodes(vocabulary):
    all_objects, others = (mesh(vocabulary).supply for _ in range(2))
    supplies, selections = _with_selections([selecting(others)], [all_objects], 0)
    ((node, object),) = selections
    assert (node.id_field, node.generation, object) == ("id", 0, DYKNOW + "uav1")
    assert expanded(all_objects, {"ends": node}) == supplies[0]
    # What selects nothing is the same plan.
    assert _with_selections([others], [all_objects], 0) == ((all_objects,), ())
    other = mesh(vocabulary, layers=LAYERS - 1).supply
    assert _with_selections([selecting(others)], [other], 0) is None
