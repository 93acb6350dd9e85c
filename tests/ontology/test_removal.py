"""Removing an ontology undoes loading it, in memory and on disk."""

from __future__ import annotations

from pathlib import Path

import pytest

from dyknow.ontology.ontology import Ontology
from dyknow.rdf.namespaces import DYKNOW

SHIPS = """dyknow:Ship a owl:Class ; rdfs:subClassOf dyknow:Vehicle .
dyknow:draught a :UnaryFeature ; rdfs:range xsd:double ; :hasUnit "m" .
dyknow:speed rdfs:label "fart"@sv .
dyknow:UAV rdfs:subClassOf dyknow:Drone . dyknow:Drone a owl:Class ."""


def opened(path: Path | None) -> Ontology:
    return Ontology.open(path)


@pytest.mark.parametrize("is_on_disk", [False, True])
def test_removing_undoes_loading(tmp_path: Path, is_on_disk: bool) -> None:
    ontology = opened(tmp_path / "store" if is_on_disk else None)
    before = ontology.quads()
    ontology.load(SHIPS, name="ships")
    assert ontology.vocabulary.is_sort(DYKNOW + "Ship")
    prepared = ontology.prepare_removal("ships")
    # The label of speed says nothing that another ontology would lose; UAV loses a super-sort.
    assert prepared.lost == {DYKNOW + name for name in ("Ship", "draught", "UAV", "Drone")}
    assert ontology.has_ontology(prepared.graph.value)
    ontology.install(prepared)
    assert ontology.quads() == before
    assert not ontology.vocabulary.is_sort(DYKNOW + "Ship")
    assert ontology.vocabulary.feature(DYKNOW + "draught") is None
    if is_on_disk:
        del ontology, prepared
        assert opened(tmp_path / "store").quads() == before


def test_a_loading_that_was_prepared_before_a_removal_is_refused() -> None:
    ontology = opened(None)
    ontology.load(SHIPS, name="ships")
    other = ontology.prepare("dyknow:Car rdfs:label 'bil'@sv .", name="cars")
    ontology.install(ontology.prepare_removal("ships"))
    with pytest.raises(ValueError, match="meanwhile"):
        ontology.install(other)
    assert ontology.loaded("cars") is None


def test_other_ontologies_that_refer_to_a_term() -> None:
    ontology = opened(None)
    ontology.load(SHIPS, name="ships")
    ontology.load("dyknow:Ferry rdfs:subClassOf dyknow:Ship .", name="ferries")
    ontology.load("dyknow:a dyknow:draught 2 .", name="facts")
    # The shipped ontology refers to UAV too, but describes it itself.
    prepared = ontology.prepare_removal("ships")
    assert DYKNOW + "UAV" in prepared.lost
    assert ontology.ontologies_naming(prepared.lost, prepared.graph) == (
        DYKNOW + "ontology/facts",
        DYKNOW + "ontology/ferries",
    )
