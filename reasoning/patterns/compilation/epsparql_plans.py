"""EP-SPARQL patterns as pattern queries: a plan for each branch (SPEC §8).

| EP-SPARQL | in the plan |
|---|---|
| a triple of a feature | an element; its constants are conditions of its own |
| a variable | equal keys, or equal values |
| SEQ | each end on the left is before each start on the right |
| EQUALS | equal hulls |
| WITHIN, and a bound on the duration of the whole | ``within`` |
| a bound on the duration of a group | bounds between all pairs |
| another condition | a condition; with ``||`` a test of the outputs |
| a condition on static values | a test of the static join |
| UNION, optional operators | several plans (`epsparql_branches`) |
| static triples | a static join |
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Final, assert_never

from ....languages.epsparql.ast import DURATION as GET_DURATION
from ....languages.epsparql.ast import START_TIME
from ....languages.epsparql.binding import bound_epsparql, horizon
from ....languages.epsparql.checked import And as AndCondition
from ....languages.epsparql.checked import (
    Calculation,
    CheckedPattern,
    Comparison,
    Condition,
    Duration,
    Item,
    Or,
    Sample,
    StaticVariable,
    TimeOf,
    Value,
    Variable,
    kind_of,
)
from ....languages.epsparql.expressions import bound_of_duration
from ....languages.errors import LanguageError, Span
from ....languages.mtl.checked import Constant, Kind, ObjectConstant, Parameter
from ....sparql.ast import variables_of
from ....streams.time import SECOND
from ..evaluation.packing import pack
from ..plans import plan, query
from ..plans.network import ContradictoryTimes, UnboundedRetention, minimal_network
from ..plans.plan import NO_VALUE, OWN, ColumnType, PatternPlan, PlanError
from ..plans.query import PatternQuery, Source, object_column
from .epsparql_branches import Alone, Branch, branches_of, places_of
from .epsparql_sources import VALUES, Argued, PatternSources

MOST_PLANS: Final = 32
"""Of alternatives, and of those that exclude matches of others."""
_WITHIN: Final = (
    'write `WITHIN 10 min` at the end, or `FILTER (getDURATION() < "PT10M"^^xsd:duration)` after '
    "the last `}`"
)


def epsparql_query(pattern: CheckedPattern, arguments: Argued | None = None) -> PatternQuery:
    """Compile a pattern. ``arguments`` are values of a template's parameters; a parameter of
    objects may be left out.

    Raises `LanguageError` for a pattern without a horizon, for times that contradict each other,
    for too many alternatives or elements, and where no alternative has a solution.
    """
    given = arguments or {}
    pattern = bound_epsparql(pattern, given)
    samples, branches = branches_of(pattern, frozenset(given))
    return _Compiler(pattern, given, samples).compile(branches)


def epsparql_sources(pattern: CheckedPattern, arguments: Argued) -> tuple[Source, ...]:
    """Return what a pattern reads, which does not depend on the values of its parameters. Raises
    `LanguageError`."""
    values = {slot.name for slot in pattern.slots if isinstance(slot, Parameter)}
    samples, _ = branches_of(pattern, frozenset(values | arguments.keys()))
    return PatternSources(samples, arguments).sources


class _Compiler:
    def __init__(
        self, pattern: CheckedPattern, arguments: Argued, samples: tuple[Sample, ...]
    ) -> None:
        self._pattern = pattern
        self.samples = samples
        self.sources = PatternSources(samples, arguments)
        self.has_intervals = any(sample.is_event for sample in samples)
        self._plans: list[PatternPlan] = []
        self._branches: list[query.Branch] = []
        self._known: dict[Branch, int] = {}

    def compile(self, branches: tuple[Branch, ...]) -> PatternQuery:
        given = frozenset(branches)
        for branch in branches:
            self._add(branch, given)
        return PatternQuery(
            self._pattern.name,
            self.sources.sources,
            tuple(self._plans),
            tuple(map(self.sources.result, self._pattern.items)),
            branches=tuple(self._branches),
            graphs=self._pattern.graphs,
            max_delay=self._pattern.max_delay,
        )

    # -- plans -------------------------------------------------------------------------------

    def _add(self, branch: Branch, given: frozenset[Branch]) -> int:
        """Add the plan of a branch, after those that it depends on; return its number."""
        if branch in self._known:
            return self._known[branch]
        others = [self._add(each.branch, given) for each in branch.absences]
        if len(self._plans) == MOST_PLANS:
            raise self.error(
                f"the optional operators need more than {MOST_PLANS} plans",
                None,
                "register parts of the pattern, and read their results",
            )
        is_given = branch in given
        building = _Plan(self, branch)
        made, tests = building.build(
            self._pattern.items if is_given else (), horizon(self._pattern)
        )
        self._check_times(made, branch)
        absences = tuple(
            building.absence(alone, other)
            for alone, other in zip(branch.absences, others, strict=True)
        )
        static = building.static(self._pattern.items) if branch.static else None
        self._plans.append(building.with_outputs(made))
        self._branches.append(query.Branch(tests, absences, static, is_given))
        self._known[branch] = len(self._plans) - 1
        return self._known[branch]

    def _check_times(self, made: PatternPlan, branch: Branch) -> None:
        try:
            pack(query.with_numbers(made, query.Keys()), minimal_network(made), is_ordered=True)
        except UnboundedRetention as error:
            raise self._plan_error(error, branch, _WITHIN) from None
        except ContradictoryTimes as error:
            raise self._plan_error(error, branch, "no solution meets all of them") from None
        except PlanError as error:
            raise self._plan_error(error, branch, error.hint) from None

    def _plan_error(self, error: PlanError, branch: Branch, hint: str) -> LanguageError:
        span = None
        if error.elements:
            span = self.samples[sorted(branch.samples)[error.elements[0]]].span
        return self.error(error.message, span, hint)

    def error(self, message: str, span: Span | None, hint: str) -> LanguageError:
        """An error at a place of the text; None: the whole pattern."""
        where = self._pattern.where.span
        return LanguageError(message, self._pattern.source, span or where, hint)


@dataclass
class _Plan:
    """The plan of one branch, in the making."""

    compiler: _Compiler
    branch: Branch
    outputs: dict[str, plan.Expression] = field(default_factory=dict)
    """Outputs that are no results, by name."""

    def __post_init__(self) -> None:
        self.places = {sample: i for i, sample in enumerate(sorted(self.branch.samples))}
        self._carriers: dict[str, list[plan.Expression]] = {}
        self._static_values: dict[StaticVariable, str] = {}
        """The outputs with the static values that tests read."""
        self._static_tests: list[query.Test] = []

    def build(
        self, items: tuple[Item, ...], within: int | None
    ) -> tuple[PatternPlan, tuple[query.Test, ...]]:
        """The plan with its results, and the tests of its matches."""
        compiler = self.compiler
        elements = [self._element(sample) for sample in self.places]
        same, conditions = self._equalities()
        between = [each for sides in self.branch.sequences for each in self._before(*sides)]
        hulls = []
        for left, right in self.branch.equals:
            hulls.append(plan.EqualHulls(self._of(left), self._of(right)))
            if len(left) == len(right) == 1:
                between += self._equal_points(self.places[left[0]], self.places[right[0]])
        tests: list[query.Test] = []
        for scoped in self.branch.conditions:
            node = scoped.node
            assert isinstance(node, Comparison | Or)
            most = bound_of_duration(node)
            if most is not None:
                if within is None or within > most:
                    between += self._lasting(scoped.samples, most)
            elif _is_static(node):
                self._static_tests.append(self._test(node, scoped.samples))
            elif isinstance(node, Comparison):
                conditions.append(self._condition(node, scoped.samples))
            else:
                tests.append(self._test(node, scoped.samples))
        everything = tuple(self.places.values())
        outputs = [
            plan.Output(query.START, plan.Time(everything, is_start=True)),
            plan.Output(query.END, plan.Time(everything)),
            *(plan.Output(item.name, self._result(item)) for item in items),
        ]
        try:
            made = PatternPlan(
                compiler.sources.columns,
                tuple(elements),
                tuple(between),
                tuple(same),
                tuple(conditions),
                within=within,
                has_intervals=compiler.has_intervals,
                hulls=tuple(hulls),
                is_distinct=False,
                outputs=tuple(outputs),
            )
        except PlanError as error:
            raise compiler.error(error.message, None, error.hint) from None
        return made, tuple(tests)

    def with_outputs(self, made: PatternPlan) -> PatternPlan:
        """The plan with the outputs that tests, absences and static joins read."""
        more = tuple(plan.Output(name, value) for name, value in self.outputs.items())
        return replace(made, outputs=made.outputs + more)

    def absence(self, alone: Alone, other: int) -> query.Absence:
        theirs = {sample: i for i, sample in enumerate(sorted(alone.branch.samples))}
        rows = tuple((self.places[each], theirs[each]) for each in alone.kept)
        until = None
        if alone.is_equal:
            until = self._output("until", plan.Time(self._of(alone.kept)))
        return query.Absence(other, rows, until)

    def static(self, items: tuple[Item, ...]) -> query.StaticJoin:
        triples = tuple((each.triple, each.graph) for each in self.branch.static)
        known = {
            each.name: each
            for number in self.branch.samples
            for each in places_of(self.compiler.samples[number])
            if isinstance(each, Variable)
        }
        for name, bind in self.branch.binds:
            assert not isinstance(bind.node, Comparison | Or)
            known.setdefault(name, Variable(name, kind_of(bind.node)))
        variables = []
        for name in dict.fromkeys(name for each, _ in triples for name in variables_of(each)):
            place = self.compiler.sources.constant(known.get(name) or Variable(name, Kind.OBJECT))
            if not isinstance(place, Variable) or name in known:
                output = self._output("static", self.expression(place, self.branch.samples))
                variables.append((name, output, kind_of(place)))
        results = tuple(
            (item.value.name, item.name)
            for item in items
            if isinstance(item.value, StaticVariable)
            and item.value.name in self.branch.static_names
        )
        calculated = tuple(
            (item.name, self._calculated(item))
            for item in items
            if isinstance(item.value, Calculation) and self._is_calculated(item.value)
        )
        values = tuple(
            (each.name, output, each.kind) for each, output in self._static_values.items()
        )
        tests = tuple(self._static_tests)
        return query.StaticJoin(triples, tuple(variables), results, values, tests, calculated)

    # -- elements, keys, times ---------------------------------------------------------------

    def _of(self, samples: tuple[int, ...]) -> tuple[int, ...]:
        return tuple(self.places[each] for each in samples)

    def _element(self, number: int) -> plan.Element:
        """The element of a sample; what it has of its variables is noted."""
        sample = self.compiler.samples[number]
        place = self.places[number]
        columns = [object_column(i) for i in range(len(sample.arguments))]
        columns.append(VALUES[query.column_type(sample.kind)])
        own: list[plan.Condition] = []
        for column, each in zip(columns, places_of(sample), strict=True):
            found = self.compiler.sources.constant(each)
            if isinstance(found, Variable):
                self._carriers.setdefault(found.name, []).append(plan.Value(place, column))
            elif column == columns[-1]:
                value = plan.Value(OWN, column)
                own.append(plan.Condition("=", value, self.expression(found, ())))
        kind = self.compiler.sources.kinds[number]
        same = sum(
            self.compiler.sources.kinds[other] == kind for other in self.places if other < number
        )
        return plan.Element(f"{kind}{f' ({same + 1})' if same else ''}", (kind,), tuple(own))

    def _equalities(self) -> tuple[list[plan.Same], list[plan.Condition]]:
        """What is equal by shared variables: keys, or values of one kind."""
        for name, scoped in self.branch.binds:
            assert not isinstance(scoped.node, Comparison | Or)
            value = self.expression(scoped.node, scoped.samples)
            self._carriers.setdefault(name, []).append(value)
        same: list[plan.Same] = []
        conditions: list[plan.Condition] = []
        for first, *others in self._carriers.values():
            for other in others:
                match first, other:
                    case plan.Value(a, column), plan.Value(b, another) if a != b and (
                        self._is_key(column) and self._is_key(another)
                    ):
                        same.append(plan.Same(a, column, b, another))
                    case _:
                        conditions.append(plan.Condition("=", first, other))
        return same, conditions

    def _is_key(self, name: str) -> bool:
        return all(
            each.type is ColumnType.KEY
            for each in self.compiler.sources.columns
            if each.name == name
        )

    def _before(self, left: tuple[int, ...], right: tuple[int, ...]) -> Iterator[plan.Between]:
        for one in self._of(left):
            for other in self._of(right):
                yield plan.Between(plan.Point(one), plan.Point(other, is_start=True), 1)

    def _equal_points(self, one: int, other: int) -> Iterator[plan.Between]:
        for is_start in (False, True):
            yield plan.Between(plan.Point(one, is_start), plan.Point(other, is_start), 0, 0)

    def _lasting(self, samples: tuple[int, ...], most: int) -> Iterator[plan.Between]:
        for one in self._of(samples):
            for other in self._of(samples):
                yield plan.Between(plan.Point(one, is_start=True), plan.Point(other), None, most)

    # -- conditions and values ---------------------------------------------------------------

    def _condition(self, node: Comparison, samples: tuple[int, ...]) -> plan.Condition:
        left, right = (self.expression(side, samples) for side in (node.left, node.right))
        return plan.Condition(node.operator, left, right)

    def _test(self, node: Condition, samples: tuple[int, ...]) -> query.Test:
        match node:
            case Comparison(sign, left, right):
                sides = (self._side(each, samples) for each in (left, right))
                return query.OutputComparison(next(sides), sign, next(sides))
            case AndCondition(operands):
                return query.AllOf(tuple(self._test(each, samples) for each in operands))
            case Or(operands):
                return query.AnyOf(tuple(self._test(each, samples) for each in operands))
            case _:
                raise AssertionError("branches decide BOUND and truths")

    def _side(self, value: Value, samples: tuple[int, ...]) -> query.OutputTerm:
        """A side of a test. What has static values is calculated when these are known."""
        match value:
            case StaticVariable(name, kind):
                return self._static_values.setdefault(value, f"static {kind} {name}")
            case Calculation(sign, left, right) if _has_static(value):
                return query.OutputArithmetic(
                    self._side(left, samples), sign, self._side(right, samples)
                )
            case _:
                return self._output("side", self.expression(value, samples))

    def _output(self, word: str, value: plan.Expression) -> str:
        """The name of an output that is no result. No variable has a space in its name."""
        for name, known in self.outputs.items():
            if known == value:
                return name
        name = f"{word} {len(self.outputs) + 1}"
        self.outputs[name] = value
        return name

    def _result(self, item: Item) -> plan.Expression:
        everything = self.branch.samples
        value = self.compiler.sources.constant(item.value)
        if self._has_value(value):
            found = self.expression(value, everything)
            return (
                plan.Arithmetic("/", found, plan.Constant(float(SECOND)))
                if (item.kind == Kind.DURATION)
                else found
            )
        is_number = item.kind in (Kind.NUMBER, Kind.DURATION)
        return plan.Constant(math.nan if is_number else NO_VALUE)

    def _has_value(self, value: Value) -> bool:
        match value:
            case StaticVariable():
                return False  # in the plan: the static join gives it
            case Variable(name):
                return name in self._carriers or name in self.compiler.sources.arguments
            case Calculation(_, left, right):
                return self._has_value(left) and self._has_value(right)
            case _:
                return True

    def _is_calculated(self, value: Value) -> bool:
        """Whether the static join completes a value: it reads static ones, and all are known."""

        def is_known(value: Value) -> bool:
            match value:
                case StaticVariable(name):
                    return name in self.branch.static_names
                case Calculation(_, left, right):
                    return is_known(left) and is_known(right)
                case _:
                    return self._has_value(value)

        return _has_static(value) and is_known(value)

    def _calculated(self, item: Item) -> query.OutputTerm:
        found = self._side(item.value, self.branch.samples)
        if item.kind is Kind.DURATION:
            second = self._output("side", plan.Constant(float(SECOND)))
            return query.OutputArithmetic(found, "/", second)
        return found

    def expression(self, value: Value, samples: tuple[int, ...]) -> plan.Expression:
        """A value in the plan. Durations and times are in ns."""
        value = self.compiler.sources.constant(value)
        match value:
            case Variable(name):
                return self._carriers[name][0]
            case ObjectConstant(iri):
                return plan.Key(query.object_key(iri))
            case Constant(found, Kind.TEXT):
                return plan.Key(query.text_key(str(found)))
            case Constant(found, Kind.NUMBER):
                return plan.Constant(float(found))
            case Constant(found):
                return plan.Constant(int(found))
            case Duration(duration):
                return plan.Constant(duration)
            case TimeOf(function):
                end = plan.Time(self._of(samples))
                start = plan.Time(self._of(samples), is_start=True)
                if function == GET_DURATION:
                    return plan.Arithmetic("-", end, start)
                return start if function == START_TIME else end
            case Calculation(sign, left, right):
                return plan.Arithmetic(
                    sign, self.expression(left, samples), self.expression(right, samples)
                )
            case StaticVariable():
                raise AssertionError("a static join gives its value")
            case _:
                assert_never(value)


def _is_static(condition: Condition) -> bool:
    """Whether a condition reads a value of static triples."""
    match condition:
        case Comparison(_, left, right):
            return _has_static(left) or _has_static(right)
        case AndCondition(operands) | Or(operands):
            return any(map(_is_static, operands))
        case _:
            return False


def _has_static(value: Value) -> bool:
    match value:
        case StaticVariable():
            return True
        case Calculation(_, left, right):
            return _has_static(left) or _has_static(right)
        case _:
            return False
