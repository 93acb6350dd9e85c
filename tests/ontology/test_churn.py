"""A store that is changed without end: another one takes its place, with the same quads."""

from __future__ import annotations

from itertools import pairwise

import pytest
from pyoxigraph import Literal, NamedNode, Quad, Store

from dyknow.ontology import churn, replicas
from dyknow.ontology.churn import Churn, weight
from dyknow.ontology.ontology import Ontology
from dyknow.ontology.replicas import ChangeLog
from dyknow.rdf.namespaces import DYKNOW

P = NamedNode("urn:p")


def quad(number: int) -> Quad:
    return Quad(NamedNode(f"urn:s{number}"), P, NamedNode("urn:o"))


def test_a_store_is_replaced_when_four_times_as_much_has_come_and_gone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(churn, "_LEAST", 10)
    store, changes = Store(), Churn()
    store.extend(quad(i) for i in range(20))
    replaced = []
    for number in range(20, 400):
        store.add(quad(number))
        store.remove(quad(number - 20))
        changes.note([quad(number)], [quad(number - 20)])
        then = changes.replace_if_due(store)
        if then is not store:
            replaced.append(number)
        assert set(then) == {quad(i) for i in range(number - 19, number + 1)}
        store = then
    # Of 20 quads more than 80 come or go between two of these.
    assert [later - one for one, later in pairwise(replaced)] == [41] * 8


def test_long_texts_count_as_many_quads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(churn, "_LEAST", 100)
    monkeypatch.setattr(replicas, "MOST", 100)
    long = [Quad(NamedNode("urn:s"), P, Literal(f"{n}" * 10_240)) for n in range(10)]
    assert weight(long) == 10 * 21
    store, changes, log = Store(), Churn(), ChangeLog()
    for number, each in enumerate(long):
        changes.note([each])
        assert (changes.replace_if_due(store) is store) == (number % 5 != 4)
        log.note({each}, set())
    assert log.since(log.position - 4) == (set(long[6:]), set())
    assert log.since(log.position - 5) is None


def test_what_comes_and_goes_of_templates_leaves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the store that continuous queries read: with each template its concept comes and goes."""
    ontology = Ontology.open()
    monkeypatch.setattr(churn, "_LEAST", 100)
    before = set(ontology.closed_store())
    stores = []
    for number in range(len(before)):
        ontology.registered.templates[f"{DYKNOW}E{number}"] = "text"
        del ontology.registered.templates[f"{DYKNOW}E{number}"]
        if not stores or ontology.closed_store() is not stores[-1]:
            stores.append(ontology.closed_store())
        if len(stores) == 3:
            break
    assert len(stores) == 3
    assert set(ontology.closed_store()) == before
