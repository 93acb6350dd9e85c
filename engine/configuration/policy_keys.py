"""The key fields of a policy, by which it treats objects separately (SPEC §1, Policies).

Subscriptions, KPL and specifications all decide it here. A policy's unit asks once, when it is
made: a later annotation does not change the state that the unit has for each object.
"""

from __future__ import annotations

from ...languages.ssl.annotation import Content, id_fields
from ...streams.generator import StreamGenerator
from .configuration import POLICY, Configuration


def annotated_contents(configuration: Configuration, stream: str) -> tuple[Content, ...]:
    """Return the contents of a stream by its annotation. A stream of late samples has the
    annotation of its source."""
    source = configuration.late.source_of(stream)
    annotation = configuration.annotations.get(stream if source is None else source)
    return () if annotation is None else annotation.contents


def policy_keys(configuration: Configuration, source: StreamGenerator) -> tuple[str, ...]:
    """Return the id fields of ``source`` by its annotation: a policy holds for each of their
    objects. Without any it holds for the whole stream."""
    if not configuration.rules.separates_objects:
        return ()
    return id_fields(contents_before_policies(configuration, source))


def contents_before_policies(
    configuration: Configuration, source: StreamGenerator
) -> tuple[Content, ...]:
    """Return the contents of a stream by its annotation; of a policy's output those of its
    input."""
    while True:
        contents = annotated_contents(configuration, source.name)
        unit = configuration.units.get(source.name)
        if contents or unit is None or unit.transformation != POLICY:
            return contents
        source = unit.inputs[0]
