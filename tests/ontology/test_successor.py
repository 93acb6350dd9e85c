"""What is made beside an ontology in use, and takes its place: it is what would have come of
loading the text at once, whatever changed meanwhile."""

from __future__ import annotations

import threading
import traceback
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyoxigraph import NamedNode, Store, Triple

from dyknow.ontology import replicas, successor
from dyknow.ontology.errors import OntologyError
from dyknow.ontology.ontology import Ontology
from dyknow.ontology.quad_store import QuadStore
from dyknow.ontology.reasoning import DIRECT
from dyknow.ontology.vocabulary import Vocabulary
from dyknow.rdf.namespaces import DYKNOW, RDF_TYPE, STREAM_SPACE

SHIPS = f"""@prefix : <{STREAM_SPACE}> .
@prefix dyknow: <{DYKNOW}> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
dyknow:Ship a owl:Class ; rdfs:subClassOf dyknow:Vehicle . dyknow:s1 a dyknow:Ship .
:hasInput rdfs:subPropertyOf :reads . dyknow:Alarm rdfs:subClassOf dyknow:Warning ."""
FLEET = SHIPS.replace("Ship", "Boat").replace("s1", "b1")


def own(name: str) -> NamedNode:
    return NamedNode(STREAM_SPACE + name)


class Change:
    """Something that is done to an ontology, by number."""

    def __init__(self, kind: int, number: int) -> None:
        self.kind, self.number = kind, number

    def __repr__(self) -> str:
        return f"Change({self.kind}, {self.number})"

    def make(self, ontology: Ontology) -> None:
        name = f"{DYKNOW}e{self.number}"
        reads = Triple(own(f"u{self.number}"), own("hasInput"), own(f"s{self.number}"))
        typed = Triple(own(f"u{self.number}"), RDF_TYPE, own("ComputationalUnit"))
        match self.kind:
            case 0:
                ontology.registered.templates[name] = f"text {self.number}"
            case 1 if name in ontology.registered.templates:
                del ontology.registered.templates[name]
            case 2:
                ontology.registered.annotations[f"s{self.number}"] = "said"
            case 3:
                ontology.mirror([reads, typed], [])
            case 4:
                ontology.mirror([], [reads])
            case 5:
                ontology.registered.queries[f"q{self.number}"] = "{}"
            case 6:
                ontology.registered.set_kpl(f"source float s{self.number}" if self.number else "")


changes = st.lists(st.builds(Change, st.integers(0, 6), st.integers(0, 2)), max_size=6)


def triples(store: Store) -> set[str]:
    return set(map(str, store))


def make(ontology: Ontology, wanted: Iterable[Change]) -> None:
    for change in wanted:
        change.make(ontology)


@settings(max_examples=25, deadline=None)
@given(before=changes, meanwhile=changes, after=changes, again=st.booleans())
def test_what_is_taken_is_what_would_have_come_at_once(
    before: list[Change], meanwhile: list[Change], after: list[Change], again: bool
) -> None:
    here, twin = Ontology.open(), Ontology.open()
    for ontology in (here, twin):
        make(ontology, before)
        ontology.closed_store()
        if again:
            ontology.load(FLEET, name="urn:ships")
        prepared = ontology.prepare(SHIPS, name="urn:ships")
        make(ontology, meanwhile)
        assert prepared.successor is not None
        ontology.install(prepared if ontology is here else replace(prepared, successor=None))
        make(ontology, after)
    assert here.quads() == twin.quads()
    assert triples(here.closed_store()) == triples(twin.closed_store())
    assert triples(here.closed_store()) == triples(Ontology.from_quads(here.quads()).closed_store())
    assert here.version == twin.version
    assert here.vocabulary.sorts() == twin.vocabulary.sorts()
    assert here.vocabulary.events() == twin.vocabulary.events()


