"""The store: listings, domain ontologies, templates and what survives a restart."""

import subprocess
import sys
from pathlib import Path

import pytest
from pyoxigraph import Literal, NamedNode, Store, Triple

from dyknow.continuous.operators.background import Background
from dyknow.ontology.entailment.closure import shipped_closure
from dyknow.ontology.entailment.closure_key import closure_key
from dyknow.ontology.entailment.owlrl_closure import closure_of
from dyknow.ontology.errors import OntologyError, QueryRefused
from dyknow.ontology.ontology import Ontology
from dyknow.ontology.shipped_files import shipped_hashes, shipped_ontologies
from dyknow.rdf.namespaces import DYKNOW, OWL, RDF_TYPE, RDFS, STREAM_SPACE

LISTING_2 = """:dyknow_cul a :ComputationalUnit ;
  :hasInput :dyknow_stream1 ;
  :hasInput :dyknow_stream2 ;
  :hasOutput :dyknow_stream3 ;
  :instantiationOf :fusionRGBIR .
"""
LISTING_3 = """:fusionRGBIR a :Transformation ;
  :hasAnnotation [
    :hasOutputAnnotation [
      :describesFeature :ImagePosition ;
      :describesSort :Human
    ] ;
    :hasInputAnnotation [
      :describesFeature :RawRGBCam ;
      :describesSort :self ;
      :nextSegment [
        :hasInputAnnotation [
          :describesFeature
            :RawIRCam ;
          :describesSort :self
        ]
      ]
    ] ;
  ] ;
  :hasName "fusionRGBIR"^^string .
"""
EVENT = DYKNOW + "HighSpeedEvent"
SPEC_TERMS = """Stream ConstantStream Sample Transformation Implementation Parameter
    ComputationalUnit Source Sink StreamProcessingEngine Specification Annotation InputAnnotation
    OutputAnnotation DescriptionSequence Sort Feature UnaryFeature Event EventTemplate Policy Unit
    hasInput isInput hasOutput isOutput instantiationOf hasInstance hasSpecification hasAnnotation
    hasInputAnnotation hasOutputAnnotation describesFeature describesSort describesObject
    nextSegment hasName hasUnit hasCost hasQuality hasTemplate hasSubscriberCount""".split()  # noqa: SIM905


def own(name: str) -> NamedNode:
    return NamedNode(STREAM_SPACE + name)


def column(ontology: Ontology, query: str) -> set[str]:
    _, rows = ontology.query_rows(query)
    values = set()
    for (term,) in rows:
        assert isinstance(term, NamedNode | Literal)
        values.add(term.value)
    assert len(rows) == len(values)  # the default graph holds each triple once
    return values


@pytest.fixture(scope="module")
def plain() -> Ontology:
    """As shipped; tests that change something open their own."""
    return Ontology.open()


def test_the_closure_in_the_package_is_that_of_its_ontologies() -> None:
    shipped = shipped_closure(closure_key(shipped_hashes()))
    asserted = frozenset().union(*(ontology.triples() for ontology in shipped_ontologies()))
    again = "write it: python -m dyknow.ontology.entailment.owlrl_closure"
    assert shipped == closure_of(asserted), again
    assert shipped_closure("of other ontologies") is None


def test_each_ontology_in_memory_starts_as_the_first_did() -> None:
    """A process reads the shipped ontologies once (`Ontology.open`)."""
    first, other, third = Ontology(Store(), None), Ontology.open(), Ontology.open()
    assert other.quads() == first.quads()
    assert other.version == first.version
    tram = DYKNOW + "Tram"
    for ontology in (first, other):
        ontology.load(f"<{tram}> a <{OWL}Class> .", name="trams")
    assert other.quads() == first.quads()
    assert other.vocabulary.sorts() == first.vocabulary.sorts()
    assert first.vocabulary.is_sort(tram)
    assert not third.vocabulary.is_sort(tram)
    assert not Ontology.open().vocabulary.is_sort(tram)


