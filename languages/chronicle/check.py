"""Checks chronicles against the ontology: resolves names, finds the kinds of values, and converts
constants into the units of the features that they meet (SPEC §8).

A variable is bound by an event: as its object, or as a value that it must equal. The ontology's
range says of which kind the values of a feature are; without a range the constants decide, else
they are numbers.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, assert_never

from ...ontology.vocabulary import THING, Vocabulary
from ...streams.sample import TIME_FIELDS
from ..errors import LanguageError, Span
from ..hints import count, suggest_name
from ..mtl.ast import Binding, Measured, Number, Slot, Symbol, Text, TimePoint, Truth
from ..mtl.ast import Variable as WrittenVariable
from ..mtl.checked import Kind, ObjectConstant, ObjectSlot, Parameter, kind_of
from ..object_cache import ObjectCache
from ..ontology_names import OntologyNames
from . import ast
from .checked import (
    Argument,
    CheckedChronicle,
    CheckedTemplate,
    Comparison,
    Distance,
    Duration,
    Event,
    Given,
    Hold,
    Meaning,
    Message,
    Moment,
    Occurs,
    Test,
    Variable,
)
from .values import Values, article

_RESERVED: Final = frozenset({"start", "end", *TIME_FIELDS})
_KINDS: Final = {
    Truth: Kind.TRUTH,
    Number: Kind.NUMBER,
    Text: Kind.TEXT,
    TimePoint: Kind.TIME,
    Symbol: Kind.OBJECT,
    Measured: Kind.NUMBER,
}


def check_chronicle(
    chronicle: ast.Chronicle, source: str, vocabulary: Vocabulary
) -> CheckedChronicle:
    """Return the meaning of ``parse_chronicle(source)``. Raises `LanguageError` with the place of
    the first name, kind, unit or time that is wrong."""
    return _Checker(chronicle, OntologyNames(source, vocabulary), ()).checked()


@ObjectCache
def check_chronicle_template(
    template: ast.ChronicleTemplate, vocabulary: Vocabulary
) -> CheckedTemplate:
    """Return the meaning of a template. A parameter with a sort, or one that is an object of a
    feature or event, stands for objects; another one stands for a value. Raises
    `LanguageError`."""
    names = OntologyNames(template.source, vocabulary)
    checker = _Checker(template.chronicle, names, template.slots)
    checked = checker.checked()
    slots: list[ObjectSlot | Parameter] = []
    for slot in template.slots:
        name = slot.variable.name
        if name not in checker.parameters:
            if name not in checked.head:
                raise checker.error(
                    f"the matches do not tell of `?{name}`",
                    slot.span,
                    f"name it in the head: `chronicle {template.chronicle.name}(?{name}, …)`",
                )
            slots.append(ObjectSlot(name, checked.variables[name].sort or THING))
        elif name in checker.values.parameter_kinds:
            slots.append(Parameter(name, checker.values.parameter_kinds[name]))
        else:
            raise checker.error(
                f"the chronicle does not use `?{name}`",
                slot.span,
                "use it, as in `event(speed[?x]:(?, > ?limit), t)`, or leave it out",
            )
    return CheckedTemplate(tuple(slots), checked)


class _Checker:
    def __init__(
        self, chronicle: ast.Chronicle, names: OntologyNames, slots: tuple[Slot, ...]
    ) -> None:
        self._chronicle = chronicle
        self._names = names
        clauses = chronicle.clauses
        self._events = [each for each in clauses if isinstance(each, ast.Event)]
        self._points = {each.point.name for each in self._events}
        self._objects = {
            argument.name
            for message in _messages(chronicle)
            for argument in message.arguments
            if isinstance(argument, WrittenVariable)
        }
        """The variables that are objects of features or events."""
        free = {each.variable.name for each in slots if each.sort is None}
        self.parameters = free - self._objects
        """The parameters of a template that stand for values."""
        self._sorts = self.sorts((*slots, *chronicle.parameters), clauses)
        self.values = Values(names, self.kinds(), self.parameters)
        self._arities: dict[str, int] = {}

    def error(self, message: str, span: Span, hint: str = "") -> LanguageError:
        return LanguageError(message, self._names.source, span, hint)

    def checked(self) -> CheckedChronicle:
        chronicle = self._chronicle
        if not self._events:
            raise self.error(
                "a chronicle needs an event",
                chronicle.span,
                "write `event(E[?x], t1)` for what must happen",
            )
        for each in self._events:
            self.bind_objects(each.message)
        for each in self._events:
            self.bind_values(each.message)
        for name, (_, span) in self._sorts.items():
            self.values.meaning(name, span)
        for parameter in chronicle.parameters:
            self.check_field(parameter)
        clauses = chronicle.clauses
        if chronicle.emitted is not None:
            self.point(chronicle.emitted)
        return CheckedChronicle(
            chronicle.stream or chronicle.name,
            tuple(each.variable.name for each in chronicle.parameters),
            self.values.variables,
            tuple(
                Event(self.message(each.message), each.point.name, each.span)
                for each in self._events
            ),
            tuple(self.probe(each) for each in clauses if isinstance(each, ast.Occurs | ast.Hold)),
            tuple(self.distance(each) for each in clauses if isinstance(each, ast.Distance)),
            tuple(self.comparison(each) for each in clauses if isinstance(each, ast.Comparison)),
            None if chronicle.emitted is None else chronicle.emitted.name,
            chronicle.span,
            max_delay=chronicle.max_delay,
        )

    # -- variables ---------------------------------------------------------------------------

    def sorts(
        self, slots: tuple[Slot, ...], clauses: tuple[ast.Clause, ...]
    ) -> dict[str, tuple[str, Span]]:
        """The sort that the text states of each variable, and where."""
        found: dict[str, tuple[str, Span]] = {}
        stated = [(each.variable, each.sort) for each in slots if each.sort is not None]
        stated += [(each.variable, each.sort) for each in clauses if isinstance(each, Binding)]
        for variable, sort in stated:
            if variable.name in found or variable.name in self.parameters:
                is_value = variable.name in self.parameters
                raise self.error(
                    f"`?{variable.name}` {'is a value' if is_value else 'has two sorts'}",
                    variable.span,
                    "state the sort in the head of the template"
                    if is_value
                    else "leave one of them out",
                )
            found[variable.name] = self._names.sort(sort.text, sort.span), variable.span
        return found

    def bind_objects(self, message: ast.Message) -> None:
        """Give the variables that are objects of the event their meaning."""
        for argument in message.arguments:
            if isinstance(argument, WrittenVariable):
                sort, span = self._sorts.get(argument.name, (THING, argument.span))
                meaning = Meaning(Kind.OBJECT, sort, None, span)
                self.values.variables.setdefault(argument.name, meaning)

    def bind_values(self, message: ast.Message) -> None:
        """Give the variables that a value of the event equals their meaning."""
        for test in (message.before, message.value):
            if test is None or test.operator != "=" or not self.is_variable(test.operand):
                continue
            assert isinstance(test.operand, WrittenVariable)
            name, feature = test.operand.name, self.feature(message)
            kind, unit = self.values.kind(feature), self.values.unit(feature)
            sort, span = self._sorts.get(name) or (None, test.operand.span)
            if sort is not None and kind is not Kind.OBJECT:
                raise self.error(
                    f"`?{name}` is {article(kind)}, and of no sort", span, "leave its sort out"
                )
            self.values.variables.setdefault(name, Meaning(kind, sort, unit, span))

    def is_variable(self, operand: ast.Operand) -> bool:
        return isinstance(operand, WrittenVariable) and operand.name not in self.parameters

    def check_field(self, parameter: Slot) -> None:
        name = parameter.variable.name
        if name in self.parameters:
            raise self.error(
                f"`?{name}` is a value that a request gives, and no part of a match",
                parameter.span,
                "leave it out of the head of the chronicle",
            )
        self.values.meaning(name, parameter.span)
        if name in _RESERVED:
            raise self.error(
                f"`?{name}` cannot be in the head: the matches have a time {name!r}",
                parameter.span,
                "give the variable another name",
            )

    # -- features ----------------------------------------------------------------------------

    def feature(self, message: ast.Message) -> str:
        return self._names.feature(message.concept.text, message.concept.span)

    def kinds(self) -> dict[str, Kind]:
        """The kind of the values of each feature or event: by its range or unit, or else by the
        first constant or object that it is compared with."""
        found: dict[str, Kind] = {}
        messages = list(_messages(self._chronicle))
        for message in messages:
            info = self._names.vocabulary.feature(self.feature(message))
            if info is not None:
                kind = None if info.range is None else kind_of(info.range)
                if kind is not None:
                    found[info.iri] = kind
                elif info.unit is not None:
                    found[info.iri] = Kind.NUMBER
        for message in messages:
            for test in (message.before, message.value):
                if test is None:
                    continue
                kind = _KINDS.get(type(test.operand))
                if isinstance(test.operand, WrittenVariable) and test.operand.name in self._objects:
                    kind = Kind.OBJECT
                if kind is not None:
                    found.setdefault(self.feature(message), kind)
        return found

    # -- clauses -----------------------------------------------------------------------------

    def message(self, message: ast.Message) -> Message:
        feature = self.feature(message)
        name = message.concept.text
        if not message.arguments:
            raise self.error(
                f"`{name}` names no object, and matching finds features of objects",
                message.span,
                f"write `{name}[?x]`, `{name}[uav1]`, or `{name}[?]` for any object",
            )
        info, number = self._names.vocabulary.feature(feature), len(message.arguments)
        if info is not None and info.arity not in (None, number):
            shown = ", ".join(f"?x{i + 1}" for i in range(info.arity or 0))
            raise self.error(
                f"`{name}` is a feature of {count(info.arity or 0, 'object')}, not of {number}",
                message.span,
                f"write `{name}[{shown}]`",
            )
        before = self._arities.setdefault(feature, number)
        if before != number:
            raise self.error(
                f"`{name}` is an event of {count(before, 'object')} above, and of {number} here",
                message.span,
                "name its objects alike, with `?` for any object",
            )
        arguments = tuple(map(self.argument, message.arguments))
        tests = [
            None if test is None else self.test(test, feature)
            for test in (message.before, message.value)
        ]
        kind = self.values.kind(feature) if any(tests) else None
        return Message(feature, arguments, tests[0], tests[1], kind, message.span)

    def argument(self, argument: ast.Argument) -> Argument:
        match argument:
            case None:
                return None
            case WrittenVariable(name, span):
                self.values.meaning(name, span)
                return Variable(name)
            case Symbol(text, span):
                if self._names.find_sort(text, span) is not None:
                    raise self.error(
                        f"`{text}` is a sort, not an object",
                        span,
                        f"write a variable, and its sort in a clause: `?x in {text}`",
                    )
                return ObjectConstant(self._names.object(text, span))
            case Text(value):
                return ObjectConstant(self._names.namespace + value)
            case _:
                assert_never(argument)

    def probe(self, clause: ast.Occurs | ast.Hold) -> Occurs | Hold:
        message = self.message(clause.message)
        start, end = self.moment(clause.start), self.moment(clause.end)
        if isinstance(clause, ast.Occurs):
            return Occurs(clause.least, clause.most, message, start, end, clause.span)
        if None in message.arguments:
            raise self.error(
                "a state is that of named objects",
                clause.message.span,
                "write a variable or an object in place of `?`, or use `noevent`",
            )
        return Hold(message, start, end, clause.span)

    def distance(self, clause: ast.Distance) -> Distance:
        first, second = self.point(clause.first), self.point(clause.second)
        if first == second:
            raise self.error(
                f"`{first}` is compared with itself",
                clause.span,
                "name two points, or leave it out",
            )
        bounds = (
            None if each is None else self.duration(each) for each in (clause.least, clause.most)
        )
        return Distance(first, second, *bounds)

    def moment(self, moment: ast.Moment) -> Moment:
        return Moment(self.point(moment.point), self.duration(moment.offset))

    def duration(self, duration: ast.Duration) -> Duration:
        if isinstance(duration, int):
            return duration
        variable = duration.variable
        if variable.name not in self.parameters:
            raise self.error(
                f"`?{variable.name}` is no duration that a request gives",
                variable.span,
                "name it in the head of a template: `REGISTER TEMPLATE e(?d) AS chronicle …`",
            )
        self.values.parameter(variable, Kind.DURATION)
        return Given(variable.name, duration.sign, duration.offset)

    def point(self, point: ast.Point) -> str:
        if point.name not in self._points:
            raise self.error(
                f"no event happens at `{point.name}`",
                point.span,
                suggest_name(point.name, self._points),
            )
        return point.name

    # -- values ------------------------------------------------------------------------------

    def test(self, test: ast.Test, feature: str) -> Test:
        kind, unit = self.values.kind(feature), self.values.unit(feature)
        return Test(
            test.operator, self.values.compared(test.operator, test.operand, kind, unit, test.span)
        )

    def comparison(self, clause: ast.Comparison) -> Comparison:
        name = clause.left.name
        if name in self.parameters:
            raise self.error(
                f"`?{name}` is a value that a request gives",
                clause.left.span,
                "write a variable that an event binds to the left of it",
            )
        left = self.values.meaning(name, clause.left.span)
        right = self.values.compared(
            clause.operator, clause.right, left.kind, left.unit, clause.span
        )
        return Comparison(Variable(name), clause.operator, right)


def _messages(chronicle: ast.Chronicle) -> Iterator[ast.Message]:
    for clause in chronicle.clauses:
        if isinstance(clause, ast.Event | ast.Occurs | ast.Hold):
            yield clause.message
