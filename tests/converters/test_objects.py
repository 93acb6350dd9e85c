"""Names of objects (tests/laws has their laws): what is remembered of them."""

from dyknow.converters.objects import _known_name, object_name
from dyknow.rdf.namespaces import DYKNOW


def test_of_long_names_nothing_is_remembered() -> None:
    _known_name.cache_clear()
    long = "x" * 1000
    assert object_name(f"{DYKNOW}{long}", DYKNOW) == long
    assert _known_name.cache_info().currsize == 0
    assert object_name(f"{DYKNOW}short", DYKNOW) == "short"
    assert _known_name.cache_info().currsize == 1