def test_taking_it_reads_nothing_that_was_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """The rooms of the ontology are looked through once, and not while everybody waits."""
    ontology = Ontology.open()
    prepared = ontology.prepare(SHIPS, name="urn:ships")

    def never(*given: object) -> None:
        raise AssertionError("it is made anew")

    monkeypatch.setattr(Vocabulary, "from_triples", never)
    monkeypatch.setattr(Ontology, "_reload", never)
    monkeypatch.setattr(QuadStore, "graph", never)
    monkeypatch.setattr(Ontology, "_ontology_triples", never)
    ontology.install(prepared)
    assert ontology.vocabulary.is_sort(DYKNOW + "Ship")
    assert ontology.closed_store().query(f"ASK {{ <{DYKNOW}s1> a <{DYKNOW}Vehicle> }}")


def test_where_too_much_has_changed_it_is_made_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    ontology = Ontology.open()
    prepared = ontology.prepare(SHIPS, name="urn:ships")
    monkeypatch.setattr(replicas, "MOST", 3)
    ontology.registered.templates[DYKNOW + "Alarm"] = "text"
    ontology.install(prepared)
    assert ontology.vocabulary.is_sort(DYKNOW + "Ship")
    assert ontology.query(f"ASK {{ <{DYKNOW}Alarm> <{STREAM_SPACE}hasTemplate> 'text' }}")


def test_nobody_waits_for_what_is_prepared(monkeypatch: pytest.MonkeyPatch) -> None:
    ontology = Ontology.open()
    waited = []

    def beside() -> None:
        change = threading.Thread(
            target=ontology.mirror, args=([Triple(own("s"), RDF_TYPE, own("Stream"))], [])
        )
        change.start()
        change.join(120)
        waited.append(change.is_alive())

    def noted(work: object) -> object:
        def done(*given: object) -> object:
            beside()
            return work(*given)  # type: ignore[operator]

        return done

    monkeypatch.setattr(successor, "Rules", noted(successor.Rules))
    monkeypatch.setattr(Ontology, "_asserted_triples", noted(Ontology._asserted_triples))
    ontology.install(ontology.prepare(SHIPS, name="urn:ships"))
    assert waited == [False, False]
    assert ontology.query(f"ASK {{ <{STREAM_SPACE}s> a <{STREAM_SPACE}Stream> }}")


def test_copies_are_made_anew_of_what_has_taken_its_place() -> None:
    ontology = Ontology.open()
    position = ontology.changes_since(None).position
    ontology.load(SHIPS, name="urn:ships")
    found = ontology.changes_since(position)
    assert found.dump is not None
    assert f"<{DYKNOW}Ship>".encode() in found.dump
    assert ontology.changes_since(found.position).dump is None


def test_only_one_of_two_that_were_prepared_together_is_taken() -> None:
    ontology = Ontology.open()
    first = ontology.prepare(SHIPS, name="urn:ships", reasoning=DIRECT)
    second = ontology.prepare(FLEET, name="urn:boats")
    ontology.install(first)
    with pytest.raises(OntologyError, match="meanwhile"):
        ontology.install(second)
    assert not ontology.vocabulary.is_sort(DYKNOW + "Boat")


def test_a_unit_that_is_none_is_told_before_anything_is_taken() -> None:
    text = f'<{DYKNOW}f> a <{STREAM_SPACE}UnaryFeature> ; <{STREAM_SPACE}hasUnit> "furlongs!" .'
    with pytest.raises(OntologyError, match="the unit of"):
        Ontology.open().prepare(text, name="urn:units")


def test_an_error_of_another_thread_keeps_nothing_that_was_made_there() -> None:
    """pyoxigraph's iterators are dropped where they were made only; else what they read stays."""
    text = f'<{DYKNOW}f> a <{STREAM_SPACE}UnaryFeature> ; <{STREAM_SPACE}hasUnit> "furlongs!" .'
    ontology = Ontology.open()
    with ThreadPoolExecutor(1) as elsewhere:
        error = elsewhere.submit(ontology.prepare, text, name="urn:units").exception()
    assert isinstance(error, OntologyError)
    kept: set[int] = set()
    each: BaseException | None = error
    found = []
    while each is not None and id(each) not in kept:
        kept.add(id(each))
        for frame, _ in traceback.walk_tb(each.__traceback__):
            found += [type(value).__name__ for value in frame.f_locals.values()]
        each = each.__cause__ or each.__context__
    assert "Ontology" in found
    assert "QuadIter" not in found
