"""The vocabulary: a typed, immutable view of the closed ontology (SPEC §2).

Languages check names against it; matching reads sub-sorts and sub-features from it
([Introspection15 §4.3]). It is built when the ontology changes; each look-up is a dict access. IRIs
are strings here.
"""

from __future__ import annotations

import difflib
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from itertools import chain
from typing import Literal as OneOf
from typing import TypeAlias

from pyoxigraph import Literal, NamedNode, Triple

from ..rdf.namespaces import DYKNOW, OWL, RDF, RDFS, STREAM_SPACE, XSD, local_name
from .entailment.hierarchy import Hierarchy
from .errors import OntologyError
from .units import Unit, UnitError, parse_unit

NameKind: TypeAlias = OneOf["sort", "feature", "event", "any"]

THING = DYKNOW + "Thing"
_TYPE = RDF + "type"
_STANDARD = (RDF, RDFS, OWL, XSD)
_TOPS = frozenset({OWL + "Thing", STREAM_SPACE + "Sort"})
_CLASSES = (OWL + "Class", RDFS + "Class")
_SCHEMA = (
    OWL + "Ontology",
    RDF + "Property",
    OWL + "ObjectProperty",
    OWL + "DatatypeProperty",
    OWL + "AnnotationProperty",
    RDFS + "Datatype",
)
SELF = STREAM_SPACE + "self"
"""The object that the system is part of ([Introspection15 §4.3])."""
_SAME = OWL + "sameAs"
_MOST_ARITY = 99
_NO_NAMES: frozenset[str] = frozenset()
Links: TypeAlias = Mapping[str, frozenset[str]]


@dataclass(frozen=True, slots=True)
class FeatureInfo:
    """The ontology's statements about a feature.

    ``range`` and ``domain`` are the narrowest stated datatype or class IRI; ``unit`` is that of
    plain numbers (None: none is stated). Sub-features inherit all three. ``arity`` is the number of
    arguments if the ontology states it: its ``:hasArity``, and 1 of a `:UnaryFeature`. Sub-features
    do not inherit it.
    """

    iri: str
    range: str | None
    unit: Unit | None
    domain: str | None
    arity: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Vocabulary:
    """The sorts, features, events and objects of the closed ontology at ``version``.

    A *sort* is a class that belongs neither to the stream space nor to RDF. ``owl:Thing``,
    ``:Sort`` and ``dyknow:Thing`` (all equivalent) are sorts too. An *object* is an individual of a
    sort. An *event* is a concept of type ``:Event``; events are no features.
    """

    version: int
    _sorts: Links
    _subsorts: Links
    _features: Mapping[str, FeatureInfo]
    _superfeatures: Links
    _subfeatures: Links
    _objects: Links
    _events: frozenset[str]
    self_object: str = SELF
    """The object that ``self`` denotes: the one that the ontology declares ``owl:sameAs`` it, else
    `SELF`."""

    @classmethod
    def from_triples(cls, triples: Iterable[Triple]) -> Vocabulary:
        """Build the vocabulary of closed triples (asserted and entailed); the pairs of hierarchies
        may be missing.

        Raises `UnitError`, naming the feature, for a ``:hasUnit`` that is no unit, and
        `OntologyError` for a ``:hasArity`` that is no number or not the only one. Cost: linear in
        the triples, and that of the hierarchies.
        """
        return _read(_Index(triples))

    def with_events(self, events: Iterable[str], version: int) -> Vocabulary:
        """Return the vocabulary at a new version with these events added."""
        return replace(self, version=version, _events=self._events | frozenset(events))

    def is_sort(self, iri: str) -> bool:
        return iri in self._sorts

    def is_feature(self, iri: str) -> bool:
        return iri in self._features

    def is_event(self, iri: str) -> bool:
        return iri in self._events

    def is_object(self, iri: str) -> bool:
        return iri in self._objects

    def feature(self, iri: str) -> FeatureInfo | None:
        """Return range, unit and domain of a feature; None if ``iri`` is no feature."""
        return self._features.get(iri)

    def is_domain_sort(self, iri: str) -> bool:
        """Return whether ``iri`` is ``dyknow:Thing`` or a sort below it. The other tops mean the
        same as that one."""
        return iri == THING or (self.is_subsort(iri, THING) and not self.is_subsort(THING, iri))

    def supersorts(self, iri: str) -> frozenset[str]:
        """Return all sorts that contain the sort, with itself (only itself if it is unknown)."""
        return self._sorts.get(iri) or frozenset({iri})

    def subsorts(self, iri: str) -> frozenset[str]:
        """Return all sorts contained in the sort, with itself."""
        return self._subsorts.get(iri) or frozenset({iri})

    def is_subsort(self, sub: str, super: str) -> bool:
        """Return whether every ``sub`` is a ``super``: ``RMAX ⊑ UAV``. Every sort
        contains itself."""
        return super in self.supersorts(sub)

    def superfeatures(self, iri: str) -> frozenset[str]:
        """Return all features above the feature, with itself."""
        return self._superfeatures.get(iri) or frozenset({iri})

    def subfeatures(self, iri: str) -> frozenset[str]:
        """Return all features below the feature, with itself."""
        return self._subfeatures.get(iri) or frozenset({iri})

    def agrees(self, other: Vocabulary, iri: str) -> bool:
        """Return whether ``other`` says the same of a term: its kind, what contains it, and the
        range, unit, domain and arity of a feature."""
        return (
            self._sorts.get(iri) == other._sorts.get(iri)
            and self._features.get(iri) == other._features.get(iri)
            and self._superfeatures.get(iri) == other._superfeatures.get(iri)
            and self._objects.get(iri) == other._objects.get(iri)
            and (iri in self._events) == (iri in other._events)
        )

    def has_members(self, sort: str) -> bool:
        """Return whether the ontology names an object of the sort. Cost: O(objects)."""
        return any(sort in sorts for sorts in self._objects.values())

    def sorts_of(self, object_iri: str) -> frozenset[str]:
        """Return every sort of an object; empty for an object that the ontology does not name."""
        return self._objects.get(object_iri, _NO_NAMES)

    def objects(self) -> Sequence[str]:
        return sorted(self._objects)

    def sorts(self) -> Sequence[str]:
        return sorted(self._sorts)

    def features(self) -> Sequence[str]:
        return sorted(self._features)

    def events(self) -> Sequence[str]:
        return sorted(self._events)

    def suggest(self, name: str, kind: NameKind = "any") -> tuple[str, ...]:
        """Return up to three names similar to ``name`` (an IRI or a local name), best first: local
        ones of ``dyknow:``, other IRIs in angle brackets."""
        names: set[str] = set()
        if kind in ("sort", "any"):
            names.update(self._sorts)
        if kind in ("feature", "any"):
            names.update(self._features)
        if kind in ("event", "any"):
            names.update(self._events)
        by_key = {local_name(iri).lower(): iri for iri in sorted(names)}
        near = difflib.get_close_matches(local_name(name).lower(), by_key, n=3)
        found = (by_key[key] for key in near)
        return tuple(
            iri.removeprefix(DYKNOW) if iri.startswith(DYKNOW) else f"<{iri}>" for iri in found
        )


