"""Ontologies and the live stream space entail what OWL RL says, however they came to be."""

from collections.abc import Callable, Set
from functools import cache
from itertools import chain, pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from dyknow.ontology.entailment.closure import cached_closure
from dyknow.ontology.entailment.hierarchy import Hierarchy
from dyknow.ontology.entailment.owlrl_closure import closure_of, owlrl_closure
from dyknow.ontology.entailment.rules import Entailments, Rules
from dyknow.ontology.entailment.separation import Separation
from dyknow.ontology.errors import OntologyError
from dyknow.rdf.namespaces import OWL, RDF, RDF_TYPE, RDFS, STREAM_SPACE

SCHEMA = [
    ("hasInput", OWL + "inverseOf", "isInput"),
    ("hasInput", RDFS + "domain", "Unit"),
    ("hasInput", RDFS + "range", "Stream"),
    ("hasMainInput", RDFS + "subPropertyOf", "hasInput"),
    ("hasFirstInput", OWL + "equivalentProperty", "hasMainInput"),
    ("beside", RDF_TYPE.value, OWL + "SymmetricProperty"),
    ("beside", RDFS + "domain", "Placed"),
    ("Source", RDFS + "subClassOf", "Unit"),
    ("Sensor", OWL + "equivalentClass", "Source"),
    ("Unit", RDFS + "subClassOf", "Process"),
    ("isInput", RDFS + "range", "Consumer"),
    ("hasRate", RDFS + "domain", "Stream"),
    ("hasRate", RDFS + "subPropertyOf", "hasValue"),
    ("hasValue", RDFS + "domain", "Placed"),
]
PROPERTIES = ["hasInput", "isInput", "hasMainInput", "hasFirstInput", "beside"]
CLASSES = ["Unit", "Stream", "Source", "Sensor", "Process", "Placed", "Consumer"]


def node(name: str) -> NamedNode:
    return NamedNode(name if ":" in name else STREAM_SPACE + name)


def triple(subject: str, predicate: str, object: str) -> Triple:
    return Triple(node(subject), node(predicate), node(object))


individuals = st.sampled_from("abc")
values = st.builds(
    lambda subject, value: Triple(node(subject), node("hasRate"), Literal(value)),
    individuals,
    st.sampled_from([1.0, 2.0]),
)
triples = st.one_of(
    st.builds(triple, individuals, st.sampled_from(PROPERTIES), individuals),
    st.builds(triple, individuals, st.just(RDF_TYPE.value), st.sampled_from(CLASSES)),
)


@cache
def schema() -> frozenset[Triple]:
    declared = [triple(c, RDF_TYPE.value, OWL + "Class") for c in CLASSES]
    declared += [triple(p, RDF_TYPE.value, OWL + "ObjectProperty") for p in PROPERTIES]
    stated = frozenset([triple(*statement) for statement in SCHEMA] + declared)
    return stated | cached_closure(stated)


@given(
    st.lists(st.tuples(st.lists(triples, max_size=5), st.lists(triples, max_size=5)), max_size=4)
)
@settings(deadline=None, max_examples=25)
def test_entailments_equal_owlrl(changes: list[tuple[list[Triple], list[Triple]]]) -> None:
    rules = Rules(schema())
    live = Entailments(rules)
    model: set[Triple] = set()
    seen: set[Triple] = set()
    for added, removed in changes:
        model = (model - set(removed)) | set(added)
        held, implied = live.update(added, removed)
        seen = (seen - implied.removed) | implied.added
        assert not held.added & held.removed
    assert live.asserted == model
    assert live.current == seen
    # The slow twin: everything anew by owlrl, which says nothing new about schema terms.
    twin = owlrl_closure(schema() | model) - model - schema()
    assert live.current - model == twin
    assert live.current == Entailments(rules, model).current


