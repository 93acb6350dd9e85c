"""A store that is changed without end: another one takes its place, with the same quads."""

from __future__ import annotations

from itertools import pairwise

import pytest
from pyoxigraph import NamedNode, Quad, Store

from dyknow.ontology import churn
from dyknow.ontology.churn import Churn
from dyknow.ontology.ontology import Ontology
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
        changes.note(2)
        then = changes.over(store)
        if then is not store:
            replaced.append(number)
        assert set(then) == {quad(i) for i in range(number - 19, number + 1)}
        store = then
    # Of 20 quads more than 80 come or go between two of these.
    assert [later - one for one, later in pairwise(replaced)] == [41] * 8


def test_what_comes_and_goes_of_templates_leaves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the store that continuous queries read: with each template its concept comes and goes."""
    ontology = Ontology.open()
    monkeypatch.setattr(churn, "_LEAST", 100)
    before = set(ontology.closed_store())
    stores = []
    for number in range(len(before)):
        ontology.set_template(f"{DYKNOW}E{number}", "text")
        ontology.remove_template(f"{DYKNOW}E{number}")
        if not stores or ontology.closed_store() is not stores[-1]:
            stores.append(ontology.closed_store())
        if len(stores) == 3:
            break
    assert len(stores) == 3
    assert set(ontology.closed_store()) == before
