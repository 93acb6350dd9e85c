"""Tells the triples of a pattern apart: samples of features, sorts of objects, static triples
([Events14 §IV.A], SPEC §8).

A predicate that the ontology knows as a feature or event comes from streams. A feature of several
objects has a node, ``?a dyknow:xydist [ rdf:value ?d ; rdf:_2 ?b ]`` (docs/reference/ssl.md), whose
triples are of one sample.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final, TypeAlias

from pyoxigraph import BlankNode, Literal, NamedNode, Variable

from ...ontology.vocabulary import THING, Vocabulary
from ...rdf.namespaces import DYKNOW, RDF, RDF_TYPE, shorten
from ...sparql import ast as sparql
from ...sparql.ast import Triple, walk
from ..errors import LanguageError, Span
from ..hints import meant
from ..mtl.checked import Kind, kind_of

Term: TypeAlias = NamedNode | Literal | Variable
"""A place of a triple. A blank node is a variable whose name begins with `BLANK`."""
BLANK: Final = "_\u00b7"
_MEMBER: Final = re.compile(re.escape(RDF) + r"_([1-9][0-9]?)")
_VALUE: Final = NamedNode(RDF + "value")


@dataclass(frozen=True, slots=True)
class Reading:
    """A triple of streams, and those of its node. ``kind`` None: the ontology states no range.
    ``is_event``: of an event, whose samples may last."""

    feature: str
    is_event: bool
    arguments: tuple[Term, ...]
    value: Term
    kind: Kind | None
    span: Span


@dataclass(frozen=True, slots=True)
class Sorts:
    """``?c a dyknow:Company``."""

    subject: Term
    sort: str
    triple: Triple


@dataclass(frozen=True, slots=True)
class StaticTriple:
    triple: Triple


Read: TypeAlias = Reading | Sorts | StaticTriple


class TripleReader:
    """Reads triples by the vocabulary. ``is_static`` tells whether static graphs may contain a
    ``dyknow:`` predicate that is no feature."""

    def __init__(
        self, source: str, vocabulary: Vocabulary, is_static: Callable[[str], bool] | None
    ) -> None:
        self._source = source
        self._vocabulary = vocabulary
        self._is_static = is_static
        self._blanks: dict[BlankNode, Variable] = {}
        longest = max(map(len, re.findall(f"{BLANK[-1]}+", source)), default=0)
        self._names = (f"{BLANK}{BLANK[-1] * longest}{i}" for i in itertools.count(1))
        """Names that the text does not have."""

    def read(self, triples: sparql.Triples) -> tuple[Read, ...]:
        """Return the meaning of consecutive triples, in reading order. Raises `LanguageError`."""
        named = [self.named(triple) for triple in triples.triples]
        nodes: dict[Term, list[Triple]] = {}
        for triple in named:
            if _is_of_node(triple):
                nodes.setdefault(_term(triple.subject), []).append(triple)
        own = {
            triple.object
            for triple in named
            if triple.object in nodes and self._is_streamed(triple)
        }
        return tuple(
            self._read(triple, nodes if triple.object in own else {})
            for triple in named
            if not (_is_of_node(triple) and triple.subject in own)
        )

    def named(self, triple: Triple) -> Triple:
        """Return a triple with variables in place of blank nodes: each stands for any object or
        value, too."""
        return sparql.rewrite(triple, self._variable)

    def _variable(self, node: object) -> Variable | None:
        if not isinstance(node, BlankNode):
            return None
        if node not in self._blanks:
            self._blanks[node] = self._fresh()
        return self._blanks[node]

    def narrowest(self, classes: frozenset[str]) -> str:
        """Return the narrowest sort; the first by name if there are several."""
        supersorts = self._vocabulary.supersorts
        return min(sorted(classes), key=lambda sort: -len(supersorts(sort)), default=THING)

    def _read(self, triple: Triple, nodes: Mapping[Term, list[Triple]]) -> Read:
        predicate = triple.predicate
        if isinstance(predicate, Variable):
            raise self._error(
                f"the predicate {predicate} may be any feature, so its streams are not known",
                triple.span,
                "write the feature",
            )
        if not isinstance(predicate, NamedNode):
            for step in walk(predicate):
                if isinstance(step, NamedNode) and self._is_streamed(
                    replace(triple, predicate=step)
                ):
                    raise self._error(
                        f"{shorten(step.value)} is a feature, and a path has no samples",
                        triple.span,
                        "write a triple for each step",
                    )
            return StaticTriple(triple)
        if predicate == RDF_TYPE and isinstance(triple.object, NamedNode):
            return self._sort(triple, triple.object.value)
        if self._is_streamed(triple):
            return self._reading(triple, predicate.value, nodes.get(_term(triple.object)))
        if predicate.value.startswith(DYKNOW) and not (
            self._is_static is not None and self._is_static(predicate.value)
        ):
            near = self._vocabulary.suggest(predicate.value)
            raise self._error(
                f"{shorten(predicate.value)} is neither a feature nor another known term",
                triple.span,
                meant(near) or "add it to the ontology first: dyknow ontology add-feature",
            )
        return StaticTriple(triple)

    def _is_streamed(self, triple: Triple) -> bool:
        predicate = triple.predicate
        vocabulary = self._vocabulary
        return isinstance(predicate, NamedNode) and (
            vocabulary.is_feature(predicate.value) or vocabulary.is_event(predicate.value)
        )

    def _sort(self, triple: Triple, iri: str) -> Sorts | StaticTriple:
        vocabulary = self._vocabulary
        if vocabulary.is_sort(iri):
            return Sorts(_term(triple.subject), iri, triple)
        name = shorten(iri)
        if vocabulary.is_event(iri) or vocabulary.is_feature(iri):
            raise self._error(
                f"{name} is an event or a feature, and no sort",
                triple.span,
                f"write `?o {name} ?value`",
            )
        if iri.startswith(DYKNOW):
            near = meant(vocabulary.suggest(iri, "sort"))
            raise self._error(
                f"{name} is not a known sort", triple.span, near or "declare it in the ontology"
            )
        return StaticTriple(triple)

    def _reading(self, triple: Triple, feature: str, node: list[Triple] | None) -> Reading:
        if isinstance(triple.subject, Literal):
            raise self._error("a literal has no features", triple.span, "write an object before it")
        arguments: dict[int, Term] = {1: _term(triple.subject)}
        value = _term(triple.object) if node is None else None
        for part in node or ():
            assert isinstance(part.predicate, NamedNode)
            member = _MEMBER.fullmatch(part.predicate.value)
            place = 0 if member is None else int(member[1])
            if place in arguments or (not place and value is not None):
                which = "value" if not place else f"argument {place}"
                raise self._error(f"the {which} is named twice", part.span, "name it once")
            if place:
                arguments[place] = _term(part.object)
            else:
                value = _term(part.object)
        info = self._vocabulary.feature(feature)
        arity = None if info is None else info.arity
        count = max(arguments) if arity is None else arity
        name = shorten(feature)
        if arity is not None and (max(arguments) > arity or (node is None and arity > 1)):
            parts = " ; ".join(f"rdf:_{i} ?b{i}" for i in range(2, arity + 1))
            example = f"?a {name} [ rdf:value ?v ; {parts} ]" if parts else f"?a {name} ?v"
            objects = "one object" if arity == 1 else f"{arity} objects"
            raise self._error(f"{name} is of {objects}", triple.span, f"write `{example}`")
        kind = None if info is None or info.range is None else kind_of(info.range)
        if kind is None and info is not None and info.unit is not None:
            kind = Kind.NUMBER
        places = tuple(arguments.get(i) or self._fresh() for i in range(1, count + 1))
        return Reading(
            feature,
            self._vocabulary.is_event(feature),
            places,
            value or self._fresh(),
            kind,
            triple.span,
        )

    def _fresh(self) -> Variable:
        """Return a variable for what the text leaves open."""
        return Variable(next(self._names))

    def _error(self, message: str, span: Span, hint: str) -> LanguageError:
        return LanguageError(message, self._source, span, hint)


def _term(place: sparql.Place) -> Term:
    assert not isinstance(place, BlankNode), "`TripleReader.named` replaces them"
    return place


def _is_of_node(triple: Triple) -> bool:
    predicate = triple.predicate
    return (
        isinstance(triple.subject, Variable)
        and isinstance(predicate, NamedNode)
        and (predicate == _VALUE or _MEMBER.fullmatch(predicate.value) is not None)
    )
