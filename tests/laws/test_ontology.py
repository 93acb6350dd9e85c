"""The live stream space entails what OWL RL says, however it came to be."""

from functools import cache

from hypothesis import given, settings
from hypothesis import strategies as st
from pyoxigraph import Literal, NamedNode, Triple

from dyknow.ontology.closure import entailed
from dyknow.ontology.entailment import Entailments, Rules
from dyknow.rdf.namespaces import OWL, RDF_TYPE, RDFS, STREAM_SPACE

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
    return stated | entailed(stated)


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
    assert live.held == model
    assert live.current == seen
    # The slow twin: everything anew by owlrl, which says nothing new about schema terms.
    twin = entailed(schema() | model)
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
        assert live.held == model
        assert live.current == set().union(*map(rules.entail, model))
        assert live.current == (before - implied.removed) | implied.added
        assert not implied.added & before
        assert implied.removed <= before
