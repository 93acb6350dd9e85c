"""Queries that differ in constants only, as one continuous query (DESIGN §3 "Sharing").

`form_of` says of a query what it has to agree on with others; `AlikeEvaluator` computes those that
do: the windows are kept once, the plan is computed once, and joined with the table of the constants
in which the queries differ (`cohorts.Together`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import ceil

from ...languages.csparql.ast import ContinuousQuery
from ...rdf.dictionary import Term, TermDictionary
from ...streams.time import SECOND
from ..algebra.constant_lifting import Pattern, fitted, lifted, lowered, place
from ..algebra.expressions import Const, Var
from ..algebra.options import Options
from ..algebra.plan import Plan, Query
from ..algebra.plan_text import show
from ..algebra.rewrite_rules import optimize
from ..algebra.template_parameters import Joint, Unfit, described, joint
from ..algebra.unsupported import Unsupported
from ..columns.budget import UNLIMITED, Budget
from ..estimation.estimates import estimate
from ..estimation.input_rates import NOTHING_KNOWN, Flow
from ..estimation.pattern_sizes import Known
from ..evaluation.solver import QueryBody
from ..incremental.aggregate_shape import shape_of
from ..operators.background import Background
from ..operators.entailment import PatternNeeds
from ..operators.sources import StaticSide
from ..pattern_join.plan_cut import pattern_parts, served_parts
from ..windows.grid import Schedule, schedule
from .cohorts import Place, Together
from .instance_results import InstanceResults
from .shared_windows import SharedWindows, own_solutions, own_windows

READING = 200_000, 300
"""ns a step, and ns a sample, for a query by itself to read its streams (`bench/requests.py`: of
1,000 samples 0.6 ms). Estimates of plans have only what their patterns select."""
MOST_ALONE = 1_000_000_000
"""The greatest number of queries to return: estimates have no such bound."""
_MOST_CONSTANTS = 128
"""Of a query that may share: what it might share is planned while everybody waits."""


class Unshared(Exception):
    """A query that is evaluated alone; the message says why."""


@dataclass(frozen=True, slots=True)
class Form:
    """What queries agree on that can share windows and plan: ``query`` has variables for their
    constants (`constant_lifting`), but for those that the plan has to have."""

    schedule: Schedule
    options: Options
    static_named: tuple[str, ...]
    query: Query

    def joint(self, pattern: Pattern) -> Joint:
        """How the queries that fit ``pattern`` are computed together; raises `Unshared`."""
        names = list(dict.fromkeys(one.name for one in pattern if isinstance(one, Var)))
        found = lowered(self.query, pattern)
        try:
            return joint(Query(found.head, optimize(found.plan)[0]), names)
        except Unfit as unfit:
            raise Unshared(str(unfit)) from unfit


def form_of(
    query: ContinuousQuery, inputs: Sequence[str], options: Options
) -> tuple[Form, tuple[Term, ...]]:
    """The form of a query over these inputs, and its constants.

    Raises `Unshared` for one that would say something else among others: where it matters when it
    began, or in which order solutions are found. Cost: that of planning it.
    """
    windows = schedule(query, inputs, options)
    _refuse(own_windows(query, windows, options))
    try:
        found = QueryBody.of(query, windows).translate({})
    except (Unsupported, ValueError) as error:
        raise Unshared(f"it runs on Oxigraph, because of {error}") from error
    _refuse(own_solutions(found))
    form, constants = _fit(found)
    return Form(windows, options, query.static_named, form), constants


def _refuse(reason: str) -> None:
    if reason:
        raise Unshared(reason)


def _fit(query: Query) -> tuple[Query, tuple[Term, ...]]:
    """``query`` with the constants taken out that can be parameters."""
    found = lifted(query)
    if len(found.constants) > _MOST_CONSTANTS:
        raise Unshared(f"it has {len(found.constants)} constants, more than {_MOST_CONSTANTS}")
    pattern: list[Term | Var] = [Var(place(i)) for i in range(len(found.constants))]
    while True:
        kept = [i for i, one in enumerate(pattern) if isinstance(one, Var)]
        form = lowered(found.query, pattern)
        try:
            joint(Query(form.head, optimize(form.plan)[0]), [place(i) for i in kept])
        except Unfit as unfit:
            if not unfit.name:
                raise Unshared(str(unfit)) from unfit
            fixed = {Var(name) for name in (unfit.name, *unfit.also)}
            pattern = [found.constants[i] if one in fixed else one for i, one in enumerate(pattern)]
            continue
        for number, i in enumerate(kept):
            pattern[i] = Var(place(number))
        return lowered(found.query, pattern), tuple(found.constants[i] for i in kept)


def worth_from(
    form: Form,
    pattern: Pattern,
    constants: Sequence[Term],
    static: StaticSide,
    flows: Mapping[str, Flow],
) -> int:
    """How many queries, each by itself, are likely to cost what one costs that computes all that
    fit ``pattern``: one with these ``constants`` is an example. ``flows`` is what is known of the
    inputs, by name.

    A plan without its constants may be far larger: where an object that a query names was all that
    kept its joins small. Cost: that of planning both, and as `estimate`.
    """
    own = optimize(lowered(form.query, constants).plan)[0]
    known = Known(form.schedule, static, flows, form.options.semantics == "set")
    together, alone = (_likely(plan, known) for plan in (form.joint(pattern).plan, own))
    return max(1, min(ceil(together / alone), MOST_ALONE))


def _reading(known: Known) -> float:
    """What a query by itself takes to read its streams, for a step, in ns."""
    schedule = known.schedule
    inputs = dict.fromkeys(one.input for one in schedule.windows)
    step = 1.0 if schedule.ends is None else schedule.ends.step / SECOND
    rows = sum(known.flows.get(name, NOTHING_KNOWN).any.rate * step for name in inputs)
    call, row = READING
    return call + row * rows


def _likely(plan: Plan, known: Known) -> float:
    """What a plan is likely to cost a window, in ns."""
    found = shape_of(plan, known.static) if known.schedule.uniform else ""
    if isinstance(found, str):
        plan = pattern_parts(plan)
        costs = estimate(plan, known, None, tuple(served_parts(plan)))
    else:
        costs = estimate(plan, known, found)
    return _reading(known) + sum(cost.nanoseconds for cost in costs.values())


class AlikeEvaluator(SharedWindows):
    """The queries of one form that fit one pattern, over named inputs. ``query`` is any of them.

    Law (tests/laws/engine/test_shared_queries.py): ``of(i)`` of a window is what a
    `ContinuousEvaluator` of query i gives for it, from the first window on that closes after `add`
    and until `remove`.

    Cost: that of one query, then O(its solutions + what it gives out). Memory: the rows of the open
    windows, partial aggregates once; a query as `InstanceTable` says, and its text.
    """

    def __init__(
        self,
        query: ContinuousQuery,
        form: Form,
        pattern: Pattern,
        dictionary: TermDictionary,
        background: Background,
        inputs: Sequence[str],
        budget: Budget = UNLIMITED,
    ) -> None:
        super().__init__(query, dictionary, background, inputs, form.options, budget)
        self._windows.entailment.needs = PatternNeeds.of(form.joint(pattern).plan)
        self.pattern = pattern
        self._queries: dict[int, ContinuousQuery] = {}
        self._next = 0
        self._cohort = Together(
            lambda number, _: self._queries[number],
            self._windows,
            self._static,
            Place((), 0),
            form.joint(pattern),
            alone=True,
        )

    def __len__(self) -> int:
        """How many queries there are."""
        return len(self._queries)

    def add(self, query: ContinuousQuery, constants: Sequence[Term]) -> int:
        """A new query with its constants, which fit the pattern; by its number, never given again.
        It has results from the next window on that closes."""
        terms = fitted(self.pattern, constants)
        if terms is None:
            raise ValueError("the query differs in more than the parameters")
        number, self._next = self._next, self._next + 1
        self._cohort.add(number, terms)
        self._queries[number] = query
        return number

    def remove(self, instance: int) -> None:
        del self._queries[instance]
        self._cohort.remove(instance)

    def explain(self) -> str:
        """What the queries differ in, and the plan that is computed once."""
        lines = [f"one of {len(self)} queries that differ in constants, computed together"]
        lines += described(self._cohort.joint, {})
        lines.append("computed once, then joined with the table of their constants:")
        lines += [f"  {line}" for line in self._cohort.explain().splitlines()]
        return "\n".join(lines)

    def explain_of(self, constants: Sequence[Term], flows: Mapping[str, Flow]) -> str:
        """The same for the query with these constants, with what the plan is likely to cost;
        ``flows`` is what is known of the inputs, by name."""
        terms = fitted(self.pattern, constants) or {}
        first, *rest = self.explain().splitlines()
        own = [f"here {show(Var(name))} is {show(Const(term))}" for name, term in terms.items()]
        costs = [f"  {line.rstrip()}" for line in self._cohort.costs(flows)]
        told = "costs a window, of all of them: rows out, own time (estimates are rough):"
        return "\n".join([first, *own, *rest, told, *costs])

    def _evaluate(self, end: int, reports: bool) -> bool:
        self._cohort.fold(end)
        if reports and self._queries:
            parts = self._cohort.results(end, reports=reports)
            self._results.append(InstanceResults(*self._windows.span(end), parts))
        # What is done to the joined solutions may need Oxigraph, which reads the rows.
        return True
