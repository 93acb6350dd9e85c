"""Compiles chronicles to pattern queries (SPEC §8, [DyKnow10 §2, §7]).

Each ``event`` is an element, whose time is its end; points are bounds between ends. Shared
variables are equal keys. ``noevent`` and ``occurs`` count rows between two times, and ``hold`` asks
the state at the first one and counts the rows with other values.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, assert_never

from ....languages.chronicle.checked import Argument as Named
from ....languages.chronicle.checked import (
    CheckedChronicle,
    Duration,
    Hold,
    Message,
    Moment,
    Occurs,
    Operand,
    Test,
    Variable,
)
from ....languages.errors import LanguageError, Span
from ....languages.mtl.checked import Calculation, Constant, Kind, ObjectConstant, Parameter
from ....ontology.vocabulary import Vocabulary
from ....rdf.namespaces import shorten
from ..plans.network import INFINITE, UnboundedRetention, minimal_network
from ..plans.plan import (
    OWN,
    Between,
    Bound,
    Column,
    Condition,
    CountProbe,
    Element,
    Expression,
    Key,
    Output,
    PatternPlan,
    PlanError,
    Point,
    Probe,
    Same,
    StateProbe,
    Time,
    Value,
)
from ..plans.plan import Constant as Number
from ..plans.query import (
    END,
    START,
    PatternQuery,
    Result,
    Source,
    column_type,
    object_column,
    object_key,
    text_key,
)
from .chronicle_sources import ChronicleSources, before_column, value_column

_EMITTED: Final = "valid"
_OPPOSITE: Final = {"<": ">=", "<=": ">", ">": "<=", ">=": "<", "=": "!=", "!=": "="}


def chronicle_query(
    chronicle: CheckedChronicle, source: str, vocabulary: Vocabulary
) -> PatternQuery:
    """Compile a chronicle whose parameters have values. ``source`` is its text.

    Raises `LanguageError`: for a sort that no source can tell, for too many events, for times that
    contradict each other, and for samples that would be kept for ever.
    """
    return _Compiler(chronicle, source, vocabulary).query()


class _Compiler:
    def __init__(self, chronicle: CheckedChronicle, source: str, vocabulary: Vocabulary) -> None:
        self._chronicle = chronicle
        self._text = source
        self._sources = ChronicleSources(chronicle, source, vocabulary)
        self._fixed = dict(chronicle.fixed)
        self._places: dict[str, int] = {}
        """The element of each point: the first of several at one time."""
        for number, event in enumerate(chronicle.events):
            self._places.setdefault(event.point, number)
        self._bound: dict[str, Value] = {}
        """Where each variable has its value."""
        self._same: list[Same] = []
        self._conditions: list[Condition] = []

    def query(self) -> PatternQuery:
        chronicle = self._chronicle
        sources = tuple(self._sources.found.values())
        plan = self._checked(self._plan(sources))
        valid = END if chronicle.emitted is None else _EMITTED
        results = tuple(map(self._result, chronicle.head))
        delay = chronicle.max_delay
        return PatternQuery(chronicle.name, sources, (plan,), results, valid, max_delay=delay)

    def _plan(self, sources: tuple[Source, ...]) -> PatternPlan:
        chronicle = self._chronicle
        elements = tuple(
            Element(each.point, (self._kind(each.message),), self._objects(each.message))
            for each in chronicle.events
        )
        for number, event in enumerate(chronicle.events):
            self._bind_objects(event.message, number)
        for number, event in enumerate(chronicle.events):
            self._bind_values(event.message, number)
        for number, event in enumerate(chronicle.events):
            self._test_values(event.message, number)
        for each in chronicle.comparisons:
            left, right = self._operand(each.left), self._operand(each.right)
            self._conditions.append(Condition(each.operator, left, right))
        names = dict.fromkeys(each.column for source in sources for each in source.columns)
        kinds = {each.column: each.kind for source in sources for each in source.columns}
        try:
            return PatternPlan(
                tuple(Column(name, column_type(kinds[name] or Kind.NUMBER)) for name in names),
                elements,
                tuple(self._between()),
                tuple(self._same),
                tuple(self._conditions),
                tuple(probe for each in chronicle.probes for probe in self._probes(each)),
                outputs=tuple(self._outputs()),
            )
        except PlanError as error:
            span = chronicle.span
            if error.elements:
                span = chronicle.events[error.elements[0]].span
            raise self._error(error.message, span, error.hint) from None

    # -- events ------------------------------------------------------------------------------

    def _kind(self, message: Message) -> str:
        return self._sources.found[message.concept].kind

    def _bind_objects(self, message: Message, number: int) -> None:
        for name, column in self._variables(message):
            self._equal(name, Value(number, column))

    def _bind_values(self, message: Message, number: int) -> None:
        for test, column in _tests(message):
            if not isinstance(test.operand, Variable) or test.operator != "=":
                continue
            value = Value(number, column)
            self._equal(test.operand.name, value)
            if test is message.before:
                # The first sample has none before, and what is missing does not equal itself.
                self._conditions.append(Condition("=", value, value))

    def _equal(self, name: str, value: Value) -> None:
        """Demand that a variable equals a value, or take the value for the variable's."""
        if name in self._fixed:
            self._conditions.append(Condition("=", value, self._operand(Variable(name))))
            return
        before = self._bound.setdefault(name, value)
        if before == value:
            return
        if self._chronicle.variables[name].kind in (Kind.TEXT, Kind.OBJECT):
            self._same.append(Same(before.element, before.column, value.element, value.column))
        else:
            self._conditions.append(Condition("=", before, value))

    def _test_values(self, message: Message, number: int) -> None:
        for test, column in _tests(message):
            if not isinstance(test.operand, Variable) or test.operator != "=":
                self._conditions.append(self._condition(test, Value(number, column)))

    # -- what is asked besides events --------------------------------------------------------

    def _probes(self, clause: Occurs | Hold) -> Iterator[Probe]:
        message = clause.message
        kinds, objects = (self._kind(message),), self._objects(message)
        what = Element(shorten(message.concept), kinds, objects)
        low, high = self._time(clause.start, 1), self._time(clause.end, -1)
        same = tuple(
            Same(OWN, column, self._bound[name].element, self._bound[name].column)
            for name, column in self._variables(message)
            if name not in self._fixed
        )
        tests = [self._condition(test, Value(OWN, column)) for test, column in _tests(message)]
        match clause:
            case Occurs(least, most):
                yield CountProbe(what, low, high, least, most, same, tuple(tests))
            case Hold():
                yield StateProbe(what, self._time(clause.start), same, tuple(tests))
                end = self._time(clause.end)
                # Without a test the state has to be known only.
                for test in tests:
                    opposite = Condition(_OPPOSITE[test.operator], test.left, test.right)
                    yield CountProbe(what, low, end, same=same, conditions=(opposite,))
            case _:
                assert_never(clause)

    def _time(self, moment: Moment, more: int = 0) -> Bound:
        return Bound(Point(self._places[moment.point]), _known(moment.offset) + more)

    # -- objects and values ------------------------------------------------------------------

    def _objects(self, message: Message) -> tuple[Condition, ...]:
        """The conditions on the objects of a message that its source leaves open."""
        found = []
        for i, argument in enumerate(message.arguments):
            iri = self._object(argument)
            if iri is not None and self._is_open(message, i):
                value = Value(OWN, object_column(i))
                found.append(Condition("=", value, Key(object_key(iri))))
        return tuple(found)

    def _object(self, argument: Named) -> str | None:
        match argument:
            case ObjectConstant(iri):
                return iri
            case Variable(name):
                return self._fixed.get(name)
            case None:
                return None

    def _is_open(self, message: Message, argument: int) -> bool:
        return self._sources.found[message.concept].arguments[argument].object is None

    def _variables(self, message: Message) -> Iterator[tuple[str, str]]:
        """The variables that are objects of a message and vary, with their columns."""
        for i, argument in enumerate(message.arguments):
            if isinstance(argument, Variable) and argument.name not in self._fixed:
                yield argument.name, object_column(i)

    def _condition(self, test: Test, value: Value) -> Condition:
        return Condition(test.operator, value, self._operand(test.operand))

    def _operand(self, operand: Operand) -> Expression:
        match operand:
            case Variable(name):
                if name in self._fixed:
                    return Key(object_key(self._fixed[name]))
                return self._bound[name]
            case ObjectConstant(iri):
                return Key(object_key(iri))
            case Constant(value, Kind.TEXT):
                return Key(text_key(str(value)))
            case Constant(value, kind):
                assert not isinstance(value, str)
                return Number(float(value) if kind is Kind.NUMBER else int(value))
            case Calculation():
                return Number(_calculated(operand))
            case Parameter(name):
                raise ValueError(f"the parameter ?{name} has no value: call with_arguments first")
            case _:
                assert_never(operand)

    # -- times -------------------------------------------------------------------------------

    def _between(self) -> Iterator[Between]:
        for number, event in enumerate(self._chronicle.events):
            first = self._places[event.point]
            if first != number:
                yield Between(Point(first), Point(number), 0, 0)
        for each in self._chronicle.distances:
            points = Point(self._places[each.first]), Point(self._places[each.second])
            bounds = (None if d is None else _known(d) for d in (each.least, each.most))
            yield Between(*points, *bounds)

    def _outputs(self) -> Iterator[Output]:
        everything = tuple(range(len(self._chronicle.events)))
        yield Output(START, Time(everything, is_start=True))
        yield Output(END, Time(everything))
        if self._chronicle.emitted is not None:
            yield Output(_EMITTED, Time((self._places[self._chronicle.emitted],)))
        for name in self._chronicle.head:
            yield Output(name, self._operand(Variable(name)))

    def _result(self, name: str) -> Result:
        meaning = self._chronicle.variables[name]
        is_object = meaning.sort is not None
        return Result(name, meaning.kind, self._sources.argument_of(name) if is_object else None)

    # -- errors ------------------------------------------------------------------------------

    def _checked(self, plan: PatternPlan) -> PatternPlan:
        """Refuse contradictory times, and samples that would be kept for ever."""
        events = self._chronicle.events
        try:
            network = minimal_network(plan)
        except PlanError as error:
            raise self._error(error.message, events[error.elements[0]].span, error.hint) from None
        try:
            assert network.retention
            for probe in plan.probes:
                network.probe_retention(probe)
        except UnboundedRetention as error:
            first = error.elements[0]
            event = events[first]
            later = network.greatest[first]
            other = next(each.point for i, each in enumerate(events) if later[i] >= INFINITE)
            raise self._error(
                f"the samples would be kept for ever, as `{other}` may come at any time after "
                f"`{event.point}`",
                event.span,
                f"bound it: `{other} - {event.point} <= 1m`",
            ) from None
        return plan

    def _error(self, message: str, span: Span, hint: str) -> LanguageError:
        return LanguageError(message, self._text, span, hint)


def _tests(message: Message) -> Iterator[tuple[Test, str]]:
    """The tests of a message, each with the column that it reads."""
    if message.kind is None:
        return
    if message.before is not None:
        yield message.before, before_column(message.kind)
    if message.value is not None:
        yield message.value, value_column(message.kind)


def _calculated(operand: object) -> float:
    """The number that a converted parameter of a request is."""
    match operand:
        case Calculation("*", left, right):
            return _calculated(left) * _calculated(right)
        case Calculation("+", left, right):
            return _calculated(left) + _calculated(right)
        case Constant(value):
            return float(value)
        case _:
            raise ValueError(f"{operand} is no number")


def _known(duration: Duration) -> int:
    assert isinstance(duration, int), "a request gives the durations of a template"
    return duration
