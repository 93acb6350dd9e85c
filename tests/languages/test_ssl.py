"""SSL against the ontology: what an annotation says in IRIs ([Events14 §IV.A], SPEC §3)."""

import pytest
from vocabularies import vocabulary_of

from dyknow.languages.errors import LanguageError
from dyknow.languages.ssl import (
    Content,
    Role,
    StreamAnnotation,
    check_ssl,
    parse_ssl,
)
from dyknow.ontology.units import parse_unit
from dyknow.ontology.vocabulary import Vocabulary
from dyknow.rdf.namespaces import DYKNOW

ONTOLOGY = """
dyknow:UAV a owl:Class .
dyknow:uav1 a dyknow:UAV .
dyknow:speed a dyknow-o:Feature ; dyknow-o:hasUnit "km.h-1" .
dyknow:altitude a dyknow-o:Feature ; dyknow-o:hasUnit "ft" .
"""
FLEET = "http://example.org/fleet/"


@pytest.fixture
def vocabulary() -> Vocabulary:
    return vocabulary_of(ONTOLOGY)


def test_s6_is_a_condition_on_both_features(vocabulary: Vocabulary) -> None:
    text = """
    stream s6 contains altitude(uav1) = alt [ft],
      speed(uav1) = spd for uav1 = id
    """
    role = Role(None, DYKNOW + "uav1", "id")
    assert check_ssl(parse_ssl(text), text, vocabulary) == (
        StreamAnnotation(
            "s6",
            (
                Content(DYKNOW + "altitude", "alt", parse_unit("ft"), (role,)),
                # No unit is written, so it is the feature's own.
                Content(DYKNOW + "speed", "spd", parse_unit("km.h-1"), (role,)),
            ),
            text.strip(),
        ),
    )


def test_new_objects_live_in_the_namespace_of_the_stream(vocabulary: Vocabulary) -> None:
    text = "stream s contains speed(uav9) = a, altitude(uav1) = b"
    (annotation,) = check_ssl(parse_ssl(text), text, vocabulary, FLEET)
    assert isinstance(annotation, StreamAnnotation)
    # Features, sorts and known objects are found among the domain terms as well.
    assert [c.feature for c in annotation.contents] == [DYKNOW + "speed", DYKNOW + "altitude"]
    objects = [role.object for content in annotation.contents for role in content.roles]
    assert objects == [FLEET + "uav9", DYKNOW + "uav1"]


def test_one_id_field_may_condition_two_objects(vocabulary: Vocabulary) -> None:
    text = "stream s contains speed(uav1) = a, speed(uav2) = a for uav1 = id, uav2 = id"
    (annotation,) = check_ssl(parse_ssl(text), text, vocabulary)
    assert isinstance(annotation, StreamAnnotation)
    assert [c.roles[0].id_field for c in annotation.contents] == ["id", "id"]


def test_an_error_shows_the_place_in_the_whole_text(vocabulary: Vocabulary) -> None:
    text = "# first\nstream s contains speed(uav1) = a\nstream t contains speed(uav1) = b [ft]"
    with pytest.raises(LanguageError) as caught:
        check_ssl(parse_ssl(text), text, vocabulary)
    assert (caught.value.line, caught.value.column) == (3, 35)


def test_an_empty_text_declares_nothing(vocabulary: Vocabulary) -> None:
    assert check_ssl(parse_ssl(" # nothing\n"), "", vocabulary) == ()
