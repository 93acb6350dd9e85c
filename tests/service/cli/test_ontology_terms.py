"""`dyknow ontology add-feature` and `add-sort`: terms without a file of Turtle."""

from __future__ import annotations

import json
from typing import Any

import pytest

from dyknow.service.client.client import Client

OWN = "http://www.ida.liu.se/dyknow/ontology/"
TEMPERATURE = ("ontology", "add-feature", "temperature", "--unit", "degC", "--sort", "Robot")


def feature(client: Client, name: str) -> dict[str, Any] | None:
    return next((each for each in client.vocabulary()["features"] if each["name"] == name), None)


def test_a_feature_of_a_new_sort_can_be_annotated_at_once(dyknow: Any, client: Client) -> None:
    added = dyknow("ontology", "add-sort", "Robot", "--comment", 'drives "by itself"')
    assert added.stdout.strip() == "added dyknow:Robot, a dyknow:Thing"
    assert dyknow(*TEMPERATURE).stdout.strip() == (
        "added dyknow:temperature [degC] of dyknow:Robot"
    )
    assert feature(client, "dyknow:temperature") == {
        "name": "dyknow:temperature",
        "unit": "degC",
        "domain": "dyknow:Robot",
        "arity": 1,
        "doc": None,
    }
    client.put_stream("sensors", {"id": "string", "t": "float"})
    client.annotate("stream sensors contains temperature(Robot) = t [degF] for every Robot = id")
    assert client.match("dyknow:temperature", sort="dyknow:Robot")["found"] is True


def test_a_second_feature_keeps_the_first_and_a_repetition_is_no_error(
    dyknow: Any, client: Client
) -> None:
    dyknow("ontology", "add-sort", "Robot")
    dyknow("ontology", "add-sort", "Robot")
    dyknow(*TEMPERATURE)
    dyknow("ontology", "add-feature", "charge", "--unit", "percent", "--sort", "Robot")
    before = client.ontologies()
    dyknow(*TEMPERATURE)
    assert client.ontologies() == before
    assert {OWN + "sort-Robot", OWN + "feature-temperature", OWN + "feature-charge"} <= {*before}
    assert feature(client, "dyknow:temperature") is not None
    found = feature(client, "dyknow:charge")
    assert found is not None
    assert found["unit"] == "percent"
    # Another unit replaces the first: one feature has one unit.
    dyknow("ontology", "add-feature", "temperature", "--unit", "K", "--sort", "Robot")
    found = feature(client, "dyknow:temperature")
    assert found is not None
    assert found["unit"] == "K"


def test_a_term_of_another_namespace_and_one_without_unit(dyknow: Any, client: Client) -> None:
    iri = "<http://example.org/terms#mode>"
    found = json.loads(
        dyknow("ontology", "add-feature", iri, "--range", "xsd:string", "--json").stdout
    )
    assert found == {"name": "http://example.org/terms#mode"}
    mode = feature(client, iri)
    assert mode is not None
    assert (mode["unit"], mode["domain"]) == (None, "dyknow:Thing")
    carrier = ("ontology", "add-feature", "carrier", "--range", "Vehicle", "--sort", "UAV")
    assert dyknow(*carrier).stdout.strip() == (
        "added dyknow:carrier of dyknow:UAV, whose values are dyknow:Vehicle"
    )
    is_on = ("ontology", "add-feature", "isOn", "--range", "boolean")
    assert dyknow(*is_on).stdout.strip() == (
        "added dyknow:isOn of dyknow:Thing, whose values are xsd:boolean"
    )
    assert dyknow("ontology", "add-sort", "Rover", "--under", "Vehicle").stdout.strip() == (
        "added dyknow:Rover, a dyknow:Vehicle"
    )


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("add-feature", "temperature", "--unit", "degCC"), ("unknown unit 'degCC'",)),
        (("add-feature", "temperature", "--unit", "m/s"), ("write `m.s-1`",)),
        (("add-feature", "temperature", "--sort", "Robt"), ("no sort", "add-sort dyknow:Robt")),
        (("add-feature", "carrier", "--range", "Robt"), ("no sort dyknow:Robt",)),
        (("add-feature", "air temperature"), ("`air` is not a term",)),
        (("add-feature", "UAV"), ("dyknow:UAV", "sort")),
        (("add-feature", "speed", "--unit", "m.s-1"), ("dyknow:speed already", "km.h-1")),
        (("add-sort", "speed"), ("dyknow:speed", "feature")),
        (("add-sort", "Rover", "--under", "Vehicl"), ("no sort dyknow:Vehicl",)),
    ],
)
def test_what_is_refused(
    dyknow: Any, client: Client, arguments: tuple[str, ...], words: tuple[str, ...]
) -> None:
    before = client.ontologies()
    refused = dyknow("ontology", *arguments, status=1).stderr
    assert all(word in refused for word in words), refused
    assert client.ontologies() == before


def test_a_term_that_is_there_stays(dyknow: Any, client: Client) -> None:
    before = client.ontologies()
    done = dyknow("ontology", "add-feature", "speed", "--unit", "km.h-1")
    assert done.stdout.strip() == "dyknow:speed is there already"
    assert dyknow("ontology", "add-sort", "UAV").stdout.strip() == "dyknow:UAV is there already"
    assert client.ontologies() == before
