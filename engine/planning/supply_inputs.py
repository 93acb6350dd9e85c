"""The fields of streams that give a wanted feature, for units that read it by object."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ...matching.plan import Supply, SupplySource
from ...matching.subject import Sorts, Subject
from ...matching.want import THING, Want
from ...ontology.vocabulary import Vocabulary
from ...streams.generator import StreamGenerator
from ..configuration.configuration import Configuration
from ..units.merge import MergeInput, ObjectName


def merge_inputs(
    supply: Supply,
    streams: Sequence[StreamGenerator],
    configuration: Configuration,
    vocabulary: Callable[[], Vocabulary],
) -> list[MergeInput]:
    """Return the inputs of a merge for the sources of a supply and their ``streams``."""
    return [
        MergeInput(
            generator,
            source.port.source_field,
            source.port.conversion,
            tuple(
                ObjectName(role.object, role.id_field, configuration.namespaces[generator.name])
                for role in source.roles[: 1 + len(supply.want.others)]
            ),
            _filter(supply.want, source, vocabulary),
        )
        for source, generator in zip(supply.sources, streams, strict=True)
    ]


def _filter(
    want: Want, source: SupplySource, vocabulary: Callable[[], Vocabulary]
) -> Callable[[str], bool] | None:
    """Return a filter for the wanted objects; None if the source has no others."""
    if want.object is not None:
        return None
    role = source.roles[0]
    sorts = Sorts(vocabulary())
    if role.object is not None or sorts.within(role.sort or THING, want.wanted_sort):
        return None
    return lambda iri: Sorts(vocabulary()).belongs(Subject(None, iri), want.wanted_sort)