def test_every_term_of_the_papers_is_there(plain: Ontology) -> None:
    triples = shipped_ontologies()[0].triples()
    defined = {t.subject.value for t in triples if isinstance(t.subject, NamedNode)}
    assert {STREAM_SPACE + term for term in SPEC_TERMS} <= defined
    assert column(plain, "SELECT ?s { :Sort owl:equivalentClass ?s FILTER(?s = owl:Thing) }")
    assert plain.query("ASK { :hasSpecification a owl:FunctionalProperty }")
    assert plain.query("ASK { <http://www.dyknow.eu/ontology> owl:versionIRI ?v }")


def test_listing_2_loads_as_printed_and_answers() -> None:
    ontology = Ontology.open()
    ontology.load(LISTING_2, name="listing2")
    streams = column(ontology, "SELECT ?s { ?s :isInput :dyknow_cul }")
    assert streams == {own("dyknow_stream1").value, own("dyknow_stream2").value}
    assert column(ontology, "SELECT ?s { ?s :isOutput :dyknow_cul }") == {
        own("dyknow_stream3").value
    }
    assert column(ontology, "SELECT ?u { :fusionRGBIR :hasInstance ?u }") == {
        own("dyknow_cul").value
    }
    assert column(ontology, "SELECT ?s { ?s a :Stream }") == {
        own(f"dyknow_stream{n}").value for n in (1, 2, 3)
    }


def test_listing_3_loads_as_printed_and_answers() -> None:
    ontology = Ontology.open()
    ontology.load(LISTING_3, name="listing3")
    consumed = column(
        ontology,
        """SELECT ?f { :fusionRGBIR :hasAnnotation ?a .
           ?a (:hasInputAnnotation/:nextSegment)*/:hasInputAnnotation ?i .
           ?i :describesFeature ?f }""",
    )
    assert consumed == {own("RawRGBCam").value, own("RawIRCam").value}
    produced = column(
        ontology,
        """SELECT ?f { :fusionRGBIR :hasAnnotation/:hasOutputAnnotation ?o .
           ?o :describesFeature ?f ; :describesSort :Human }""",
    )
    assert produced == {own("ImagePosition").value}
    assert column(ontology, "SELECT ?n { :fusionRGBIR :hasName ?n }") == {"fusionRGBIR"}
    assert ontology.vocabulary.is_feature(own("ImagePosition").value)
    assert ontology.vocabulary.is_sort(own("Human").value)
    assert not ontology.vocabulary.is_sort(own("self").value)


def test_the_vocabulary_of_the_domain(plain: Ontology) -> None:
    vocabulary = plain.vocabulary
    assert vocabulary.is_subsort(DYKNOW + "RMAX", DYKNOW + "UAV")
    assert vocabulary.is_subsort(DYKNOW + "Human", DYKNOW + "Thing")
    assert not vocabulary.is_subsort(DYKNOW + "Car", DYKNOW + "Aircraft")
    assert vocabulary.subsorts(DYKNOW + "UAV") == {DYKNOW + "UAV", DYKNOW + "RMAX"}
    assert vocabulary.superfeatures(DYKNOW + "xydist") == {
        DYKNOW + "xydist",
        DYKNOW + "distance",
    }
    speed = vocabulary.feature(DYKNOW + "speed")
    assert speed is not None
    assert speed.range == "http://www.w3.org/2001/XMLSchema#double"
    assert speed.domain == DYKNOW + "Thing"
    assert not vocabulary.is_sort(own("Stream").value)
    assert not vocabulary.is_feature(own("Stream").value)
    assert not vocabulary.is_object(DYKNOW + "uav1")
    assert vocabulary.suggest("sped", "feature") == ("speed",)
    assert vocabulary.feature("http://e.org/none") is None


