"""What is known of objects, against a definition over all samples one by one."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dyknow.converters.objects import object_iri, spellings
from dyknow.converters.wire import Incoming
from dyknow.engine.catalog.known_objects import KnownObjects
from dyknow.engine.engine import Engine
from dyknow.engine.model.views import StreamDeclaration
from dyknow.rdf.namespaces import DYKNOW, PREFIXES
from dyknow.streams.history import Retention
from dyknow.streams.sample import Field, FieldType, batch_from_rows
from dyknow.streams.time import SECOND

SSL = """stream a contains speed(UAV) = v, altitude(UAV) = h for every UAV = id
stream b contains speed(RMAX) = v for every RMAX = id
stream c contains speed(uav1) = v
stream d contains speed(Human) = v for every Human = number
stream e contains distance(Human, UAV) = v for every Human = one, UAV = two
stream f contains altitude(uav1) = h for uav1 = id"""
FIELDS = {
    "a": {"id": "string", "v": "float", "h": "float"},
    "b": {"id": "string", "v": "float"},
    "c": {"v": "float"},
    "d": {"number": "integer", "v": "float"},
    "e": {"one": "string", "two": "string", "v": "float"},
    "f": {"id": "string", "h": "float"},
}
ROLES: dict[str, list[tuple[str, str, list[tuple[str | None, str | None, str | None]]]]] = {
    "a": [("speed", "v", [("UAV", None, "id")]), ("altitude", "h", [("UAV", None, "id")])],
    "b": [("speed", "v", [("RMAX", None, "id")])],
    "c": [("speed", "v", [(None, "uav1", None)])],
    "d": [("speed", "v", [("Human", None, "number")])],
    "e": [("distance", "v", [("Human", None, "one"), ("UAV", None, "two")])],
    "f": [("altitude", "h", [(None, "uav1", "id")])],
}
"""Feature, field, and for each role sort, object and id field: as in `SSL`."""
names = st.sampled_from(["uav1", "dyknow:uav1", DYKNOW + "uav1", "uav2", "7", "a b", None])
values = st.none() | st.integers(0, 9).map(float)


@st.composite
def rows(draw: st.DrawFn) -> dict[str, list[tuple[int, dict[str, Any]]]]:
    """Rows of each stream, with the valid second."""
    kinds = {"string": names, "float": values, "integer": st.integers(6, 8)}
    return {
        stream: draw(
            st.lists(
                st.tuples(
                    st.integers(0, 5),
                    st.fixed_dictionaries({name: kinds[kind] for name, kind in fields.items()}),
                ),
                max_size=6,
            )
        )
        for stream, fields in FIELDS.items()
    }


def make(given_rows: dict[str, list[tuple[int, dict[str, Any]]]], kept: int = 100) -> Engine:
    engine = Engine()
    for stream, fields in FIELDS.items():
        schema = tuple(Field(name, FieldType(kind)) for name, kind in fields.items())
        retention = Retention(kept)
        engine.declare(StreamDeclaration(stream, schema, retention=retention))
    engine.annotate(SSL)
    for stream, each in given_rows.items():
        generator = engine.generator(stream)
        timed = [(at * SECOND, valid * SECOND, row) for at, (valid, row) in enumerate(each, 6)]
        batch = batch_from_rows(generator.schema, timed, generator.stream.pools)
        engine.publish(stream, Incoming(batch, False), 0)
        engine.end(stream)
    return engine


def defined(engine: Engine, iri: str) -> tuple[bool, set[str], list[tuple[Any, ...]]]:
    """Whether the object is known, by which sorts, and its newest values, row by row."""
    is_known, sorts, found = False, set(), []
    for stream, contents in ROLES.items():
        for feature, field, roles in contents:
            newest = None
            is_known |= any(object and DYKNOW + object == iri for _, object, _ in roles)
            for _, valid, row in engine.generator(stream).stream.all().rows():
                arguments = list(_arguments(row, roles))
                if None in arguments:
                    continue
                for (sort, _, _), argument in zip(roles, arguments, strict=True):
                    if argument == iri and sort is not None:
                        is_known = True
                        sorts.add(DYKNOW + sort)
                is_newer = newest is None or valid >= newest[0]
                if iri in arguments and row[field] is not None and is_newer:
                    newest = valid, row[field], tuple(arguments)
            if newest is not None:
                found.append((DYKNOW + feature, stream, *newest))
    return is_known, sorts, found


def _arguments(row: dict[str, Any], roles: list[Any]) -> Iterator[str | None]:
    for _, object, field in roles:
        named = None if field is None or row[field] is None else object_iri(str(row[field]), DYKNOW)
        if object is None:
            yield named
        elif field is None or named == DYKNOW + object:
            yield DYKNOW + object
        else:
            yield None


def known(objects: KnownObjects, iri: str) -> tuple[bool, set[str], list[tuple[Any, ...]]]:
    parts = [part for part in objects.of(iri) if part is not None]
    found = [value for _, each in parts for value in each]
    return (
        bool(parts),
        {sort for sorts, _ in parts for sort in sorts},
        [(one.content.feature, one.stream, one.valid, one.value, one.objects) for one in found],
    )


@settings(deadline=None, max_examples=20)
@given(given_rows=rows(), kept=st.sampled_from([2, 100]))
def test_all_that_is_known_is_what_the_samples_say(
    given_rows: dict[str, list[tuple[int, dict[str, Any]]]], kept: int
) -> None:
    engine = make(given_rows, kept)
    listed: dict[str, set[str]] = {}
    for part in engine.objects.all():
        for iri, sorts in part.items():
            listed.setdefault(iri, set()).update(sorts)
    for name in ("uav1", "uav2", "6", "7", "8", "a b", "nobody"):
        iri = object_iri(name, DYKNOW)
        is_known, sorts, found = defined(engine, iri)
        assert not engine.ontology.vocabulary.is_object(iri)
        assert known(engine.objects, iri) == (is_known, sorts, found)
        # A list also has objects of samples in which another argument has no value.
        assert is_known <= (iri in listed)
        assert sorts <= listed.get(iri, set())


@pytest.mark.parametrize("part", [1, 2, 1_000])
def test_parts_are_bounded_and_whole(monkeypatch: pytest.MonkeyPatch, part: int) -> None:
    monkeypatch.setattr("dyknow.engine.catalog.known_objects.PART", part)
    of_b = [(1, {"id": f"uav{i}", "v": 1.0}) for i in range(5)]
    engine = make({stream: of_b if stream == "b" else [] for stream in FIELDS})
    parts = list(engine.objects.all())
    assert max(map(len, parts)) <= max(part, 2)
    assert {DYKNOW + f"uav{i}" for i in range(5)} <= {iri for each in parts for iri in each}


@given(st.text(max_size=8), st.sampled_from(["", "dyknow:", DYKNOW, "http://x.org/", "urn:"]))
def test_every_spelling_of_an_object_is_found(text: str, prefix: str) -> None:
    for namespace in (DYKNOW, "http://x.org/", PREFIXES["owl"]):
        name = prefix + text
        iri = object_iri(name, namespace)
        assert name in spellings(iri, namespace)
        assert {object_iri(one, namespace) for one in spellings(iri, namespace)} == {iri}
