"""What a chronicle reads: one source for each feature or event (SPEC §8).

Sources share their columns: ``object 1`` is the first object of each of them, ``number before`` the
value before of each whose values are numbers.
"""

from __future__ import annotations

from collections.abc import Iterator

from ....languages.chronicle.checked import Argument as Named
from ....languages.chronicle.checked import CheckedChronicle, Message, Variable
from ....languages.errors import LanguageError
from ....languages.mtl.checked import Kind, ObjectConstant
from ....ontology.vocabulary import THING, Vocabulary
from ....rdf.namespaces import shorten
from ..plans.query import Argument, Part, Source, SourceColumn, object_column


def chronicle_sources(
    chronicle: CheckedChronicle, source: str, vocabulary: Vocabulary
) -> tuple[Source, ...]:
    """Return what a chronicle reads, which does not depend on the values of its parameters. Raises
    `LanguageError` for a sort that no source can tell."""
    return tuple(ChronicleSources(chronicle, source, vocabulary).found.values())


class ChronicleSources:
    """One source for each feature or event, of the objects that all its messages have in common.
    A message of fewer objects has conditions. Raises `LanguageError` for a sort of a variable that
    no source has alone."""

    def __init__(self, chronicle: CheckedChronicle, source: str, vocabulary: Vocabulary) -> None:
        self._chronicle = chronicle
        self._fixed = dict(chronicle.fixed)
        self._vocabulary = vocabulary
        messages: dict[str, list[Message]] = {}
        for message in chronicle.messages():
            messages.setdefault(message.concept, []).append(message)
        self.found = {concept: self._source(each) for concept, each in messages.items()}
        self._check_sorts(source)

    def _source(self, messages: list[Message]) -> Source:
        uses = zip(*(each.arguments for each in messages), strict=True)
        arguments = tuple(self._common([self._argument(each) for each in use]) for use in uses)
        concept = messages[0].concept
        columns = [
            SourceColumn(object_column(i), Part.OBJECT, Kind.OBJECT, argument=i)
            for i, each in enumerate(arguments)
            if each.object is None
        ]
        kind = next((each.kind for each in messages if each.kind is not None), None)
        if kind is not None:
            columns.append(SourceColumn(value_column(kind), Part.VALUE, kind))
        if kind is not None and any(each.before is not None for each in messages):
            columns.append(SourceColumn(before_column(kind), Part.BEFORE, kind))
        return Source(shorten(concept), concept, arguments, tuple(columns))

    def _argument(self, argument: Named) -> Argument:
        match argument:
            case None:
                return Argument(THING)
            case ObjectConstant(iri):
                return Argument(None, iri)
            case Variable(name):
                return self.argument_of(name)

    def argument_of(self, name: str) -> Argument:
        """The objects that a variable may stand for."""
        sort = self._chronicle.variables[name].sort or THING
        return Argument(sort, self._fixed.get(name))

    def _common(self, uses: list[Argument]) -> Argument:
        """The objects of all uses: of the sort that has all their sorts."""
        if len(set(uses)) == 1:
            return uses[0]
        sorts = {each.sort or THING for each in uses}
        contains = self._vocabulary.is_subsort
        most = (s for s in sorts if all(contains(each, s) for each in sorts))
        return Argument(next(most, THING))

    def _check_sorts(self, source: str) -> None:
        """Refuse the sort of a variable if no source of an event has its objects alone."""
        for name, meaning in self._chronicle.variables.items():
            sort = meaning.sort
            if sort is None or self._vocabulary.is_subsort(THING, sort) or name in self._fixed:
                continue
            if not any(self._vocabulary.is_subsort(each, sort) for each in self._read_for(name)):
                raise LanguageError(
                    f"no stream tells which `?{name}` is {shorten(sort)}, as each event of it is "
                    "read of other objects, too",
                    source,
                    meaning.span,
                    "state one sort for all objects of an event, or leave the sort out",
                )

    def _read_for(self, name: str) -> Iterator[str]:
        """The sorts of the sources for the places of a variable in events."""
        for event in self._chronicle.events:
            source = self.found[event.message.concept]
            for argument, used in zip(source.arguments, event.message.arguments, strict=True):
                if used == Variable(name) and argument.sort is not None:
                    yield argument.sort


def value_column(kind: Kind) -> str:
    """The column of values of a kind."""
    return str(kind)


def before_column(kind: Kind) -> str:
    """The column of the values before, of a kind."""
    return f"{kind} before"
