"""What a SASE+ pattern reads of streams: a source for each concept that is a type (SPEC §8)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from ....languages.errors import LanguageError, Span
from ....languages.hints import suggest_name
from ....languages.mtl.ast import Symbol, Variable
from ....languages.mtl.checked import Kind
from ....languages.sase import ast
from ....languages.sase.checked import (
    TIME,
    VALUE,
    CheckedPattern,
    EventType,
    condition_leaves,
)
from ....ontology.units import Unit
from ....ontology.vocabulary import THING
from ....rdf.namespaces import shorten
from ..plans.plan import Column, ColumnType
from ..plans.query import Argument, Kinds, Part, Source, SourceColumn, column_type

_ALL: Final = Argument(THING)
_EACH: Final = (ast.Index.ONE, ast.Index.EACH)


def sase_sources(checked: CheckedPattern) -> tuple[Source, ...]:
    """Return what matching has to find. The kinds of fields are not known before. Raises
    `LanguageError`."""
    return Attributes(checked, None).sources()


def is_key(kind: Kind) -> bool:
    """Whether values of a kind are keys, which only have an identity."""
    return column_type(kind) is ColumnType.KEY


def source_kind(event_type: EventType) -> str:
    """The name of the source of a type."""
    return shorten(event_type.concept).removeprefix("dyknow:")


@dataclass(frozen=True, slots=True)
class Attribute:
    """An attribute of the events of a part: its column, and the kind and unit of its values (None:
    that of a field, or no number). ``argument``: whose objects they are."""

    column: str
    kind: Kind
    unit: Unit | None
    argument: Argument | None = None


class Attributes:
    """The attributes that a pattern reads, as columns of its rows. ``kinds`` of fields: None before
    streams are found."""

    def __init__(self, checked: CheckedPattern, kinds: Kinds | None) -> None:
        self._checked = checked
        self._kinds = kinds
        self._types = {
            part.name: types for part, types in zip(checked.text.parts, checked.types, strict=True)
        }
        self._columns: dict[str, Column] = {}
        self._reads = self._found_reads()
        self._arguments = self._found_arguments()
        self._read: dict[str, dict[str, SourceColumn]] = {
            source_kind(each): {} for types in checked.types for each in types
        }
        for (part, name), span in self._reads.items():
            for each in self._types[part]:
                if name != TIME:
                    self._read[source_kind(each)][name] = self._column(each, name, span)
        is_divided = checked.text.strategy is ast.Strategy.PARTITION_CONTIGUITY
        for condition in checked.text.where:
            if isinstance(condition, ast.Equivalence) and (is_divided or condition.value is None):
                self._add_keys(condition.name)

    def error(self, message: str, span: Span, hint: str = "") -> LanguageError:
        return LanguageError(message, self._checked.source, span, hint)

    def columns(self) -> tuple[Column, ...]:
        """The columns of the plan."""
        return tuple(self._columns.values())

    def sources(self) -> tuple[Source, ...]:
        """The sources, in order of the first part that reads each."""
        types = {source_kind(each): each for types in self._types.values() for each in types}
        return tuple(
            Source(
                kind,
                each.concept,
                self._arguments[each],
                tuple(self._read[kind].values()),
                each.is_sort,
                self._checked.stream,
            )
            for kind, each in types.items()
        )

    def attribute(self, part: str, name: str, span: Span) -> Attribute:
        """Return an attribute of a part. Raises `LanguageError` if the types of the part differ."""
        return self._attribute(part, name, name, span)

    def key(self, part: str, name: str, span: Span) -> Attribute | None:
        """Return an attribute of a part as a key; None if it is neither a text or object nor one
        that stands in brackets. Raises as `attribute`."""
        found = self.attribute(part, name, span)
        if is_key(found.kind):
            return found
        read = self._read[source_kind(self._types[part][0])]
        return self._attribute(part, name, _as_key(name), span) if _as_key(name) in read else None

    def _attribute(self, part: str, name: str, read: str, span: Span) -> Attribute:
        types = self._types[part]
        columns = [self._read[source_kind(each)][read] for each in types]
        is_value = columns[0].part is Part.VALUE
        units = {each.unit if is_value else None for each in types}
        if len({(each.kind, each.part) for each in columns}) > 1 or len(units) > 1:
            kinds = " or ".join(source_kind(each) for each in types)
            raise self.error(
                f"`{name}` is not the same in each {kinds}", span, "write a pattern for each type"
            )
        first = columns[0]
        assert first.kind is not None
        argument = self._arguments[types[0]][first.argument] if len(types) == 1 else None
        is_object = first.part is Part.OBJECT
        # The unit of a field is not known here.
        unit = next(iter(units)) if first.kind is Kind.NUMBER else None
        return Attribute(first.column, first.kind, unit, argument if is_object else None)

    # -- columns -----------------------------------------------------------------------------

    def _found_reads(self) -> dict[tuple[str, str], Span]:
        """The attributes that the text reads, by part and name: where it first does."""
        found: dict[tuple[str, str], Span] = {}
        text = self._checked.text
        leaves = [leaf for _, leaf in self._checked.returned()]
        for condition in (*text.where, *text.having):
            leaves += condition_leaves(condition)
            if isinstance(condition, ast.Equivalence):
                for part in self._types:
                    found.setdefault((part, condition.name), condition.span)
        for leaf in leaves:
            if isinstance(leaf, ast.Attribute | ast.Aggregate) and leaf.name is not None:
                found.setdefault((leaf.part, leaf.name), leaf.span)
        return found

    def _column(self, event_type: EventType, name: str, span: Span) -> SourceColumn:
        argument = event_type.argument(name)
        if argument is not None:
            column = self._named(name, Kind.OBJECT)
            return SourceColumn(column, Part.OBJECT, Kind.OBJECT, argument=argument)
        kind = event_type.kind if name == VALUE else None
        if self._kinds is not None and kind is None:
            kind = self._kinds.get((source_kind(event_type), name))
        if name == VALUE and not event_type.is_sort:
            # Without a range a value is a number, as in formulas.
            kind = kind if self._kinds is None else kind or Kind.NUMBER
            return SourceColumn(self._named(name, kind), Part.VALUE, kind)
        if self._kinds is not None and kind is None:
            own = source_kind(event_type)
            known = [field for source, field in self._kinds if source == own]
            raise self.error(
                f"no stream of {own} has a field `{name}`", span, suggest_name(name, known)
            )
        return SourceColumn(self._named(name, kind), Part.FIELD, kind, field=name)

    def _add_keys(self, name: str) -> None:
        """Add a column of keys for an attribute whose values are of another type."""
        for read in self._read.values():
            column = read[name]
            if column.kind is not None and not is_key(column.kind):
                key = self._columns.setdefault(_as_key(name), Column(_as_key(name), ColumnType.KEY))
                read[key.name] = replace(column, column=key.name, as_key=True)

    def _named(self, name: str, kind: Kind | None) -> str:
        """The column of an attribute: its name, unless another type has it as another kind."""
        if kind is None:
            return name
        type_ = column_type(kind)
        for column in (name, f"{name} ({type_})"):
            known = self._columns.setdefault(column, Column(column, type_))
            if known.type is type_:
                return column
        raise AssertionError(name)

    # -- whose events ------------------------------------------------------------------------

    def _found_arguments(self) -> dict[EventType, tuple[Argument, ...]]:
        """The objects of each type: those that all its parts must have."""
        found: dict[EventType, tuple[Argument, ...]] = {}
        restrictions = self._restrictions()
        for types in self._types.values():
            for each in set(types) - found.keys():
                parts = [part for part, of in self._types.items() if each in of]
                wanted = {
                    part: {
                        each.argument(name): argument
                        for name, argument in reversed(restrictions[part].items())
                    }
                    for part in parts
                }
                found[each] = tuple(
                    self._argument(each, {part: wanted[part].get(number) for part in parts})
                    for number in range(self._count(each))
                )
        return found

    def _count(self, event_type: EventType) -> int:
        if event_type.arity is not None:
            return max(event_type.arity, 1)
        parts = {part for part, types in self._types.items() if event_type in types}
        read = [event_type.argument(name) for part, name in self._reads if part in parts]
        return 1 + max([number for number in read if number is not None], default=0)

    def _argument(self, event_type: EventType, of: dict[str, Argument | None]) -> Argument:
        """The objects of a type at one place, by those that its parts must have."""
        default = Argument(event_type.concept) if event_type.is_sort else _ALL
        wanted = {part: argument or default for part, argument in of.items()}
        if len(set(wanted.values())) == 1:
            (found,) = set(wanted.values())
            if self._is_contiguous():
                # Events of other objects may stand between those of a match.
                found = Argument(found.sort or default.sort)
            is_wide = event_type.is_sort and found.sort == THING
            return Argument(event_type.concept, found.object) if is_wide else found
        for part, each in wanted.items():
            if each.object is None and each.sort not in (default.sort, THING):
                place = next(p.span for p in self._checked.text.parts if p.name == part)
                raise self.error(
                    f"{source_kind(event_type)} is read of {shorten(each.sort or '')} here, and "
                    "of others elsewhere",
                    place,
                    "give all parts of this type the same object, or omit its sort",
                )
        return default

    def _is_contiguous(self) -> bool:
        """Whether events of other objects end a match."""
        text = self._checked.text
        if text.strategy is not ast.Strategy.PARTITION_CONTIGUITY:
            return text.strategy is ast.Strategy.STRICT_CONTIGUITY
        return not any(isinstance(c, ast.Equivalence) and c.name == "id" for c in text.where)

    def _restrictions(self) -> dict[str, dict[str, Argument]]:
        """The objects that conditions demand of each part, by the attribute."""
        found: dict[str, dict[str, Argument]] = {part: {} for part in self._types}
        for condition in self._checked.text.where:
            match condition:
                case ast.Equivalence(name, value):
                    if demanded := self._demanded(value):
                        for part in found:
                            found[part].setdefault(name, demanded)
                case ast.Comparison("=", left, right):
                    for one, other in ((left, right), (right, left)):
                        if not (isinstance(one, ast.Attribute) and one.index in _EACH):
                            continue
                        if demanded := self._demanded(other):
                            found[one.part].setdefault(one.name, demanded)
                case _:
                    pass
        return found

    def _demanded(self, value: ast.Term | None) -> Argument | None:
        """The objects that an ``id`` must be to equal a value."""
        match value:
            case Symbol(text):
                return Argument(None, text[1:-1])
            case Variable(name):
                return next(
                    (
                        Argument(each.sort, each.object)
                        for each in self._checked.objects
                        if each.name == name
                    ),
                    None,
                )
            case _:
                return None


def _as_key(name: str) -> str:
    """The column of the keys of an attribute."""
    return f"{name} as a key"