@given(
    st.lists(
        st.tuples(
            st.lists(st.one_of(triples, values), max_size=8),
            st.lists(st.one_of(triples, values), max_size=8),
        ),
        max_size=6,
    )
)
@settings(deadline=None)
def test_entailments_are_those_of_each_triple(
    changes: list[tuple[list[Triple], list[Triple]]],
) -> None:
    rules = Rules(schema())
    live = Entailments(rules)
    model: set[Triple] = set()
    for added, removed in changes:
        before = live.current
        model = (model - set(removed)) | set(added)
        _, implied = live.update(added, removed)
        assert live.asserted == model
        assert live.current == set().union(*map(rules.entail, model))
        assert live.current == (before - implied.removed) | implied.added
        assert not implied.added & before
        assert implied.removed <= before


# -- the closure of an ontology ------------------------------------------------------------------

numbers = st.integers(0, 8)


@given(st.lists(st.tuples(numbers, numbers), max_size=14))
def test_a_hierarchy_is_what_a_walk_along_its_edges_meets(edges: list[tuple[int, int]]) -> None:
    hierarchy = Hierarchy(edges)
    assert set(hierarchy) == set(chain.from_iterable(edges))
    for start in hierarchy:
        met: set[int] = set()
        waiting = [start]
        while waiting:
            node = waiting.pop()
            new = {upper for lower, upper in edges if lower == node} - met
            met |= new
            waiting += new
        assert hierarchy[start] == met
    assert hierarchy.pairs == sum(map(len, hierarchy.values()))


some_class = st.sampled_from([*(node(f"C{i}") for i in range(5)), node(OWL + "Thing")])
some_property = st.sampled_from([node(f"p{i}") for i in range(4)])
some_individual = st.sampled_from([node(name) for name in "abc"])


def saying(
    subject: st.SearchStrategy[NamedNode],
    predicates: list[str],
    object: st.SearchStrategy[NamedNode | Literal],
) -> st.SearchStrategy[list[Triple]]:
    return st.builds(
        lambda s, p, o: [Triple(s, node(p), o)], subject, st.sampled_from(predicates), object
    )


@st.composite
def restrictions(draw: st.DrawFn) -> list[Triple]:
    """A class beside ``some p c`` or ``p value a``, or the intersection or union of two."""
    kind, about = BlankNode(), draw(some_class)
    way = draw(st.sampled_from(["someValuesFrom", "hasValue", "intersectionOf", "unionOf"]))
    if way in ("intersectionOf", "unionOf"):
        rest = BlankNode()
        first, following = NamedNode(RDF + "first"), NamedNode(RDF + "rest")
        return [
            Triple(about, NamedNode(OWL + way), kind),
            Triple(kind, first, draw(some_class)),
            Triple(kind, following, rest),
            Triple(rest, first, draw(some_class)),
            Triple(rest, following, NamedNode(RDF + "nil")),
        ]
    value = draw(some_individual if way == "hasValue" else some_class)
    beside = draw(st.sampled_from([RDFS + "subClassOf", OWL + "equivalentClass"]))
    return [
        Triple(kind, RDF_TYPE, NamedNode(OWL + "Restriction")),
        Triple(kind, NamedNode(OWL + "onProperty"), draw(some_property)),
        Triple(kind, NamedNode(OWL + way), value),
        Triple(about, NamedNode(beside), kind),
    ]


OF_CLASSES = [RDFS + "subClassOf", OWL + "equivalentClass"]
OF_PROPERTIES = [RDFS + "subPropertyOf", OWL + "equivalentProperty"]
HIERARCHY = st.one_of(
    saying(some_class, OF_CLASSES[:1], some_class),
    saying(some_property, OF_PROPERTIES[:1], some_property),
)
STATEMENTS = st.one_of(
    HIERARCHY,
    HIERARCHY,
    saying(some_class, OF_CLASSES, some_class),
    saying(some_property, OF_PROPERTIES, some_property),
    saying(some_property, [RDFS + "domain", RDFS + "range"], some_class),
    saying(some_individual, [RDF_TYPE.value], some_class),
    saying(
        some_class,
        [RDF_TYPE.value],
        st.one_of(some_class, st.sampled_from([node(OWL + "Class"), node(RDFS + "Class")])),
    ),
    saying(
        some_property,
        [RDF_TYPE.value],
        st.one_of(
            some_class,
            st.sampled_from(
                [
                    node(OWL + kind + "Property")
                    for kind in ("Object", "Datatype", "Symmetric", "Transitive", "Functional")
                ]
            ),
        ),
    ),
    saying(some_property, [OWL + "inverseOf"], some_property),
    saying(some_class, [OWL + "disjointWith"], some_class),
    saying(some_individual, [OWL + "sameAs"], some_individual),
    saying(some_individual, ["p0", "p1", "p2", "p3"], st.one_of(some_individual, some_class)),
    saying(some_individual, ["p0", "p1"], st.just(Literal("text"))),
    saying(some_class, [RDFS + "label", "remark"], st.just(Literal("text"))),
    saying(some_class | some_individual, ["remark", "note"], some_class | some_individual),
    restrictions(),
)
SAMENESS = st.one_of(
    saying(some_individual, [OWL + "sameAs"], some_individual),
    saying(some_individual, [OWL + "sameAs"], some_class | some_property),
    st.builds(
        lambda s, o, p: [
            Triple(node("q"), RDF_TYPE, node(OWL + "FunctionalProperty")),
            Triple(s, node("q"), o),
            Triple(s, node("q"), p),
        ],
        some_individual,
        some_individual,
        some_individual,
    ),
)


