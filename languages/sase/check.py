"""Checks SASE+ patterns against the ontology, and binds the parameters of templates (SPEC §8)."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

from ...ontology.vocabulary import THING, Vocabulary
from ...streams.sample import TIME_FIELDS
from ..errors import LanguageError, Span
from ..hints import suggest_name
from ..mtl.ast import Measured, Number, Slot, Symbol, Text, TimePoint, Truth, Variable
from ..mtl.checked import Constant, Kind, ObjectConstant, ObjectSlot, kind_of
from ..object_cache import ObjectCache
from ..ontology_names import OntologyNames
from . import ast
from .checked import (
    TIME,
    VALUE,
    CheckedPattern,
    CheckedTemplate,
    EventType,
    ObjectParameter,
    ValueSlot,
    condition_leaves,
    is_over_matches,
    leaves_of,
)

MOST_PARTS: Final = 16
_LONGEST: Final = 1 << 60
"""Windows are shorter (36 years), so that sums of times stay within 64 bits."""
_RESERVED: Final = frozenset({"start", "end", *TIME_FIELDS})
_OPEN: Final = frozenset({ast.Index.EACH, ast.Index.PREVIOUS, ast.Index.BEFORE})
_READING: Final = (ast.Attribute, ast.Aggregate)
_BEFORE: Final = frozenset({ast.Index.PREVIOUS, ast.Index.BEFORE})


def check_sase(pattern: ast.Pattern, source: str, vocabulary: Vocabulary) -> CheckedPattern:
    """Return the meaning of ``parse_sase(source)``. Raises `LanguageError` with the place of the
    first part, name or condition that is wrong."""
    return _Checker(pattern, OntologyNames(source, vocabulary), ()).checked()


@ObjectCache
def check_sase_template(template: ast.PatternTemplate, vocabulary: Vocabulary) -> CheckedTemplate:
    """Return the meaning of a template. A parameter with a sort, or one that an ``id`` must equal,
    stands for objects; another one stands for a value. Raises `LanguageError`."""
    names = OntologyNames(template.source, vocabulary)
    checker = _Checker(template.pattern, names, template.slots)
    checked = checker.checked()
    return CheckedTemplate(tuple(map(checker.slot, template.slots)), checked)


def bound_sase(
    template: CheckedTemplate, arguments: Mapping[str, Constant | ObjectConstant]
) -> CheckedPattern:
    """Return the pattern of a template with these arguments, by the names of parameters. A
    parameter for objects without an argument is free; one for a value must have one."""
    pattern = template.pattern
    objects = []
    for each in pattern.objects:
        given = arguments.get(each.name)
        iri = given.iri if isinstance(given, ObjectConstant) else None
        objects.append(replace(each, object=iri))
    values = {slot.name: arguments[slot.name] for slot in template.slots if _is_value(slot)}

    def bind(node: Any) -> Any:
        if isinstance(node, Variable | Measured):
            variable = node if isinstance(node, Variable) else node.variable
            if variable.name in values:
                unit = None if isinstance(node, Variable) else node.unit
                return _written(values[variable.name], unit, node.span)
        return node

    text = rewritten(pattern.text, bind)
    return replace(pattern, text=text, objects=tuple(objects))


def _is_value(slot: ObjectSlot | ValueSlot) -> bool:
    return isinstance(slot, ValueSlot)


def _written(value: Constant | ObjectConstant, unit: Any, span: Span) -> ast.Constant:
    """A value as a text would have it."""
    if isinstance(value, ObjectConstant):
        return Symbol(f"<{value.iri}>", span)
    match value.kind:
        case Kind.NUMBER:
            return Number(float(value.value), unit, span)
        case Kind.TRUTH:
            return Truth(bool(value.value), span)
        case Kind.TIME:
            return TimePoint(int(value.value), span)
        case _:
            return Text(str(value.value), span)


def rewritten(node: Any, change: Callable[[Any], Any]) -> Any:
    """A tree with other nodes for those that ``change`` replaces."""
    if isinstance(node, tuple):
        return tuple(rewritten(each, change) for each in node)
    if isinstance(node, Span) or not dataclasses.is_dataclass(node):
        return node
    if (changed := change(node)) is not node:
        return changed
    fields = {f.name: getattr(node, f.name) for f in dataclasses.fields(node)}
    new = {name: rewritten(old, change) for name, old in fields.items()}
    return replace(node, **new)


class _Checker:
    def __init__(self, pattern: ast.Pattern, names: OntologyNames, slots: Sequence[Slot]) -> None:
        self._pattern = pattern if pattern.items else replace(pattern, items=_objects_of(pattern))
        self._names = names
        self._parts = {part.name: part for part in pattern.parts}
        self._types = tuple(
            tuple(self.event_type(each) for each in part.types) for part in pattern.parts
        )
        self._slots = {slot.variable.name: slot for slot in slots}
        self._defining = self.defining()
        self._objects = self.object_parameters()

    def error(self, message: str, span: Span, hint: str = "") -> LanguageError:
        return LanguageError(message, self._names.source, span, hint)

    def checked(self) -> CheckedPattern:
        pattern = self._pattern
        self.check_parts()
        for condition in pattern.where:
            self.check_condition(condition, is_having=False)
        for condition in pattern.having:
            self.check_condition(condition, is_having=True)
        text = replace(
            pattern,
            where=rewritten(pattern.where, self.with_object),
            having=rewritten(pattern.having, self.with_object),
            items=rewritten(pattern.items, self.with_object),
        )
        found = CheckedPattern(text, self._names.source, self._types, tuple(self._objects.values()))
        self.check_strategy(found)
        self.check_results(found)
        return found

    # -- types and parts ---------------------------------------------------------------------

    def event_type(self, symbol: Symbol) -> EventType:
        names, vocabulary = self._names, self._names.vocabulary
        sort = names.find_sort(symbol.text, symbol.span)
        if sort is not None:
            return EventType(sort, is_sort=True)
        iris = names.iris(symbol.text, symbol.span)
        found = next((i for i in iris if vocabulary.is_feature(i) or vocabulary.is_event(i)), None)
        if found is None:
            near = vocabulary.suggest(symbol.text)
            raise self.error(
                f"the ontology knows no feature, event or sort `{symbol.text}`",
                symbol.span,
                f"did you mean {' or '.join(near)}?" if near else "declare it in the ontology",
            )
        info = vocabulary.feature(found)
        if info is None:
            return EventType(found, is_sort=False)
        kind = None if info.range is None else kind_of(info.range)
        if kind is None and info.unit is not None:
            kind = Kind.NUMBER
        return EventType(found, False, kind, info.unit or (), info.arity)

    def check_parts(self) -> None:
        pattern = self._pattern
        if pattern.stream is not None:
            raise self.error(
                "streams are found by the types of a pattern, so it has no FROM",
                pattern.stream.span,
                "omit it; a stream is meant by a feature or event of its own",
            )
        seen: set[str] = set()
        for part in pattern.parts:
            if part.name in seen:
                raise self.error(f"`{part.name}` is a part twice", part.span, "rename the second")
            seen.add(part.name)
        there = [part for part in pattern.parts if not part.is_negated]
        if not there:
            raise self.error(
                "a pattern needs an event that happens",
                pattern.parts[0].span,
                "write one without `~`: the others are absent before, between or after such events",
            )
        if len(pattern.parts) > MOST_PARTS:
            raise self.error(
                f"a pattern has at most {MOST_PARTS} parts",
                pattern.parts[MOST_PARTS].span,
                "divide it into patterns that read each other",
            )
        if pattern.within is None:
            raise self.error(
                "a pattern without WITHIN would keep its events for ever",
                Span(pattern.span.start, pattern.span.start + len("PATTERN")),
                "write how long a match may last: `WITHIN 12 hours`",
            )
        if pattern.within < len(there) - 1:
            raise self.error(
                f"{len(there)} events that follow each other do not fit into WITHIN",
                pattern.span,
                "write a longer time",
            )
        if pattern.within >= _LONGEST:
            raise self.error(
                "WITHIN exceeds 36 years", pattern.span, "write a shorter time, such as 365d"
            )

    def check_strategy(self, checked: CheckedPattern) -> None:
        pattern = self._pattern
        strategy = pattern.strategy or ast.Strategy.ANY_MATCH
        kleene = next((part for part in pattern.parts if part.is_kleene), None)
        if strategy is ast.Strategy.PARTITION_CONTIGUITY and not any(
            isinstance(each, ast.Equivalence) for each in pattern.where
        ):
            raise self.error(
                "partition_contiguity needs an attribute that divides the events",
                pattern.parts[0].span,
                "write it in brackets: `WHERE partition_contiguity [id]`",
            )
        if checked.is_over_matches:
            if strategy is not ast.Strategy.ANY_MATCH:
                raise self.error(
                    f"aggregates over all matches need skip_till_any_match, not {strategy}",
                    pattern.items[0].span,
                    "aggregate the events of each match: `count(a[])`, `sum(a[].x)`",
                )
            absent = next((part for part in pattern.parts if part.is_negated), None)
            if absent:
                raise self.error(
                    f"aggregates over all matches do not know whether `{absent.name}` is absent",
                    absent.span,
                    "return the matches, or omit the part",
                )
            if pattern.having or pattern.limit is not None:
                raise self.error(
                    "HAVING and LIMIT are about matches, and this query has none as results",
                    pattern.having[0].span if pattern.having else pattern.span,
                    "omit them; a second query can filter the results of this one",
                )
        elif kleene and strategy is ast.Strategy.ANY_MATCH and pattern.limit is None:
            raise self.error(
                f"under skip_till_any_match `{kleene.name}` has exponentially many matches",
                kleene.span,
                "aggregate over them, such as `RETURN COUNT(*)`, bound the matches of an event by "
                "`LIMIT 100`, or write `WHERE skip_till_next_match`",
            )

    # -- conditions --------------------------------------------------------------------------

    def part(self, name: str, span: Span) -> ast.Part:
        if name not in self._parts:
            hint = suggest_name(name, self._parts)
            raise self.error(f"the pattern has no part `{name}`", span, hint)
        return self._parts[name]

    def check_condition(self, condition: ast.Condition, *, is_having: bool) -> None:
        leaves = condition_leaves(condition)
        for leaf in leaves:
            self.check_leaf(leaf)
            self.check_no_list(leaf)
            if is_over_matches(leaf):
                raise self.error(
                    "an aggregate over all matches is no property of one",
                    leaf.span,
                    "aggregate the events of the match: `count(a[])`, `sum(a[].x)`",
                )
        read = [leaf for leaf in leaves if isinstance(leaf, _READING)]
        if isinstance(condition, ast.Equivalence):
            if is_having:
                raise self.error(
                    f"`[{condition.name}]` selects events, and HAVING filters matches",
                    condition.span,
                    "write it in WHERE",
                )
            if read:
                raise self.error(
                    f"`[{condition.name} = …]` compares all events with a constant",
                    read[0].span,
                    f"write `[{condition.name}]`, or compare two parts",
                )
            return
        if not read:
            # A parameter for objects is one of an event, too.
            if any(isinstance(leaf, Variable) and leaf.name in self._objects for leaf in leaves):
                return
            raise self.error(
                "the condition reads no event", condition.span, "read one, as in `a.price > 100`"
            )
        if is_having:
            for each in read:
                self.check_settled(each, "HAVING is about a whole match")
        self.check_absent(condition, read)
        self.check_before(leaves)

    def check_leaf(self, leaf: ast.Term) -> None:
        """Refuse a part, an index or a parameter that is not there."""
        match leaf:
            case Variable(name) | Measured(Variable(name)):
                if name not in self._slots:
                    raise self.error(
                        f"`?{name}` has no value",
                        leaf.span,
                        "only a template has parameters: `REGISTER TEMPLATE e(?x) AS PATTERN …`",
                    )
            case Symbol(text) if text in self._parts:
                raise self.error(
                    f"`{text}` is an event, not a value", leaf.span, f"write `{text}.id`"
                )
            case ast.Attribute(name, index) | ast.Aggregate(_, name, index):
                part = self.part(name, leaf.span)
                is_one = isinstance(leaf, ast.Attribute) and index is ast.Index.ONE
                if part.is_kleene and is_one:
                    raise self.error(
                        f"`{name}` is several events",
                        leaf.span,
                        f"write `{name}[i]` for each of them, `{name}[1]`, "
                        f"`{name}[{name}.LEN]`, or an aggregate such as `max({name}[].x)`",
                    )
                if not part.is_kleene and index in _BEFORE:
                    raise self.error(
                        f"`{name}` is one event",
                        leaf.span,
                        f"write `+` after its type, or `{name}`",
                    )
            case _:
                pass

    def check_settled(self, leaf: ast.Attribute | ast.Aggregate, why: str) -> None:
        """Refuse what has another value for each event of a repeated part."""
        part = self._parts[leaf.part]
        if part.is_negated:
            raise self.error(
                f"{why}, and `{part.name}` is absent from it", leaf.span, "read another part"
            )
        if part.is_kleene and leaf.index in _OPEN:
            raise self.error(
                f"{why}, and `{part.name}{leaf.index}` is each of its events in turn",
                leaf.span,
                f"write `{part.name}[1]`, `{part.name}[{part.name}.LEN]` or an aggregate",
            )

    def check_absent(
        self, condition: ast.Condition, read: Sequence[ast.Attribute | ast.Aggregate]
    ) -> None:
        absent = {leaf.part for leaf in read if self._parts[leaf.part].is_negated}
        if len(absent) > 1:
            first, second = sorted(absent)
            raise self.error(
                f"`{first}` and `{second}` are both absent, each by itself",
                condition.span,
                "compare each with an event that happens",
            )
        for leaf in read:
            if absent and not self._parts[leaf.part].is_negated:
                self.check_settled(leaf, "an absent event is compared with the whole match")

    def check_before(self, leaves: Sequence[ast.Term]) -> None:
        """Refuse ``a[i-1]`` where no later event of that part is taken."""
        order = list(self._parts)
        # A parameter is the object of some part.
        given = (self._defining.get(leaf.name) for leaf in leaves if isinstance(leaf, Variable))
        read = [leaf for leaf in (*leaves, *given) if isinstance(leaf, _READING)]
        last = max((leaf.part for leaf in read), key=order.index)
        for leaf in read:
            if leaf.index not in _BEFORE:
                continue
            others = {each.index for each in read if each.part == leaf.part}
            if leaf.part != last or not others <= {ast.Index.EACH, ast.Index.FIRST, *_BEFORE}:
                raise self.error(
                    f"`{leaf.part}{leaf.index}` is known while `{leaf.part}[i]` is taken, and "
                    "other parts of the condition later",
                    leaf.span,
                    f"compare it with `{leaf.part}[i]` and with earlier parts",
                )

    # -- results -----------------------------------------------------------------------------

    def check_results(self, checked: CheckedPattern) -> None:
        names: set[str] = {each.name for each in checked.objects}
        for item, leaf in checked.returned():
            self.check_leaf(leaf)
            if isinstance(leaf, ast.Attribute | ast.Aggregate):
                self.check_settled(leaf, "results are those of a whole match")
            if leaf is not item.term:
                self.check_no_list(leaf)
            if checked.is_over_matches:
                self.check_over_matches(item, leaf)
        for item in self._pattern.items:
            name = result_name(item)
            if name is None:
                raise self.error(
                    "the result has no name", item.span, "name it: `a.x - b.x AS difference`"
                )
            if name in names:
                raise self.error(
                    f"two results have the name `{name}`",
                    item.span,
                    "give one another: `… AS name`",
                )
            if name in _RESERVED:
                raise self.error(
                    f"each result has `{name}` already", item.span, "give it another name"
                )
            names.add(name)

    def check_no_list(self, leaf: ast.Term) -> None:
        if isinstance(leaf, ast.Attribute) and leaf.index is ast.Index.ALL:
            raise self.error(
                f"`{leaf.part}[].{leaf.name}` is a list",
                leaf.span,
                f"return it by itself, or write an aggregate: `max({leaf.part}[].{leaf.name})`",
            )

    def check_over_matches(self, item: ast.Item, leaf: ast.Term) -> None:
        if is_over_matches(leaf):
            if leaf is not item.term:
                raise self.error(
                    "an aggregate over all matches stands by itself",
                    item.span,
                    "calculate with it in a query that reads the results",
                )
            return
        last = [part for part in self._pattern.parts if not part.is_negated][-1]
        is_of_last = isinstance(leaf, ast.Attribute) and leaf.part == last.name
        if isinstance(leaf, ast.Aggregate | ast.Attribute) and not (
            is_of_last and leaf.index in (ast.Index.ONE, ast.Index.LAST)
        ):
            name = f"{last.name}[{last.name}.LEN]" if last.is_kleene else last.name
            raise self.error(
                "this is of one match, and other results are of all that end with an event",
                leaf.span,
                f"over all matches write `sum(a.x)`; of the event that ends them `{name}.x`",
            )

    # -- objects and parameters --------------------------------------------------------------

    def is_object(self, part: str, attribute: str) -> bool:
        """Whether an attribute of a part is an object."""
        index = list(self._parts).index(part)
        return all(each.argument(attribute) is not None for each in self._types[index])

    def defining(self) -> dict[str, ast.Attribute]:
        """The variables that an ``id`` of an event that happens equals, and the first such one."""
        found: dict[str, ast.Attribute] = {}
        for condition in self._pattern.where:
            match condition:
                case ast.Equivalence(name, Variable(variable)):
                    if all(self.is_object(part, name) for part in self._parts):
                        there = (part for part in self._parts.values() if not part.is_negated)
                        for first in itertools.islice(there, 1):
                            index = ast.Index.EACH if first.is_kleene else ast.Index.ONE
                            each = ast.Attribute(first.name, index, name, condition.span)
                            found.setdefault(variable, each)
                case ast.Comparison("=", left, right):
                    for one, other in ((left, right), (right, left)):
                        match one, other:
                            case ast.Attribute(), Variable(variable) if self.is_defining(one):
                                found.setdefault(variable, one)
                case _:
                    pass
        return found

    def is_defining(self, node: ast.Attribute) -> bool:
        """Whether this is an object of events that happen: of one, or of each."""
        part = self._parts.get(node.part)
        is_some = node.index in (ast.Index.ONE, ast.Index.EACH, ast.Index.FIRST)
        is_there = part is not None and not part.is_negated
        return is_some and is_there and self.is_object(node.part, node.name)

    def object_parameters(self) -> dict[str, ObjectParameter]:
        found = {}
        for name, slot in self._slots.items():
            if slot.sort is None and name not in self._defining:
                continue
            if name not in self._defining:
                raise self.error(
                    f"no event tells the objects of `?{name}`",
                    slot.span,
                    f"write `a.id = ?{name}` for a part `a`, or `[id = ?{name}]` for all parts",
                )
            sort = slot.sort
            iri = THING if sort is None else self._names.sort(sort.text, sort.span)
            found[name] = ObjectParameter(name, iri, self._defining[name])
        return found

    def with_object(self, node: Any) -> Any:
        """A name of an object as its IRI."""
        if isinstance(node, Symbol):
            return Symbol(f"<{self._names.object(node.text, node.span)}>", node.span)
        return node

    def slot(self, slot: Slot) -> ObjectSlot | ValueSlot:
        name = slot.variable.name
        if name in self._objects:
            return ObjectSlot(name, self._objects[name].sort)
        kinds: list[Kind | None] = []
        pattern = self._pattern
        for condition in (*pattern.where, *pattern.having):
            kinds += self.kinds_in(condition, name)
        for item in pattern.items:
            kinds += [Kind.NUMBER for leaf in leaves_of(item.term) if _is_variable(leaf, name)]
        if not kinds:
            raise self.error(
                f"the pattern does not use `?{name}`",
                slot.span,
                "use it, as in `a.value > ?limit`, or leave it out",
            )
        known = list(dict.fromkeys(kind for kind in kinds if kind is not None))
        if len(known) > 1:
            raise self.error(
                f"`?{name}` is compared as a {known[0]} and as a {known[1]}",
                slot.span,
                "a parameter is of one kind: use two",
            )
        return ValueSlot(name, known[0] if known else None)

    def kinds_in(self, condition: ast.Condition, name: str) -> list[Kind | None]:
        """The kinds as which a condition compares a variable; None: it does not say."""
        leaves = condition_leaves(condition)
        if not any(_is_variable(leaf, name) for leaf in leaves):
            return []
        match condition:
            case ast.Equivalence(attribute, Variable()):
                kinds = {self.kind(part, attribute) for part in self._parts}
                return [kinds.pop() if len(kinds) == 1 else None]
            case ast.Comparison(operator, left, right):
                other = right if _is_variable(left, name) else left
                is_alone = _is_variable(left, name) or _is_variable(right, name)
                kind = _KINDS.get(type(other))
                if isinstance(other, ast.Attribute):
                    kind = self.kind(other.part, other.name)
                if is_alone and isinstance(
                    other, ast.Attribute | Text | Truth | TimePoint | Symbol
                ):
                    is_ordered = operator not in ("=", "!=")
                    return [kind or (Kind.NUMBER if is_ordered else None)]
        return [Kind.NUMBER]

    def kind(self, part: str, attribute: str) -> Kind | None:
        """The kind of an attribute, as far as the ontology says."""
        if attribute == TIME:
            return Kind.TIME
        if self.is_object(part, attribute):
            return Kind.OBJECT
        types = self._types[list(self._parts).index(part)]
        return types[0].kind if attribute == VALUE else None


_KINDS: Final = {
    Text: Kind.TEXT,
    Truth: Kind.TRUTH,
    TimePoint: Kind.TIME,
    Symbol: Kind.OBJECT,
}


def _is_variable(term: ast.Term, name: str) -> bool:
    match term:
        case Variable(found) | Measured(Variable(found)):
            return found == name
        case _:
            return False


def _objects_of(pattern: ast.Pattern) -> tuple[ast.Item, ...]:
    """What is returned if the text does not say it: the object of each part, by its name."""
    return tuple(
        ast.Item(
            ast.Attribute(
                part.name, ast.Index.ALL if part.is_kleene else ast.Index.ONE, "id", part.span
            ),
            part.name,
            part.span,
        )
        for part in pattern.parts
        if not part.is_negated
    )


def result_name(item: ast.Item) -> str | None:
    """The name of a result: that after AS, else of the attribute, else of the function."""
    if item.name is not None:
        return item.name
    match item.term:
        case ast.Attribute(_, _, name):
            return name
        case ast.Aggregate(function, _, _, name):
            return function if name is None else f"{function}_{name}"
        case ast.CountMatches():
            return "count"
        case _:
            return None
