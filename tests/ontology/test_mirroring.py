"""The live stream space is brought into the store in pieces: whoever asks sees all of it."""

from __future__ import annotations

import copy
import threading
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyoxigraph import Literal, NamedNode, Triple

from dyknow.ontology import ontology as module
from dyknow.ontology.entailment.rules import Entailments
from dyknow.ontology.ontology import Ontology
from dyknow.ontology.quad_store import Changes, QuadStore
from dyknow.rdf.namespaces import RDF_TYPE, STREAM_SPACE


def own(name: str) -> NamedNode:
    return NamedNode(STREAM_SPACE + name)


def said(number: int) -> list[Triple]:
    unit = own(f"u{number % 3}")
    return [
        Triple(unit, RDF_TYPE, own("ComputationalUnit")),
        Triple(unit, own("hasInput"), own(f"s{number}")),
        Triple(unit, own("hasName"), Literal(f"u{number}")),
    ]


STREAMS = [Triple(own(f"s{number}"), RDF_TYPE, own("Stream")) for number in range(1000)]
Step = tuple[bool, int, bool]


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(st.booleans(), st.integers(0, 5), st.booleans()), max_size=12))
def test_when_it_is_brought_in_makes_no_difference(steps: list[Step]) -> None:
    lazy, eager = Ontology.open(), Ontology.open()
    for comes, number, advances in steps:
        for ontology in (lazy, eager):
            ontology.mirror(*(((), said(number))[:: -1 if comes else 1]))
        if advances:
            lazy.apply_pending_piece()
        assert len(eager.store) > 0
    assert lazy.quads() == eager.quads()


def test_what_comes_and_goes_again_is_not_waited_for() -> None:
    ontology = Ontology.open()
    ontology.mirror(STREAMS[:10], [])
    ontology.mirror([], STREAMS[:10])
    assert not ontology._pending
    ontology.mirror(STREAMS[:10], [])
    assert len(ontology.store)
    ontology.mirror(STREAMS[10:20], STREAMS[:10])
    ontology.mirror(STREAMS[:10], STREAMS[10:20])
    assert not ontology._pending


def test_changes_that_nobody_asks_for_do_not_pile_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_PIECE", 10)
    monkeypatch.setattr(module, "_MOST_PENDING", 100)
    ontology = Ontology.open()
    quads = len(ontology.store)
    for turn in range(40):
        for number in range(0, 200, 5):
            change = STREAMS[number : number + 5]
            ontology.mirror(*((), change)[:: 1 if turn % 2 else -1])
        assert len(ontology._pending) <= 105
    assert len(ontology.store) == quads


@pytest.mark.parametrize("turns", [1, 2, 3, 4])
def test_what_changes_while_it_is_brought_in_is_as_it_was_told_last(
    monkeypatch: pytest.MonkeyPatch, turns: int
) -> None:
    """One thread has taken what waits; another one tells of more before that is there."""
    ontology = Ontology.open()
    ontology.mirror(STREAMS[:1], [])
    update = Entailments.update

    def told_meanwhile(self: Entailments, *given: Any) -> Any:
        monkeypatch.setattr(Entailments, "update", update)
        for turn in range(turns):
            ontology.mirror(*(STREAMS[:1], ())[:: 1 if turn % 2 else -1])
        return update(self, *given)

    monkeypatch.setattr(Entailments, "update", told_meanwhile)
    ontology.apply_pending_piece()
    is_there = bool(ontology.query(f"ASK {{ {STREAMS[0]} }}"))
    assert is_there == (turns % 2 == 0)


LOOKS: dict[str, Callable[[Ontology], object]] = {
    "a query": lambda o: len(list(o.query("SELECT * { ?s a :Stream }"))),
    "all quads": lambda o: o.quads().count(
        b"ontology#Stream> <http://www.dyknow.eu/graphs/stream-"
    ),
    "the store": lambda o: len(
        list(o.store.quads_for_pattern(None, RDF_TYPE, own("Stream"), None))
    ),
    "a copy": lambda o: (o.changes_since(None).dump or b"").count(b"ontology#Stream> .\n"),
    "one that is brought up to date": lambda o: o.changes_since(1).added.count(b"Stream> .\n"),
    "a deep copy": lambda o: len(copy.copy(o)._pending),
}


@pytest.mark.parametrize("look", LOOKS)
def test_whoever_asks_sees_all_of_it(look: str) -> None:
    lazy, twin = Ontology.open(), Ontology.open()
    for ontology in (lazy, twin):
        ontology.mirror(STREAMS, [])
    while twin._pending:
        twin.apply_pending_piece()
    assert LOOKS[look](lazy) == LOOKS[look](twin)
    assert not lazy._pending


def test_who_tells_of_changes_does_not_wait_for_the_store(monkeypatch: pytest.MonkeyPatch) -> None:
    ontology = Ontology.open()
    made: list[int] = []
    apply = QuadStore.apply

    def noted(self: QuadStore, changes: Changes) -> None:
        made.append(sum(len(c.added) + len(c.removed) for c in changes.values()))
        apply(self, changes)

    monkeypatch.setattr(QuadStore, "apply", noted)
    ontology.mirror(STREAMS, [])
    assert made == []
    ontology.apply_pending_piece()
    # Each entails some more.
    assert 0 < made[0] <= 8 * module._PIECE
    ontology.mirror([], STREAMS)
    assert ontology.query("ASK { ?s a :Stream }") is not None
    # Of those that were there; the others came and went unseen.
    assert sum(made) <= 2 * 8 * module._PIECE


def test_nobody_waits_for_who_looks() -> None:
    """The thread that tells of changes goes on while another one has the store."""
    ontology = Ontology.open()
    ontology.mirror(STREAMS, [])
    done = threading.Event()

    def tell() -> None:
        ontology.mirror([Triple(own("x"), RDF_TYPE, own("Stream"))], [])
        ontology.apply_pending_piece()
        done.set()

    with ontology._lock:
        threading.Thread(target=tell).start()
        assert done.wait(120)