@given(st.lists(STATEMENTS, max_size=12).map(lambda parts: frozenset(chain(*parts))))
@settings(deadline=None, max_examples=60)
def test_the_closure_is_owlrls(asserted: frozenset[Triple]) -> None:
    def closed(how: Callable[[frozenset[Triple]], Set[Triple]]) -> Set[Triple] | None:
        try:
            return how(asserted) - asserted
        except OntologyError:  # a contradiction; owlrl names one of several
            return None

    assert closed(closure_of) == closed(owlrl_closure)


@given(
    st.lists(STATEMENTS, max_size=8).map(lambda parts: frozenset(chain(*parts))),
    st.lists(SAMENESS, min_size=1, max_size=2).map(lambda parts: frozenset(chain(*parts))),
)
@settings(deadline=None, max_examples=60)
def test_the_closure_is_owlrls_where_individuals_are_the_same(
    asserted: frozenset[Triple], same: frozenset[Triple]
) -> None:
    test_the_closure_is_owlrls.hypothesis.inner_test(asserted | same)  # type: ignore[attr-defined]


def test_a_chain_of_classes_closes_without_owlrl() -> None:
    """owlrl makes some 50 triples of what it gets here, and 45,000 of the chain."""
    names = [node(f"C{i}") for i in range(300)]
    chained = {Triple(lower, node(RDFS + "subClassOf"), upper) for lower, upper in pairwise(names)}
    separation = Separation(frozenset(chained | {Triple(node("a"), RDF_TYPE, names[0])}))
    assert separation.plain == set(names)
    assert not separation.rest
    found = separation.merge_closure(())
    assert found is not None
    assert len(found) == 300 * 299 // 2 + 300


@pytest.mark.parametrize(
    "told",
    [
        [("a", OWL + "sameAs", "a2")],
        [("p", RDF_TYPE.value, OWL + "FunctionalProperty"), ("b", "p", "a"), ("b", "p", "a2")],
    ],
)
def test_a_chain_of_classes_beside_individuals_that_are_the_same(
    told: list[tuple[str, str, str]],
) -> None:
    names = [node(f"C{i}") for i in range(100)]
    chained = {Triple(lower, node(RDFS + "subClassOf"), upper) for lower, upper in pairwise(names)}
    beside = {triple(*each) for each in told} | {Triple(node("a"), RDF_TYPE, names[0])}
    separation = Separation(frozenset(chained | beside))
    assert separation.plain == set(names)
    found = separation.merge_closure(owlrl_closure(separation.rest))
    assert found is not None
    kinds = {each.object for each in found if each.subject == node("a2")}
    assert kinds >= set(names)


def test_a_class_that_is_the_same_as_another_is_seen_by_owlrl() -> None:
    names = [node(f"C{i}") for i in range(4)]
    chained = {Triple(lower, node(RDFS + "subClassOf"), upper) for lower, upper in pairwise(names)}
    separation = Separation(frozenset(chained | {triple("C1", OWL + "sameAs", "D")}))
    assert separation.merge_closure(owlrl_closure(separation.rest)) is None
