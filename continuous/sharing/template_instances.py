"""All instances of one template as one continuous query (DESIGN §3 "Sharing").

The evaluator returns one value per window, with the results of all instances. It stores the windows
once. Instances that agree on the fixed parameters (`template_parameters`) are a cohort, which
computes the plan once and joins it with the table of its instances (`cohorts`).
"""

from __future__ import annotations

from array import array
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from pyoxigraph import BlankNode, Variable

from ...languages.csparql import bind
from ...languages.csparql.ast import ContinuousQuery
from ...rdf.dictionary import Term, TermDictionary
from ..algebra.options import Options
from ..algebra.plan import Ask
from ..algebra.template_parameters import Joint, describe_parameters, is_confined
from ..columns.budget import UNLIMITED, Budget
from ..evaluation.solver import QueryBody
from ..operators.background import Background
from .cohorts import CohortId, JoinedCohort, SingleCohort, find_joint
from .instance_results import CommonResult, InstanceResults, JoinedResults, SeparateResults
from .shared_windows import SharedWindows, own_solutions, own_windows


@dataclass(slots=True, eq=False)
class _Family:
    """Instances that bind the same parameters. ``fixed``: the parameters that a cohort must agree
    on, with the reasons."""

    names: tuple[str, ...]
    fixed: Mapping[str, str]