def test_similar_names_of_another_namespace_are_iris() -> None:
    ontology = Ontology.open()
    heat = "@prefix o: <http://www.dyknow.eu/ontology#> . <http://e.org/#heat> a o:UnaryFeature ."
    ontology.load(heat, name="http://e.org/")
    assert ontology.vocabulary.suggest("heat", "feature") == ("<http://e.org/#heat>",)


@pytest.mark.parametrize("type", ["decimal", "double", "integer", "dateTime"])
def test_a_literal_that_is_no_value_is_refused(type: str) -> None:
    wrong = f'<urn:a> <urn:b> "abc"^^<http://www.w3.org/2001/XMLSchema#{type}> .'
    with pytest.raises(OntologyError, match="abc"):
        Ontology.open().load(wrong, name="urn:wrong")


def test_a_domain_ontology_adds_sorts_features_and_objects() -> None:
    ontology = Ontology.open()
    text = """@prefix owl: <http://www.w3.org/2002/07/owl#> .
    dyknow:Quadrotor a owl:Class ; rdfs:subClassOf dyknow:UAV .
    dyknow:q1 a dyknow:Quadrotor .
    dyknow:airSpeed a :UnaryFeature ; rdfs:subPropertyOf dyknow:speed .
    """
    before = ontology.version
    ontology.load(text, name="quads")
    assert ontology.version > before
    vocabulary = ontology.vocabulary
    assert DYKNOW + "Aircraft" in vocabulary.sorts_of(DYKNOW + "q1")
    assert vocabulary.is_object(DYKNOW + "q1")
    air_speed = vocabulary.feature(DYKNOW + "airSpeed")
    assert air_speed is not None
    assert air_speed.unit == vocabulary.feature(DYKNOW + "speed").unit  # type: ignore[union-attr]
    assert ontology.has_ontology(DYKNOW + "ontology/quads")
    assert ontology.has_ontology(DYKNOW + "ontology.rdf")
    assert not ontology.has_ontology("http://e.org/other")
    # Replaced: what only the old text said or entailed is gone.
    ontology.load("dyknow:q2 a dyknow:UAV .", name="quads")
    assert not ontology.vocabulary.is_sort(DYKNOW + "Quadrotor")
    assert not ontology.query("ASK { dyknow:q1 ?p ?o }")
    assert ontology.vocabulary.is_object(DYKNOW + "q2")


@pytest.mark.parametrize(
    ("format", "text"),
    [
        ("ntriples", f"<{DYKNOW}n1> <{RDF_TYPE.value}> <{DYKNOW}UAV> .\n"),
        ("jsonld", f'{{"@id": "{DYKNOW}n1", "@type": "{DYKNOW}UAV"}}'),
        (
            "rdfxml",
            '<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#" xmlns:d="'
            f'{DYKNOW}"><d:UAV rdf:about="{DYKNOW}n1"/></rdf:RDF>',
        ),
    ],
)
def test_other_formats_load(format: str, text: str) -> None:
    ontology = Ontology.open()
    ontology.load(text, name="n", format=format)  # type: ignore[arg-type]
    assert DYKNOW + "Vehicle" in ontology.vocabulary.sorts_of(DYKNOW + "n1")


