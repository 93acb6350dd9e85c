"""What is remembered of an object, for as long as there is one."""

from __future__ import annotations

import gc
import weakref

from pyoxigraph import Literal

from dyknow.continuous.algebra.expressions import Call, Const, Var
from dyknow.continuous.columns.expression_evaluation import (
    _split_foreign_call,
    foreign_calls,
)
from dyknow.converters.ndjson_lines import _decoder
from dyknow.engine.model.result_schema import _form
from dyknow.languages.object_cache import ObjectCache
from dyknow.ontology.ontology import Ontology
from dyknow.sparql import parse_sparql
from dyknow.streams.sample import Field, FieldType, Schema
from dyknow.templates.patterns import patterns
from dyknow.templates.places import places


class Thing:
    pass


def test_it_is_asked_once_for_the_same() -> None:
    asked = []

    @ObjectCache
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
    @ObjectCache
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


def test_what_is_read_off_a_query_does_not_hold_it() -> None:
    text = "SELECT ?o (AVG(?v) AS ?mean) WHERE { ?o a <urn:S> ; <urn:p> ?v } GROUP BY ?o"
    query = parse_sparql(text, {})
    root = weakref.ref(query)
    vocabulary = Ontology.open().vocabulary
    assert len(patterns(query)) == 2
    assert places(query, vocabulary)
    assert _form(query, vocabulary).schema.names
    del query
    gc.collect()
    assert root() is None


def test_what_is_read_off_an_expression_or_a_schema_does_not_hold_it() -> None:
    strange = Call("STRLEN", (Var("a"),))
    expression = Call("+", (strange, Const(Literal(1))))
    assert foreign_calls(expression) == (strange,)
    assert foreign_calls(strange) == (strange,)
    schema = Schema((Field("v", FieldType.FLOAT),))
    assert _decoder(schema) is not None
    known = len(_split_foreign_call), len(_decoder)
    gone = weakref.ref(expression), weakref.ref(schema)
    del expression, schema
    gc.collect()
    assert [each() for each in gone] == [None, None]
    assert (len(_split_foreign_call), len(_decoder)) == (known[0] - 1, known[1] - 1)
