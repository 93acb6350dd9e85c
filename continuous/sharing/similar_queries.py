"""Queries that differ in constants only, as one continuous query (DESIGN §3 "Sharing").

`form_of` returns the part of a query that others must have in common with it.
`SimilarQueriesEvaluator` evaluates queries of one form. It stores the windows once, computes the
plan once, and joins it with the table of the constants in which the queries differ
(`cohorts.JoinedCohort`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import ceil

from ...languages.csparql.ast import ContinuousQuery
from ...rdf.dictionary import Term, TermDictionary
from ...streams.time import SECOND
from ..algebra.constant_lifting import (
    Pattern,
    constant_variable,
    lift_constants,
    match_constants,
    put_constants,
)
from ..algebra.expressions import Const, Var
from ..algebra.options import Options
from ..algebra.plan import Plan, Query
from ..algebra.plan_text import show
from ..algebra.rewrite_rules import optimize
from ..algebra.template_parameters import Joint, Unfit, build_joint, describe_parameters
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
from .cohorts import CohortId, JoinedCohort
from .instance_results import InstanceResults
from .shared_windows import SharedWindows, own_solutions, own_windows

READ_COST = 200_000, 300
"""The cost of a single query to read its streams: ns per step, ns per sample
(`bench/queries/requests.py`: 0.6 ms for 1,000 samples). Estimates of plans only include the triples
that patterns select."""
MOST_QUERIES = 1_000_000_000
"""The greatest number of queries to return: estimates have no such bound."""
_MOST_CONSTANTS = 128
"""The limit of constants in a query that may share: planning it blocks other requests."""


class Unshared(Exception):
    """The query is evaluated alone; the message says why."""


@dataclass(frozen=True, slots=True)
class Form:
    """The common part of queries that can share windows and plan. ``query`` has variables instead
    of their constants (`constant_lifting`), except constants that the plan depends on."""

    schedule: Schedule
    options: Options
    static_named: tuple[str, ...]
    query: Query

    def build_joint(self, pattern: Pattern) -> Joint:
        """Return how queries that match ``pattern`` are computed together. Raises `Unshared`."""
        names = list(dict.fromkeys(one.name for one in pattern if isinstance(one, Var)))
        query = put_constants(self.query, pattern)
        try:
            return build_joint(Query(query.head, optimize(query.plan)[0]), names)
        except Unfit as unfit:
            raise Unshared(str(unfit)) from unfit


def form_of(
    query: ContinuousQuery, inputs: Sequence[str], options: Options
) -> tuple[Form, tuple[Term, ...]]:
    """Return the form of a query over these inputs, and its constants.

    Raises `Unshared` if sharing would change its results: they depend on when it started, or on the
    order of solutions. Cost: that of planning it.
    """
    windows = schedule(query, inputs, options)
    _refuse(own_windows(query, windows, options))
    try:
        translated = QueryBody.of(query, windows).translate({})
    except (Unsupported, ValueError) as error:
        raise Unshared(f"it runs on Oxigraph, because of {error}") from error
    _refuse(own_solutions(translated))
    form, constants = _fit(translated)
    return Form(windows, options, query.static_named, form), constants


def _refuse(reason: str) -> None:
    if reason:
        raise Unshared(reason)


def _fit(query: Query) -> tuple[Query, tuple[Term, ...]]:
    """Replace constants by parameters, as far as the plan allows."""
    found = lift_constants(query)
    if len(found.constants) > _MOST_CONSTANTS:
        raise Unshared(f"it has {len(found.constants)} constants, more than {_MOST_CONSTANTS}")
    pattern: list[Term | Var] = [Var(constant_variable(i)) for i in range(len(found.constants))]
    while True:
        kept = [i for i, one in enumerate(pattern) if isinstance(one, Var)]
        form = put_constants(found.query, pattern)
        try:
            build_joint(
                Query(form.head, optimize(form.plan)[0]), [constant_variable(i) for i in kept]
            )
        except Unfit as unfit:
            if not unfit.name:
                raise Unshared(str(unfit)) from unfit
            # Each round plans the query, so all parameters that are known to be unfit go at once.
            fixed = {Var(name) for name in (unfit.name, *unfit.also)}
            pattern = [found.constants[i] if one in fixed else one for i, one in enumerate(pattern)]
            continue
        # The form numbers its parameters as the returned constants stand: without gaps.
        for number, i in enumerate(kept):
            pattern[i] = Var(constant_variable(number))
        return put_constants(found.query, pattern), tuple(found.constants[i] for i in kept)


def break_even_count(
    form: Form,
    pattern: Pattern,
    constants: Sequence[Term],
    static: StaticSide,
    flows: Mapping[str, Flow],
) -> int:
    """Return the break-even number of queries: that many single queries are likely to cost what the
    joint plan of all queries matching ``pattern`` costs. ``constants`` are those of one such query;
    ``flows`` are the known rates of the inputs, by name.

    The joint plan may be far more expensive, if a constant object alone kept the joins of a single
    query small. Cost: that of planning both, and of `estimate`.
    """
    own = optimize(put_constants(form.query, constants).plan)[0]
    known = Known(form.schedule, static, flows, form.options.semantics == "set")
    together, alone = (_likely(plan, known) for plan in (form.build_joint(pattern).plan, own))
    return max(1, min(ceil(together / alone), MOST_QUERIES))


def _reading(known: Known) -> float:
    """Return the cost of a single query to read its streams for one step, in ns."""
    schedule = known.schedule
    inputs = dict.fromkeys(one.input for one in schedule.windows)
    step = 1.0 if schedule.ends is None else schedule.ends.step / SECOND
    rows = sum(known.flows.get(name, NOTHING_KNOWN).any.rate * step for name in inputs)
    call, row = READ_COST
    return call + row * rows


def _likely(plan: Plan, known: Known) -> float:
    """Return the likely cost of a plan per window, in ns."""
    shape = shape_of(plan, known.static) if known.schedule.uniform else ""
    if isinstance(shape, str):
        plan = pattern_parts(plan)
        costs = estimate(plan, known, None, tuple(served_parts(plan)))
    else:
        costs = estimate(plan, known, shape)
    return _reading(known) + sum(cost.nanoseconds for cost in costs.values())


class SimilarQueriesEvaluator(SharedWindows):
    """The queries of one form that match one pattern, over named inputs. ``query`` is any of them.

    Law (tests/laws/engine/test_shared_queries.py): ``of(i)`` of a window equals the result of a
    `ContinuousEvaluator` of query i, from the first window that closes after `add` until `remove`.

    Cost: that of one query, then O(its solutions + all results). Memory: the rows of the open
    windows and the partial aggregates once; per query that of `InstanceTable`, and its text.
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
        self._windows.entailment.needs = PatternNeeds.of(form.build_joint(pattern).plan)
        self.pattern = pattern
        self._queries: dict[int, ContinuousQuery] = {}
        self._next = 0
        self._cohort = JoinedCohort(
            lambda number, _: self._queries[number],
            self._windows,
            self._static,
            CohortId((), 0),
            form.build_joint(pattern),
            alone=True,
        )

    def __len__(self) -> int:
        """The number of queries."""
        return len(self._queries)

    def add(self, query: ContinuousQuery, constants: Sequence[Term]) -> int:
        """Add a query whose constants match the pattern; return its number, which is never reused.
        It has results from the next window that closes."""
        terms = match_constants(self.pattern, constants)
        if terms is None:
            raise ValueError("the query differs in more than the parameters")
        number, self._next = self._next, self._next + 1
        self._cohort.add(number, terms)
        self._queries[number] = query
        return number

    def remove(self, instance: int) -> None:
        del self._queries[instance]
        self._cohort.remove(instance)

    @property
    def only_cohort(self) -> JoinedCohort | None:
        return self._cohort if self._queries else None

    def explain(self) -> str:
        """Describe the differences of the queries, and the plan that is computed once."""
        lines = [f"one of {len(self)} queries that differ in constants, computed together"]
        lines += describe_parameters(self._cohort.joint, {})
        lines.append("computed once, then joined with the table of their constants:")
        lines += [f"  {line}" for line in self._cohort.explain().splitlines()]
        return "\n".join(lines)

    def explain_of(self, constants: Sequence[Term], flows: Mapping[str, Flow]) -> str:
        """Do the same for the query with these constants, and add the estimated costs. ``flows``
        are the known rates of the inputs, by name."""
        terms = match_constants(self.pattern, constants) or {}
        first, *rest = self.explain().splitlines()
        own = [f"here {show(Var(name))} is {show(Const(term))}" for name, term in terms.items()]
        costs = [f"  {line.rstrip()}" for line in self._cohort.costs(flows)]
        title = "costs a window, of all of them: rows out, own time (estimates are rough):"
        return "\n".join([first, *own, *rest, title, *costs])

    def _evaluate(self, end: int, reports: bool) -> bool:
        self._cohort.fold(end)
        if reports and self._queries:
            parts = self._cohort.results(end, reports=reports)
            self._results.append(InstanceResults(*self._windows.span(end), parts))
        # The steps after the join may need Oxigraph, which reads the rows.
        return True