@pytest.mark.parametrize(
    ("format", "text", "line", "message"),
    [
        ("turtle", "dyknow:a a dyknow:UAV .\ndyknow:b a dyknow:UAV ;; , .", 2, "line 2"),
        ("turtle", 'dyknow:f a :UnaryFeature ; :hasUnit "bananas" .', None, "bananas"),
        ("turtle", "dyknow:f a :UnaryFeature ; :hasArity 2 .", None, "several arities: 1, 2"),
        ("turtle", "dyknow:f a :Feature ; :hasArity 2.5 .", None, "no number from 0 to 99: '2.5'"),
        ("turtle", "dyknow:q owl:sameAs dyknow:r ; owl:differentFrom dyknow:r .", None, "contrad"),
        ("jsonld", '{"@context": "http://e.org/c", "@id": "http://e.org/a"}', None, "never"),
        (
            "rdfxml",
            '<!DOCTYPE r [<!ENTITY a "b">\n<!ENTITY c "&a;&a;">]><r/>',
            2,
            "entities",
        ),
        ("yaml", "a: b", None, "unknown format"),
    ],
)
def test_a_bad_ontology_is_refused_and_changes_nothing(
    plain: Ontology, format: str, text: str, line: int | None, message: str
) -> None:
    size, version = len(plain.store), plain.version
    with pytest.raises(OntologyError, match=message) as refusal:
        plain.load(text, name="bad", format=format)  # type: ignore[arg-type]
    assert refusal.value.line == line
    assert (len(plain.store), plain.version) == (size, version)
    assert not plain.has_ontology(DYKNOW + "ontology/bad")


def test_a_system_name_is_refused(plain: Ontology) -> None:
    with pytest.raises(OntologyError, match="reserved"):
        plain.load("", name="http://www.dyknow.eu/graphs/templates")


def test_imports_are_noted_not_fetched() -> None:
    ontology = Ontology.open()
    ontology.load("<> a owl:Ontology ; owl:imports <http://e.org/far> .", name="near")
    assert ontology.imports() == ("http://e.org/far",)


def test_templates_annotations_and_streams_survive_a_restart(tmp_path: Path) -> None:
    ontology = Ontology.open(tmp_path / "store")
    ontology.registered.templates[EVENT] = 'REGISTER TEMPLATE "one"'
    ontology.registered.templates[EVENT] = 'REGISTER TEMPLATE "two"\n'
    ontology.registered.annotations["s5"] = "stream s5 contains speed(UAV) = spd for every UAV = id"
    ontology.registered.streams["s5"] = '{"name": "s5"}'
    ontology.load("dyknow:q1 a dyknow:UAV .", name="mine")
    ontology.mirror([Triple(own("s5"), RDF_TYPE, own("Stream"))], [])
    del ontology
    again = Ontology.open(tmp_path / "store")
    assert again.registered.templates == {EVENT: 'REGISTER TEMPLATE "two"\n'}
    assert again.vocabulary.is_event(EVENT)
    assert again.vocabulary.is_object(DYKNOW + "q1")
    assert set(again.registered.annotations) == {"s5"}
    assert again.registered.streams == {"s5": '{"name": "s5"}'}
    assert not again.query("ASK { :s5 a :Stream }")
    text = column(again, "SELECT ?t { dyknow:HighSpeedEvent a :Event ; :hasTemplate ?t }")
    assert text == {'REGISTER TEMPLATE "two"\n'}
    del again.registered.templates[EVENT]
    del again.registered.annotations["s5"]
    del again.registered.streams["s5"]
    assert (
        again.registered.templates,
        again.registered.annotations,
        again.registered.streams,
    ) == ({}, {}, {})
    assert not again.query("ASK { dyknow:HighSpeedEvent ?p ?o }")
    assert not again.vocabulary.is_event(EVENT)
    with pytest.raises(KeyError):
        del again.registered.templates[EVENT]