class _Index:
    """Triples with named subjects, by predicate and subject."""

    def __init__(self, triples: Iterable[Triple]) -> None:
        self._objects: dict[str, dict[str, list[NamedNode | Literal]]] = defaultdict(
            lambda: defaultdict(list)
        )
        # Listing 3 attaches describesSort to blank nodes, so its objects are collected separately.
        self.described_sorts: set[str] = set()
        for triple in triples:
            object = triple.object
            if triple.predicate.value == STREAM_SPACE + "describesSort":
                if isinstance(object, NamedNode):
                    self.described_sorts.add(object.value)
            elif isinstance(triple.subject, NamedNode) and isinstance(object, NamedNode | Literal):
                self._objects[triple.predicate.value][triple.subject.value].append(object)

    def named_objects(self, predicate: str) -> dict[str, set[str]]:
        """Return subject -> named objects of ``predicate``."""
        return {
            subject: {o.value for o in objects if isinstance(o, NamedNode)}
            for subject, objects in self._objects.get(predicate, {}).items()
        }

    def hierarchy(self, of: str) -> Hierarchy[str]:
        """Return the hierarchy of classes or properties, by name."""
        inclusions = self.named_objects(f"{RDFS}sub{of}Of")
        equivalences = self.named_objects(f"{OWL}equivalent{of}")
        edges = [(lower, upper) for lower, uppers in inclusions.items() for upper in uppers]
        for one, others in equivalences.items():
            edges += [pair for other in others for pair in ((one, other), (other, one))]
        return Hierarchy(edges)

    def texts(self, predicate: str) -> dict[str, list[str]]:
        """Return subject -> literal texts of ``predicate``, sorted."""
        return {
            subject: sorted(o.value for o in objects if isinstance(o, Literal))
            for subject, objects in self._objects.get(predicate, {}).items()
        }


