"""Queries that differ in constants only, as one continuous query (DESIGN §3 "Sharing").

`form_of` says of a query what it has to agree on with others; `AlikeEvaluator` computes those that
do: the windows are kept once, the plan is computed once, and joined with the table of the constants
in which the queries differ (`cohorts.Together`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ..languages.csparql.ast import ContinuousQuery
from ..rdf.dictionary import Term, TermDictionary
from .background import Background
from .cohorts import Place, Together
from .expressions import Const, Var
from .flows import Flow
from .instance_results import InstanceResults
from .lifting import Pattern, fitted, lifted, lowered, place
from .logical import Query
from .options import Options
from .parameters import Joint, Unfit, described, joint
from .printing import show
from .rules import optimize
from .shared_windows import SharedWindows, own_solutions, own_windows
from .solving import Reading
from .unsupported import Unsupported
from .windows import Schedule, schedule


class Unshared(Exception):
    """A query that is evaluated alone; the message says why."""


@dataclass(frozen=True, slots=True)
class Form:
    """What queries agree on that can share windows and plan: ``query`` has variables for their
    constants (`lifting`), but for those that the plan has to have."""

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
        found = Reading.of(query, windows).translated({})
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
    pattern: list[Term | Var] = [Var(place(i)) for i in range(len(found.constants))]
    while True:
        kept = [i for i, one in enumerate(pattern) if isinstance(one, Var)]
        form = lowered(found.query, pattern)
        try:
            joint(Query(form.head, optimize(form.plan)[0]), [place(i) for i in kept])
        except Unfit as unfit:
            if not unfit.name:
                raise Unshared(str(unfit)) from unfit
            pattern = [
                found.constants[i] if one == Var(unfit.name) else one
                for i, one in enumerate(pattern)
            ]
            continue
        for number, i in enumerate(kept):
            pattern[i] = Var(place(number))
        return lowered(found.query, pattern), tuple(found.constants[i] for i in kept)


class AlikeEvaluator(SharedWindows):
    """The queries of one form that fit one pattern, over named inputs. ``query`` is any of them.

    Law (tests/laws/test_shared_queries.py): ``of(i)`` of a window is what a `ContinuousEvaluator`
    of query i gives for it, from the first window on that closes after `add` and until `remove`.

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
    ) -> None:
        super().__init__(query, dictionary, background, inputs, form.options)
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

    def _closed(self, end: int, reports: bool) -> bool:
        self._cohort.fold(end)
        if reports and self._queries:
            parts = self._cohort.results(end, reports=reports)
            self._results.append(InstanceResults(*self._windows.span(end), parts))
        # What is done to the joined solutions may need Oxigraph, which reads the rows.
        return True
