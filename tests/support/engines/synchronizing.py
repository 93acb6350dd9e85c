"""A unit at work that makes one stream of several, object by object."""

from dyknow.converters.objects import ObjectTable
from dyknow.engine.model.views import Since
from dyknow.engine.units.synchronization import (
    SynchronizationUnit,
    TakenField,
    schema_of,
)
from dyknow.ontology.units import Conversion
from dyknow.rdf.dictionary import TermDictionary
from dyknow.rdf.namespaces import DYKNOW
from dyknow.streams.generator import StreamGenerator

SAME = Conversion(1.0)


def taken(*fields):
    """Fields by name, or as (source field, target field, conversion)."""
    return [TakenField(*((f, f, SAME) if isinstance(f, str) else f)) for f in fields]


def broken(unit):
    raise AssertionError(unit.failure)


def unit(
    inputs, ports, keys, ids=(), namespaces=None, since=Since.NOW, until=None, on_failure=broken
):
    """A unit at work, with an output made as its caller does."""
    schema, pools = schema_of(inputs, ports, keys, ids)
    dictionary = TermDictionary()
    made = SynchronizationUnit(
        "cu1",
        "synchronize",
        inputs,
        StreamGenerator("out", schema, pools=pools),
        {},
        on_failure,
        ports=ports,
        keys=keys,
        id_fields=ids,
        objects=lambda source: ObjectTable(dictionary, (namespaces or {}).get(source.name, DYKNOW)),
    )
    made.start(since, until=until)
    return made
