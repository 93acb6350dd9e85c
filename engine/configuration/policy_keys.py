"""The fields by which a policy tells objects apart (SPEC §1, Policies).

The one place that decides it, for subscriptions, KPL and specifications. A unit that keeps a policy
asks once, when it is made: a later annotation does not change what it keeps of each object.
"""

from __future__ import annotations

from ...languages.ssl.annotation import Content, id_fields
from ...streams.generator import StreamGenerator
from .configuration import POLICY, Configuration


def annotated_contents(configuration: Configuration, stream: str) -> tuple[Content, ...]:
    """What a stream contains by its annotation; one of late samples by that of their stream."""
    source = configuration.late.source_of(stream)
    annotation = configuration.annotations.get(stream if source is None else source)
    return () if annotation is None else annotation.contents


def policy_keys(configuration: Configuration, source: StreamGenerator) -> tuple[str, ...]:
    """The id fields for each of whose objects a policy on ``source`` holds by itself; none where it
    holds for the whole stream.

    They are those of the stream's annotation. What a policy makes contains what its input does.
    """
    if not configuration.rules.separates_objects:
        return ()
    while True:
        contents = annotated_contents(configuration, source.name)
        unit = configuration.units.get(source.name)
        if contents or unit is None or unit.transformation != POLICY:
            return id_fields(contents)
        source = unit.inputs[0]