def _read(index: _Index) -> Vocabulary:
    types = index.named_objects(_TYPE)
    # The stream space's own terms are no domain terms, though Stream is an OWL class too.
    own = {
        subject
        for subject, definers in index.named_objects(RDFS + "isDefinedBy").items()
        if STREAM_SPACE.rstrip("#") in definers
    }

    def of_type(classes: Iterable[str]) -> set[str]:
        return {
            s for s, kinds in types.items() if not s.startswith(_STANDARD) and kinds & {*classes}
        }

    features = of_type([STREAM_SPACE + "Feature"]) - own
    events = of_type([STREAM_SPACE + "Event"]) - own
    superclasses = index.hierarchy("Class")
    kinds_of_feature = superclasses.inverse().above(STREAM_SPACE + "Feature")
    classes = of_type(_CLASSES) | (index.described_sorts - {SELF})
    sorts = (classes - own - features - events - kinds_of_feature) | _TOPS
    tops = {sort for sort in sorts if sort in _TOPS or sort == THING}
    # A sort that only an annotation uses is under Thing like any other.
    within_tops = ((sort, top) for sort in sorts for top in tops)
    supersorts = Hierarchy(chain(superclasses.edges, within_tops))
    superfeatures = index.hierarchy("Property")
    # Instances of the stream space (a Stream, a Transformation) and schema terms are no objects.
    others = sorts | features | events | own | of_type(_SCHEMA) | of_type(own - _TOPS)
    objects = {
        subject: frozenset(kinds & sorts)
        for subject, kinds in types.items()
        if kinds & sorts and subject not in others and not subject.startswith(_STANDARD)
    }
    # `self` is a term of the stream space but also an object, of the sorts that the ontology
    # states. Objects that are the same as it are objects too.
    named = sorted(index.named_objects(_SAME).get(SELF, set()) - {SELF})
    for subject in (SELF, *named):
        objects[subject] = frozenset((types.get(subject, set()) & sorts) | tops)
    infos = _Infos(index, superclasses, superfeatures, features)
    return Vocabulary(
        0,
        _Links(supersorts, frozenset(sorts)),
        _Links(supersorts.inverse(), frozenset(sorts)),
        {feature: infos.info(feature) for feature in features},
        _Links(superfeatures, frozenset(features)),
        _Links(superfeatures.inverse(), frozenset(features)),
        objects,
        frozenset(events),
        named[0] if named else SELF,
    )


class _Infos:
    """The ranges, domains and units of features, the narrowest of each."""

    def __init__(
        self,
        index: _Index,
        superclasses: Hierarchy[str],
        superfeatures: Hierarchy[str],
        features: Set[str],
    ) -> None:
        self._types = index.named_objects(_TYPE)
        self._superclasses = superclasses
        self._superfeatures = superfeatures
        self._features = features
        self._ranges = index.named_objects(RDFS + "range")
        self._domains = index.named_objects(RDFS + "domain")
        self._units = index.texts(STREAM_SPACE + "hasUnit")
        self._arities = index.texts(STREAM_SPACE + "hasArity")

    def info(self, feature: str) -> FeatureInfo:
        return FeatureInfo(
            feature,
            self._narrowest(self._ranges.get(feature, set())),
            self._unit(feature),
            self._narrowest(self._domains.get(feature, set())),
            self._arity(feature),
        )

    def _arity(self, feature: str) -> int | None:
        texts = {text.lstrip("0") or "0" for text in self._arities.get(feature, [])}
        if STREAM_SPACE + "UnaryFeature" in self._types.get(feature, ()):
            texts.add("1")
        if len(texts) > 1:
            raise OntologyError(f"{feature} has several arities: {', '.join(sorted(texts))}")
        for text in texts:
            if text.isascii() and text.isdigit() and int(text[:9]) <= _MOST_ARITY:
                return int(text)
            raise OntologyError(f"the arity of {feature} is no number from 0 to 99: {text!r}")
        return None

    def _narrowest(self, classes: set[str]) -> str | None:
        """Return the class that contains no other of them; the first by name if there are
        several."""
        wider = {w for c in classes for w in self._superclasses.above(c) if w != c}
        # Of equivalent classes, which contain each other, dyknow:Thing or the first name wins.
        return min(classes - wider or classes, key=lambda c: (c != THING, c), default=None)

    def _depth(self, feature: str) -> int:
        """Return the number of features above the feature, with itself."""
        return len((self._superfeatures.above(feature) | {feature}) & self._features)

    def _unit(self, feature: str) -> Unit | None:
        # The feature itself has the most super-features, so it comes first.
        above = self._superfeatures.above(feature) & self._features & self._units.keys()
        nearest = sorted(above, key=lambda f: (-self._depth(f), f))
        for candidate in [feature, *nearest]:
            for text in self._units.get(candidate, []):
                try:
                    return parse_unit(text)
                except UnitError as error:
                    raise UnitError(f"the unit of {candidate}: {error}") from error
        return None


class _Links(Mapping[str, frozenset[str]]):
    """Maps each of ``names`` to those above it, with itself. Each value is computed on its first
    look-up: all pairs of a deep hierarchy would be millions."""

    def __init__(self, hierarchy: Hierarchy[str], names: frozenset[str]) -> None:
        self._hierarchy = hierarchy
        self._names = names
        self._read: dict[str, frozenset[str]] = {}

    def __getitem__(self, name: str) -> frozenset[str]:
        found = self._read.get(name)
        if found is None:
            if name not in self._names:
                raise KeyError(name)
            above = self._hierarchy.above(name) & self._names
            found = self._read[name] = above | {name}
        return found

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)