def test_a_second_process_is_told_that_the_store_is_in_use(tmp_path: Path) -> None:
    program = (
        "import sys\nfrom pyoxigraph import Store\n"
        "store = Store(sys.argv[1]); print('open', flush=True); sys.stdin.read()"
    )
    holder = subprocess.Popen(
        [sys.executable, "-c", program, str(tmp_path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    with holder:
        assert holder.stdout is not None
        assert holder.stdout.readline().strip() == b"open"
        with pytest.raises(OntologyError, match="in use by another process"):
            Ontology.open(tmp_path)
        assert holder.stdin is not None
        holder.stdin.close()


def test_the_stream_space_is_mirrored_with_its_entailments() -> None:
    ontology = Ontology.open()
    unit = [
        Triple(own("u1"), RDF_TYPE, own("ComputationalUnit")),
        Triple(own("u1"), own("hasInput"), own("s1")),
        Triple(own("u1"), own("hasOutput"), own("s2")),
        Triple(own("u1"), own("instantiationOf"), own("t1")),
        *(Triple(own(s), own("hasName"), Literal(s)) for s in ("s1", "s2")),
    ]
    size, version = len(ontology.store), ontology.version
    ontology.mirror(unit, [])
    assert column(ontology, "SELECT ?u { :s1 :isInput ?u }") == {own("u1").value}
    assert column(ontology, "SELECT ?s { ?s a :Stream }") == {own("s1").value, own("s2").value}
    assert ontology.validate().conforms
    assert not ontology.closed_store().query("ASK { ?s a <http://www.dyknow.eu/ontology#Stream> }")
    ontology.mirror([], unit)
    assert len(ontology.store) == size
    assert ontology.version == version


def test_an_ill_formed_stream_space_is_reported() -> None:
    ontology = Ontology.open()
    ontology.mirror([Triple(own("u1"), own("hasOutput"), own(f"s{n}")) for n in (1, 2)], [])
    report = ontology.validate()
    assert not report.conforms
    assert "at most one output" in report.text
    assert "exactly one transformation" in report.text
    assert "one name" in report.text


def test_the_closed_store_changes_with_the_version() -> None:
    ontology = Ontology.open()
    first = ontology.closed_store()
    assert ontology.closed_store() is first
    assert first.query(f"ASK {{ <{DYKNOW}RMAX> <{SUBCLASS}> <{DYKNOW}Vehicle> }}")
    ontology.registered.templates[EVENT] = "text"
    assert ontology.closed_store().query(f"ASK {{ <{EVENT}> a <{STREAM_SPACE}Event> }}")
    del ontology.registered.templates[EVENT]
    assert not ontology.closed_store().query(f"ASK {{ <{EVENT}> ?p ?o }}")
    ontology.load(f"<{DYKNOW}Ship> a <http://www.w3.org/2002/07/owl#Class> .", name="urn:ships")
    assert ontology.closed_store().query(f"ASK {{ <{DYKNOW}Ship> a ?kind }}")


SUBCLASS = "http://www.w3.org/2000/01/rdf-schema#subClassOf"


def test_rows_are_those_of_a_select(plain: Ontology) -> None:
    table = plain.query_rows("SELECT ?u { dyknow:speed :hasUnit ?u }")
    assert table == (("u",), [(Literal("km.h-1"),)])
    with pytest.raises(QueryRefused, match="SELECT"):
        plain.query_rows("ASK {}")


def test_several_graphs_of_a_query_are_their_merge() -> None:
    ontology = Ontology.open()
    for name in ("one", "two"):
        ontology.load(f"<urn:a> <urn:p> 1 . <urn:a> <urn:p> <urn:{name}> .", name=f"urn:g:{name}")
    of_both = (
        "SELECT ?o FROM <urn:g:one> FROM <urn:g:two> FROM <urn:g:two> {clause} { <urn:a> ?p ?o }"
    )
    _, rows = ontology.query_rows(of_both.replace("{clause}", ""))
    assert sorted(str(term) for (term,) in rows) == [str(Literal(1)), "<urn:one>", "<urn:two>"]
    named = of_both.replace("{clause}", "FROM NAMED <urn:g:one>").replace(
        "<urn:a> ?p ?o", "GRAPH ?g { <urn:a> ?p ?o }"
    )
    _, rows = ontology.query_rows(named)
    assert sorted(str(term) for (term,) in rows) == [str(Literal(1)), "<urn:one>"]


def test_the_named_graphs_are_those_with_triples() -> None:
    ontology = Ontology.open()
    stated = "http://www.ida.liu.se/dyknow/ontology.rdf"
    assert {stated, "http://www.dyknow.eu/graphs/catalog"} < {*ontology.named_graphs()}
    templates = "http://www.dyknow.eu/graphs/templates"
    assert templates not in ontology.named_graphs()
    ontology.registered.templates[EVENT] = "text"
    assert templates in ontology.named_graphs()
    del ontology.registered.templates[EVENT]
    assert templates not in ontology.named_graphs()


def test_a_store_in_memory_is_made_anew_now_and_then() -> None:
    """Its quads are counted a few times only, however often the stream space changes."""
    ontology = Ontology.open()
    first = ontology.store
    size = len(first)
    name = Triple(own("s1"), own("hasName"), Literal("s1"))
    for _ in range(4 * size):
        ontology.mirror([name], [])
        ontology.apply_pending_piece()
        ontology.mirror([], [name])
        ontology.apply_pending_piece()
    assert ontology.store is not first
    ontology.mirror([name], [])
    assert len(ontology.store) == size + 2  # in its graph and in the default graph
    assert column(ontology, "SELECT ?n { :s1 :hasName ?n }") == {"s1"}


def test_a_deep_hierarchy_loads_with_marks_and_answers_for_all_its_pairs() -> None:
    """2,000 classes in a chain are 2 million pairs: no store has them
    (docs/reference/ontology.md)."""
    lines = ["dyknow:C0 a owl:Class ; rdfs:subClassOf dyknow:Vehicle ."]
    lines += [
        f"dyknow:C{i} a owl:Class ; rdfs:subClassOf dyknow:C{i - 1} ." for i in range(1, 2000)
    ]
    lines += ["dyknow:deep a dyknow:C1999 .", "dyknow:reading rdfs:range dyknow:C1999 ."]
    ontology = Ontology.open()
    before = len(ontology.store)
    ontology.load("\n".join(lines), name="deep")
    assert len(ontology.store) - before < 40_000
    lowest, top = f"{DYKNOW}C1999", f"{DYKNOW}C0"
    vocabulary = ontology.vocabulary
    assert vocabulary.is_subsort(lowest, top)
    assert len(vocabulary.subsorts(top)) == 2000
    assert NamedNode(top) in ontology.rules.above(NamedNode(lowest))
    assert top in vocabulary.sorts_of(f"{DYKNOW}deep")
    for text in (
        "dyknow:deep a dyknow:C0, dyknow:Vehicle",
        "dyknow:reading rdfs:range dyknow:C0",
        "dyknow:C1999 rdfs:subClassOf+ dyknow:C0",
        "dyknow:C1999 rdfs:subClassOf dyknow:C0, dyknow:Vehicle",
        "dyknow:C1999 ?includes dyknow:C0",
    ):
        assert ontology.query(f"ASK {{ {text} }}")
    assert column(ontology, "SELECT (COUNT(*) AS ?n) { ?n1 rdfs:subClassOf dyknow:C0 }") == {"1999"}
    static = Background(ontology.closed_store())
    sub_class = NamedNode(RDFS + "subClassOf")
    assert len(static.scan(None, sub_class, NamedNode(top))) == 1999
    assert static.scan(NamedNode(lowest), sub_class, NamedNode(top))


FIRST_VALIDATION = """
import gc
from types import FrameType
from dyknow.ontology.ontology import Ontology

gc.disable()
Ontology.open().validate()
frames = [each for each in gc.get_objects() if isinstance(each, FrameType)]
held = [type(value).__name__ for frame in frames for value in frame.f_locals.values()]
assert "Ontology" in held, "the test looks at the wrong frames"
assert "QuadIter" not in held
"""


def test_the_first_validation_leaves_no_iterator_of_the_store():
    """pyoxigraph reports an error if the garbage collector of another thread drops one. The import
    of pySHACL leaves the frames of its callers, so this is the first one of a process."""
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", FIRST_VALIDATION], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
