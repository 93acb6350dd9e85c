"""A removed ontology stays removed over a restart, by the log and by a checkpoint."""

import pytest

from dyknow.engine.durability.commands import (
    Annotate,
    LoadOntology,
    RemoveOntology,
)
from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.engine.model.errors import OntologyInUse, Refused, UnknownOntology
from dyknow.journal.durability import Durability
from dyknow.languages.errors import LanguageError
from dyknow.ontology.errors import OntologyError

SHIPS = "http://example.org/ships"
TEXT = """@prefix dyknow: <http://www.ida.liu.se/dyknow/> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
dyknow:Ship a owl:Class ; rdfs:subClassOf dyknow:Vehicle ."""
ANNOTATION = "stream ais contains speed(Ship) = sog [kt] for every Ship = id"


def opened(path):
    return RecordedEngine(path, now=0, durability=Durability.WRITE)


def restarted(recorded, path):
    """Open the directory again, without a checkpoint of the last engine."""
    recorded.log.commit()
    recorded._directory.close()
    return opened(path)


@pytest.mark.parametrize("checkpoint", [None, "before", "after"])
def test_a_removal_holds_after_a_restart(tmp_path, checkpoint):
    first = opened(tmp_path)
    first.do(LoadOntology(TEXT, SHIPS))
    first.do(Annotate(ANNOTATION))
    with pytest.raises(OntologyInUse) as refused:
        first.do(RemoveOntology(SHIPS))
    assert refused.value.used_by == ("the annotation of stream ais",)
    first.do(Annotate(ANNOTATION.replace("Ship", "Vehicle")))
    if checkpoint == "before":
        first.checkpoint().write()
    first.do(RemoveOntology(SHIPS))
    if checkpoint == "after":
        first.checkpoint().write()
    quads = first.engine.ontology.quads()
    again = restarted(first, tmp_path)
    assert SHIPS not in again.engine.ontology.ontologies()
    assert again.engine.ontology.quads() == quads
    with pytest.raises(LanguageError, match="`Ship` is not a sort"):
        again.do(Annotate(ANNOTATION))
    with pytest.raises(UnknownOntology):
        again.do(RemoveOntology(SHIPS))
    again.do(LoadOntology(TEXT, SHIPS))
    again.do(Annotate(ANNOTATION))
    again.close()


def test_a_refused_removal_changes_nothing(tmp_path):
    first = opened(tmp_path)
    before = first.engine.ontology.quads()
    with pytest.raises(Refused):
        first.do(RemoveOntology("http://www.ida.liu.se/dyknow/ontology.rdf"))
    with pytest.raises(UnknownOntology):
        first.do(RemoveOntology(SHIPS))
    again = restarted(first, tmp_path)
    assert again.engine.ontology.quads() == before
    again.close()


def test_a_removal_that_was_prepared_beside_another_change_is_refused(tmp_path):
    engine = opened(tmp_path).engine
    engine.load_ontology(TEXT, name=SHIPS)
    prepared = engine.ontology.prepare_removal(SHIPS)
    engine.load_ontology(TEXT.replace("Ship", "Boat"), name="boats")
    with pytest.raises(OntologyError, match="meanwhile"):
        engine.take_removal(SHIPS, prepared)
    engine.remove_ontology(SHIPS)
    assert "http://www.ida.liu.se/dyknow/ontology/boats" in engine.ontology.ontologies()
