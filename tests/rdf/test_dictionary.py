"""Terms come and go; what somebody holds keeps its id and its meaning."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyoxigraph import Literal, NamedNode

from dyknow.rdf import dictionary as module
from dyknow.rdf.dictionary import (
    NO_TERM,
    ForgottenTerm,
    TermDictionary,
    TermTable,
)
from dyknow.rdf.terms_to_columns import from_terms
from dyknow.rdf.timed import Kind, ObjectColumn, TimedTriples, TripleRows


class Hand:
    """Holds what it is given."""

    def __init__(self, dictionary: TermDictionary) -> None:
        self.ids: list[int] = []
        dictionary.hold(self)

    def held_ids(self):
        yield np.array(self.ids, np.int32)


class Table(TermTable):
    """Remembers terms by id, as caches do."""

    def __init__(self, dictionary: TermDictionary) -> None:
        self.known: dict[int, object] = {}
        dictionary.follow(self)

    def forget(self, freed) -> None:
        assert not freed[NO_TERM]
        self.known = {id: term for id, term in self.known.items() if not freed[id]}


def node(number: int) -> NamedNode:
    return NamedNode(f"http://example.org/{number}")


@pytest.fixture
def at_once(monkeypatch):
    """A sweep is worth it however few terms there are."""
    monkeypatch.setattr(module, "SWEEP_FLOOR", 0)


def test_a_term_that_nobody_holds_is_forgotten_and_its_id_used_again(at_once) -> None:
    dictionary = TermDictionary()
    id = dictionary.transient_id(node(1))
    assert dictionary.collect() == 1
    assert (dictionary.count, len(dictionary)) == (0, 1)
    assert dictionary.find(node(1)) == NO_TERM
    with pytest.raises(ForgottenTerm):
        dictionary.term(id)
    assert dictionary.transient_id(node(2)) == id
    assert dictionary.term(id) == node(2)
    assert dictionary.reused == [id]


def test_a_pinned_term_stays_also_if_it_was_transient(at_once) -> None:
    dictionary = TermDictionary()
    id = dictionary.transient_id(node(1))
    assert dictionary.id(node(1)) == id
    dictionary.transient_id(node(2))
    assert dictionary.collect() == 1
    assert dictionary.term(id) == node(1)


def test_triples_hold_their_terms_while_they_are_kept(at_once) -> None:
    dictionary = TermDictionary()
    rows = [(1, node(1), node(2), Literal("a")), (1, node(1), node(2), Literal(5))]
    triples = from_terms(rows, dictionary)
    assert dictionary.collect() == 0
    assert list(triples) == rows
    del triples
    assert dictionary._sweep() == 3


def test_what_stands_under_a_null_is_not_held(at_once) -> None:
    dictionary = TermDictionary()
    subject, predicate, object = dictionary.transient_ids(map(node, (1, 2, 3))).tolist()
    times, null = np.zeros(2, np.int64), np.array([False, True])
    column = ObjectColumn(Kind.TERM, np.array([subject, 10**6], np.int32), null)
    rows = TripleRows(times, times, np.full(2, subject, np.int32), {predicate: column})
    triples = TimedTriples(dictionary, (rows,))
    assert dictionary.collect() == 1
    assert dictionary.find(node(3)) == NO_TERM != object
    assert len(triples) == 1


def test_few_terms_are_not_swept() -> None:
    dictionary = TermDictionary()
    dictionary.transient_ids(map(node, range(module.SWEEP_FLOOR - 1)))
    assert dictionary.collect() == 0
    dictionary.transient_id(node(-1))
    assert dictionary.collect() == module.SWEEP_FLOOR


def test_sweeps_wait_until_there_are_twice_as_many_and_for_what_they_look_at() -> None:
    dictionary = TermDictionary()
    hand = Hand(dictionary)
    hand.ids = dictionary.transient_ids(map(node, range(2 * module.SWEEP_FLOOR))).tolist()
    assert dictionary.collect() == 0
    swept = 0
    for number in range(2 * module.SWEEP_FLOOR, 5 * module.SWEEP_FLOOR):
        dictionary.transient_id(node(number))
        swept += dictionary.collect() > 0
    assert (swept, dictionary.count) == (1, 3 * module.SWEEP_FLOOR)
    hand.ids *= 64  # a sweep has more to look at
    dictionary.transient_ids(map(node, range(5 * module.SWEEP_FLOOR, 6 * module.SWEEP_FLOOR)))
    assert dictionary.collect() > 0
    dictionary.transient_ids(map(node, range(6 * module.SWEEP_FLOOR, 8 * module.SWEEP_FLOOR)))
    assert dictionary.collect() == 0


STEPS = st.lists(
    st.tuples(
        st.sampled_from(("transient", "pin", "hold", "let go", "collect")), st.integers(0, 12)
    ),
    max_size=60,
)


@settings(max_examples=200)
@given(STEPS)
def test_an_id_never_changes_its_meaning_while_it_is_held(steps) -> None:
    """Against a dict of what is pinned and held."""
    dictionary = TermDictionary()
    hand, table = Hand(dictionary), Table(dictionary)
    meaning: dict[int, NamedNode] = {}
    pinned: dict[int, NamedNode] = {}
    for step, number in steps:
        match step:
            case "transient":
                id = dictionary.transient_id(node(number))
                table.known[id] = node(number)
                assert dictionary.term(id) == node(number)
            case "pin":
                pinned[dictionary.id(node(number))] = node(number)
            case "hold":
                id = dictionary.transient_id(node(number))
                hand.ids.append(id)
                meaning[id] = node(number)
            case "let go" if hand.ids:
                gone = hand.ids.pop(number % len(hand.ids))
                if gone not in hand.ids:
                    del meaning[gone]
            case "collect":
                dictionary._sweep()
                assert dictionary.count == len(meaning | pinned)
        for id, term in (meaning | pinned | table.known).items():
            assert dictionary.term(id) == term
            assert dictionary.find(term) == id
    assert len(dictionary) <= 13
