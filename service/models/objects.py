"""JSON models of objects and what is known of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from pydantic import BaseModel, Field

from ...engine.catalog.known_objects import KnownValue, Sorts
from ...ontology.units import format_unit
from ...ontology.vocabulary import Vocabulary
from ...rdf.namespaces import shorten
from ...streams.time import format_time

SORTS = "its sorts and those above them, the narrowest first"


class ListedObjectModel(BaseModel):
    """An object, and its sorts."""

    iri: str
    name: str = Field(description="the IRI shortened with a prefix, else in angle brackets")
    sorts: list[str] = Field(description=SORTS)


class ListedObjectsModel(BaseModel):
    """A page of objects in the order of their IRIs."""

    objects: list[ListedObjectModel]
    more: bool = Field(description="whether there are others after these")

    @classmethod
    def of(
        cls, found: Mapping[str, Sorts], vocabulary: Vocabulary, *, more: bool
    ) -> ListedObjectsModel:
        objects = [
            ListedObjectModel(iri=iri, name=shorten(iri), sorts=_ordered(sorts, vocabulary))
            for iri, sorts in found.items()
        ]
        return cls(objects=objects, more=more)


class KnownValueModel(BaseModel):
    """The newest value of a feature in a stream."""

    feature: str
    value: float | int | bool | str | None
    unit: str | None = Field(description="the unit of the value; null: none")
    of: list[str] = Field(description="the arguments of the feature: the object, and others")
    stream: str
    field: str
    valid: str
    available: str

    @classmethod
    def of_value(cls, known: KnownValue) -> KnownValueModel:
        return cls(
            feature=shorten(known.content.feature),
            value=known.value,
            unit=format_unit(known.content.unit) or None,
            of=[shorten(each) for each in known.objects],
            stream=known.stream,
            field=known.content.field,
            valid=format_time(known.valid),
            available=format_time(known.available),
        )


class ObjectModel(ListedObjectModel):
    """What is known of an object now."""

    features: list[KnownValueModel] = Field(
        description="by feature; of a feature in several streams the newest value first"
    )

    @classmethod
    def of(
        cls, iri: str, sorts: Sorts, values: Sequence[KnownValue], vocabulary: Vocabulary
    ) -> ObjectModel:
        ordered = sorted(
            values, key=lambda one: (one.content.feature, -one.valid, -one.available, one.stream)
        )
        return cls(
            iri=iri,
            name=shorten(iri),
            sorts=_ordered(sorts, vocabulary),
            features=[KnownValueModel.of_value(value) for value in ordered],
        )


def _ordered(sorts: Iterable[str], vocabulary: Vocabulary) -> list[str]:
    narrow = sorted(sorts, key=lambda sort: (-len(vocabulary.supersorts(sort)), sort))
    return [shorten(sort) for sort in narrow]
