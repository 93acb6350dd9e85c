"""The template library over the ontology ([Events14 §IV.B])."""

import pytest

from dyknow.languages.csparql import parse_argument, parse_template
from dyknow.languages.errors import LanguageError
from dyknow.matching.want import THING, Want
from dyknow.ontology.ontology import Ontology
from dyknow.rdf.namespaces import DYKNOW
from dyknow.templates.instantiate import instantiate
from dyknow.templates.library import (
    NoSuchTemplate,
    TemplateExists,
    TemplateLibrary,
    TemplateRefused,
    shipped_templates,
)

HIGH_SPEED = DYKNOW + "HighSpeedEvent"
LISTING_4 = next(text for text in shipped_templates() if "HighSpeedEvent" in text)


def template(name, where):
    return (
        f"REGISTER TEMPLATE dyknow:{name}(?o) COMPUTE EVERY 1s AS "
        "PREFIX dyknow: <http://www.ida.liu.se/dyknow/> "
        f"CONSTRUCT {{ ?o dyknow:speed ?v }} WHERE {{ {where} }} WINDOW [RANGE 5s STEP 1s]"
    )


@pytest.fixture
def library(ontology):
    return TemplateLibrary(ontology)


def test_a_template_is_kept_with_its_event(library, ontology):
    made = library.register(LISTING_4)
    assert made.name == HIGH_SPEED
    assert ontology.registered.templates[HIGH_SPEED] == LISTING_4
    assert ontology.vocabulary.is_event(HIGH_SPEED)
    assert library.names() == (HIGH_SPEED,)


def test_a_restart_finds_it(tmp_path):
    ontology = Ontology.open(tmp_path / "store")
    TemplateLibrary(ontology).register(LISTING_4)
    del ontology
    assert TemplateLibrary(Ontology.open(tmp_path / "store")).get("HighSpeedEvent").source == (
        LISTING_4
    )


@pytest.mark.parametrize(
    "name", ["HighSpeedEvent", "dyknow:HighSpeedEvent", HIGH_SPEED, f"<{HIGH_SPEED}>"]
)
def test_names(library, name):
    made = library.register(LISTING_4)
    assert library.get(name) == made
    assert library.remove(name) == made
    with pytest.raises(NoSuchTemplate):
        library.get(name)


def test_a_name_twice_changes_nothing(library, ontology):
    library.register(LISTING_4)
    tag = library.etag("HighSpeedEvent")
    other = LISTING_4.replace("5s", "9s")
    with pytest.raises(TemplateExists):
        library.register(other)
    assert library.etag("HighSpeedEvent") == tag
    library.register(other, replace=True)
    assert library.etag("HighSpeedEvent") != tag
    assert ontology.registered.templates[HIGH_SPEED] == other


def test_an_unknown_name_has_suggestions(library):
    library.register(LISTING_4)
    with pytest.raises(NoSuchTemplate) as caught:
        library.get("HighSpedEvent")
    assert caught.value.suggestions == ("dyknow:HighSpeedEvent",)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (template("E", "?o dyknow:sped ?v"), "dyknow:sped is neither"),
        (template("speed", "?o dyknow:speed ?v"), "dyknow:speed is a feature"),
        (template("UAV", "?o dyknow:speed ?v"), "dyknow:UAV is a sort"),
    ],
)
def test_refused_templates_change_nothing(library, ontology, text, message):
    with pytest.raises(TemplateRefused, match=message):
        library.register(text)
    assert ontology.registered.templates == {}
    assert library.names() == ()


def test_a_syntax_error_changes_nothing(library, ontology):
    with pytest.raises(LanguageError):
        library.register(LISTING_4.replace("WHERE {", "WHERE "))
    assert ontology.registered.templates == {}


def test_a_template_cannot_need_itself(library):
    library.register(template("E", "?o dyknow:speed ?v"))
    with pytest.raises(TemplateRefused, match="would need itself"):
        library.register(template("E", "?o dyknow:E ?v"), replace=True)


def test_an_event_is_needed_like_a_feature(library):
    library.register(LISTING_4)
    made = library.register(template("Both", "?o dyknow:HighSpeedEvent ?v"))
    assert library.needs(made.query).wants == (Want(HIGH_SPEED, THING, None),)


def test_properties_of_loaded_ontologies_are_static(library, ontology):
    text = template("E", "?o dyknow:owner ?w ; dyknow:speed ?v")
    with pytest.raises(TemplateRefused, match="dyknow:owner"):
        library.register(text)
    ontology.load("<http://e/o> <http://www.ida.liu.se/dyknow/owner> <http://e/w> .", name="owners")
    assert library.needs(library.register(text).query).wants[0].feature == DYKNOW + "speed"


def test_shipped_templates_register_and_run_with_the_ontology(library):
    for text in shipped_templates():
        made = library.register(text)
        assert library.needs(made.query).wants
    assert len(library.names()) == len(shipped_templates())


def test_arguments_are_bound_not_pasted(library):
    made = library.register(LISTING_4)
    query = instantiate(
        made,
        [parse_argument(text) for text in ("?o", "dyknow:UAV", "100")],
        library._ontology.vocabulary,
    )
    assert query.source == parse_template(LISTING_4).query.source
    assert "?threshold" in query.source
