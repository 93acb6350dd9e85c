"""What is remembered of an object, for as long as there is one."""

from __future__ import annotations

import gc
import weakref

from dyknow.engine.results import _form
from dyknow.languages.attached import attached
from dyknow.languages.csparql.ast import Form
from dyknow.languages.csparql.syntax import translated
from dyknow.ontology.ontology import Ontology
from dyknow.templates.patterns import patterns
from dyknow.templates.places import places


class Thing:
    pass


def test_it_is_asked_once_for_the_same() -> None:
    asked = []

    @attached
    def work(thing: Thing, number: int) -> int:
        asked.append(number)
        return number + 1

    one, other = Thing(), Thing()
    assert [work(one, 1), work(one, 1), work(other, 1), work(one, 1)] == [2, 2, 2, 2]
    assert asked == [1, 1]
    # For what was asked last.
    assert [work(one, 2), work(one, 2), work(one, 1)] == [3, 3, 2]
    assert asked == [1, 1, 2, 1]


def test_nothing_is_remembered_of_what_is_gone() -> None:
    @attached
    def work(thing: Thing, number: int) -> int:
        return number

    things = [Thing() for _ in range(3)]
    for number, thing in enumerate(things):
        assert work(thing, number) == number
    assert len(work) == 3
    del thing
    things.pop()
    assert len(work) == 2
    things.clear()
    assert len(work) == 0


def test_what_is_read_off_an_algebra_does_not_hold_it() -> None:
    text = "SELECT ?o (AVG(?v) AS ?mean) WHERE { ?o a <urn:S> ; <urn:p> ?v } GROUP BY ?o"
    query = translated.__wrapped__(text)  # type: ignore[attr-defined]
    root = weakref.ref(query.algebra)
    vocabulary = Ontology.open().vocabulary
    assert len(patterns(query.algebra)) == 2
    assert places(query.algebra, vocabulary)
    assert _form(query.algebra, Form.SELECT, text, vocabulary).schema.names
    del query
    gc.collect()
    assert root() is None