class TemplateEvaluator(SharedWindows):
    """The instances of a template over named inputs; ``query`` has unbound parameters.

    Law (tests/laws): ``of(i)`` of a window equals the result of a `ContinuousEvaluator` of
    ``bind(query, arguments)``, from the first window that closes after `add` until `remove`. (If
    results are compared with previous ones, as by ISTREAM, the first result of new arguments has no
    previous one.)

    Cost: that of one query per cohort, then O(its solutions + all results); `explain` shows what is
    shared. Memory: the rows of the open windows once, partial aggregates per cohort; per instance
    that of `InstanceTable`, and 8 bytes that stay after its removal. Arguments evaluated alone have
    a plan of their own.
    """

    def __init__(
        self,
        query: ContinuousQuery,
        dictionary: TermDictionary,
        background: Background,
        inputs: Sequence[str],
        options: Options | None = None,
        budget: Budget = UNLIMITED,
    ) -> None:
        super().__init__(query, dictionary, background, inputs, options, budget)
        self.query = query
        self._families: dict[tuple[Variable, ...], _Family] = {}
        self._cohorts: dict[tuple[object, ...], SingleCohort | JoinedCohort] = {}
        self._serials: dict[int, SingleCohort | JoinedCohort] = {}
        self._cohort_of = array("q")
        """The serial number of each instance's cohort; -1 after its removal."""
        self._live = self._next = 0

    def __len__(self) -> int:
        """The number of instances."""
        return self._live

    def add(self, arguments: Mapping[Variable, Term]) -> int:
        """Add an instance; return its number, which is never reused. Missing arguments stay
        variables.

        It has results from the next window that closes. Raises ``ValueError`` as `bind` does, and
        if the query has no SPARQL form. Cost: about 2 µs in an existing cohort; the first instance
        of a cohort plans the query.
        """
        names = tuple(arguments)
        family, joint = self._families.get(names), None
        if family is None:
            family, joint = self._family(arguments)
            self._families[names] = family
        given: dict[str, Term] = {}
        for variable, term in arguments.items():
            if isinstance(term, BlankNode):
                raise ValueError(f"{variable} is a blank node, which names nothing in a request")
            given[variable.value] = term
        key: tuple[object, ...] = (family.names, *[given[name] for name in family.fixed])
        cohort = self._cohorts.get(key)
        if cohort is None:
            cohort = self._cohort(family, key, given, joint)
        number = len(self._cohort_of)
        cohort.add(number, given)
        self._cohort_of.append(cohort.place.serial)
        self._live += 1
        return number

    def agreement(
        self,
        arguments: Mapping[Variable, Term],
        one_by_one: Collection[str],
        streamed: Collection[str],
    ) -> frozenset[str] | None:
        """Return the parameters on which instances with such arguments must agree to share more
        than their windows. None in these cases: they share nothing more; their results are their
        own (`own_windows`, `own_solutions`); parameters in ``one_by_one`` are among the fixed ones;
        or the instances need other triples of the ``streamed`` predicates (IRIs) than those about
        their terms in ``one_by_one``. Otherwise an instance has the results that it would have over
        those triples alone.
        """
        given = {variable.value: term for variable, term in arguments.items()}
        joint, fixed = find_joint(self._windows, self.query, given)
        if joint is None or not fixed.keys().isdisjoint(one_by_one):
            return None
        windows = self._windows
        if own_windows(self.query, windows.schedule, windows.options):
            return None
        body = QueryBody.of(bind(self.query, arguments), windows.schedule)
        if own_solutions(body.translate(given)):
            return None
        # An entailed triple about a term may come from a sample of another object.
        if one_by_one and windows.entailment.entails_of_objects(streamed):
            return None
        # An ASK also reports false, for which no triple about the term is needed.
        alike = not isinstance(joint.head, Ask) and is_confined(joint.plan, one_by_one, streamed)
        return frozenset(fixed) if alike or not one_by_one else None

    def remove(self, instance: int) -> None:
        """Remove an instance; raises ``KeyError`` if it does not exist."""
        if not 0 <= instance < len(self._cohort_of) or self._cohort_of[instance] < 0:
            raise KeyError(instance)
        cohort = self._serials[self._cohort_of[instance]]
        self._cohort_of[instance] = -1
        self._live -= 1
        cohort.remove(instance)
        # A cohort without instances would fold each window for nothing.
        if not cohort.live:
            del self._serials[cohort.place.serial], self._cohorts[cohort.place.key]

    @property
    def only_cohort(self) -> JoinedCohort | None:
        if len(self._cohorts) != 1:
            return None
        (cohort,) = self._cohorts.values()
        return cohort if isinstance(cohort, JoinedCohort) else None

    def explain(self) -> str:
        """Describe what is shared among which instances, and the plans of some cohorts."""
        lines = [f"{len(self)} instances in {len(self._cohorts)} cohorts"]
        for family in dict.fromkeys(self._families.values()):
            mine = [(key, c) for key, c in self._cohorts.items() if key[0] == family.names]
            if not mine:
                continue
            count = sum(cohort.live for _, cohort in mine)
            given = ", ".join(f"?{name}" for name in family.names) or "no parameter"
            lines.append(f"given {given}: {count} instances in {len(mine)} cohorts")
            cohort = mine[0][1]
            if isinstance(cohort, JoinedCohort):
                parameters = describe_parameters(cohort.joint, family.fixed)
                lines += [f"  {line}" for line in parameters]
                lines.append("  computed once a cohort, then joined with the table of instances:")
            else:
                lines += [f"  ?{name}: fixed, {why}" for name, why in family.fixed.items()]
                lines.append("  each one's arguments evaluated alone:")
            lines += [f"    {line}" for line in cohort.explain().splitlines()]
        return "\n".join(lines)

    def _family(self, arguments: Mapping[Variable, Term]) -> tuple[_Family, Joint | None]:
        """Return the family of the arguments, in any order of theirs; and of a new one how
        instances that agree with these arguments are computed together."""
        bind(self.query, arguments)
        ordered = sorted(arguments.items(), key=lambda item: item[0].value)
        given = {variable.value: term for variable, term in ordered}
        for family in self._families.values():
            if family.names == tuple(given):
                return family, None
        joint, fixed = find_joint(self._windows, self.query, given)
        return _Family(tuple(given), fixed), joint

    def _cohort(
        self,
        family: _Family,
        key: tuple[object, ...],
        given: Mapping[str, Term],
        joint: Joint | None,
    ) -> SingleCohort | JoinedCohort:
        """Make the cohort of the ``given`` terms. ``joint`` as `_family` returned it for them."""
        fixed = tuple(family.fixed)
        if joint is None and len(fixed) < len(family.names):
            joint, reasons = find_joint(self._windows, self.query, given, fixed)
            if len(reasons) > len(fixed):
                joint = None
            if joint is None:
                # With these terms more parameters are fixed than with the family's first ones.
                key = (family.names, *given.items())
                existing = self._cohorts.get(key)
                if existing is not None:
                    return existing
        place = CohortId(key, self._next)
        self._next += 1
        cohort: SingleCohort | JoinedCohort
        if joint is not None:
            agreed = {name: given[name] for name in fixed}

            def own(_: int, terms: Mapping[str, Term]) -> ContinuousQuery:
                arguments = {**agreed, **terms}
                return bind(self.query, {Variable(n): term for n, term in arguments.items()})

            cohort = JoinedCohort(own, self._windows, self._static, place, joint)
        else:
            arguments = {Variable(name): given[name] for name in family.names}
            cohort = SingleCohort(bind(self.query, arguments), self._windows, self._static, place)
        self._cohorts[key] = self._serials[place.serial] = cohort
        return cohort

    def _evaluate(self, end: int, reports: bool) -> bool:
        """Evaluate every cohort for the window that ends at ``end``."""
        parts: list[CommonResult | SeparateResults | JoinedResults] = []
        # A stream operator compares with the result before, even if that was not reported.
        if reports or self._windows.differs:
            for cohort in self._cohorts.values():
                cohort.fold(end)
                parts += cohort.results(end, reports=reports)
        if parts:
            self._results.append(InstanceResults(*self._windows.span(end), tuple(parts)))
        # A cohort that is added later folds a whole window first.
        return True
