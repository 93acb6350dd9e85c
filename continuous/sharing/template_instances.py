"""All instances of one template as one continuous query (DESIGN §3 "Sharing").

Rows and watermarks in, one value a window out that holds the result of every instance. The windows
are kept once; instances that agree on what has to be fixed in the plan (`template_parameters`) are
a cohort, which computes the plan once and joins it with the table of its instances (`cohorts`).
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
from ..algebra.template_parameters import confined, described
from ..columns.budget import UNLIMITED, Budget
from ..evaluation.solver import QueryBody
from ..operators.background import Background
from .cohorts import Alone, Place, Together, joint_of
from .instance_results import Apart, Common, InstanceResults, Joined
from .shared_windows import SharedWindows, own_solutions, own_windows


@dataclass(slots=True, eq=False)
class _Family:
    """Instances that give the same parameters. ``fixed``: those that they must agree on to be a
    cohort, with why."""

    names: tuple[str, ...]
    fixed: Mapping[str, str]


class TemplateEvaluator(SharedWindows):
    """The instances of a template over named inputs; ``query`` has its parameters free.

    Law (tests/laws): ``of(i)`` of a window is what a `ContinuousEvaluator` of
    ``bind(query, arguments)`` gives for it, from the first window on that closes after `add` and
    until `remove`. (Where results are compared with those before, as by ISTREAM, the first one of
    new arguments has none before.)

    Cost: that of one query a cohort, then O(its solutions + what it gives out): see `explain` for
    what is shared. Memory: the rows of the open windows once, partial aggregates a cohort; an
    instance as `InstanceTable` says and 8 bytes that stay when it has gone; one that is evaluated
    alone keeps a plan.
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
        self._cohorts: dict[tuple[object, ...], Alone | Together] = {}
        self._serials: dict[int, Alone | Together] = {}
        self._cohort_of = array("q")
        """By instance the serial number of its cohort, -1 of one that has gone."""
        self._live = self._next = 0

    def __len__(self) -> int:
        """How many instances there are."""
        return self._live

    def add(self, arguments: Mapping[Variable, Term]) -> int:
        """A new instance, by its number (never given again); arguments left out stay variables.

        It has results from the next window on that closes. Raises ``ValueError`` as `bind` does,
        and where the query makes no SPARQL. Cost: about 2 µs in a cohort that is there; the first
        one of a cohort plans the query.
        """
        names = tuple(arguments)
        family = self._families.get(names)
        if family is None:
            family = self._families[names] = self._family(arguments)
        given: dict[str, Term] = {}
        for variable, term in arguments.items():
            if isinstance(term, BlankNode):
                raise ValueError(f"{variable} is given a blank node, which names nothing here")
            given[variable.value] = term
        key: tuple[object, ...] = (family.names, *[given[name] for name in family.fixed])
        cohort = self._cohorts.get(key)
        if cohort is None:
            cohort = self._cohort(family, key, given)
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
        """The parameters on which instances with such arguments have to agree to share more than
        their windows; None if they share nothing more, or what they give is their own
        (`own_windows`, `own_solutions`), or if those in ``one_by_one`` are among these, or need
        other triples than those about their term, of the predicates (IRIs) that are ``streamed``:
        else an instance has what it would have over these alone.
        """
        given = {variable.value: term for variable, term in arguments.items()}
        found, fixed = joint_of(self._windows, self.query, given)
        if found is None or not fixed.keys().isdisjoint(one_by_one):
            return None
        windows = self._windows
        if own_windows(self.query, windows.schedule, windows.options):
            return None
        body = QueryBody.of(bind(self.query, arguments), windows.schedule)
        if own_solutions(body.translate(given)):
            return None
        if one_by_one and windows.entailment.entails_of_objects(streamed):
            return None
        # ASK says no as well.
        alike = not isinstance(found.head, Ask) and confined(found.plan, one_by_one, streamed)
        return frozenset(fixed) if alike or not one_by_one else None

    def remove(self, instance: int) -> None:
        """Forget an instance; raises ``KeyError`` if it is not there."""
        if not 0 <= instance < len(self._cohort_of) or self._cohort_of[instance] < 0:
            raise KeyError(instance)
        cohort = self._serials[self._cohort_of[instance]]
        self._cohort_of[instance] = -1
        self._live -= 1
        cohort.remove(instance)
        if not cohort.live:
            del self._serials[cohort.place.serial], self._cohorts[cohort.place.key]

    def explain(self) -> str:
        """What is shared among which instances, and the plan of each cohort (of some)."""
        lines = [f"{len(self)} instances in {len(self._cohorts)} cohorts"]
        for family in dict.fromkeys(self._families.values()):
            mine = [(key, c) for key, c in self._cohorts.items() if key[0] == family.names]
            if not mine:
                continue
            count = sum(cohort.live for _, cohort in mine)
            given = ", ".join(f"?{name}" for name in family.names) or "no parameter"
            lines.append(f"given {given}: {count} instances in {len(mine)} cohorts")
            cohort = mine[0][1]
            if isinstance(cohort, Together):
                told = described(cohort.joint, family.fixed)
                lines += [f"  {line}" for line in told]
                lines.append("  computed once a cohort, then joined with the table of instances:")
            else:
                lines += [f"  ?{name}: fixed, {why}" for name, why in family.fixed.items()]
                lines.append("  each one's arguments evaluated alone:")
            lines += [f"    {line}" for line in cohort.explain().splitlines()]
        return "\n".join(lines)

    def _family(self, arguments: Mapping[Variable, Term]) -> _Family:
        """Its parameters in one order, whatever the order of the arguments."""
        bind(self.query, arguments)
        ordered = sorted(arguments.items(), key=lambda item: item[0].value)
        given = {variable.value: term for variable, term in ordered}
        for family in self._families.values():
            if family.names == tuple(given):
                return family
        return _Family(tuple(given), joint_of(self._windows, self.query, given)[1])

    def _cohort(
        self, family: _Family, key: tuple[object, ...], given: Mapping[str, Term]
    ) -> Alone | Together:
        fixed = tuple(family.fixed)
        joint = None
        if len(fixed) < len(family.names):
            joint, reasons = joint_of(self._windows, self.query, given, fixed)
            if len(reasons) > len(fixed):
                joint = None
            if joint is None:
                # With these terms more has to be fixed than with those that came first.
                key = (family.names, *given.items())
                found = self._cohorts.get(key)
                if found is not None:
                    return found
        place = Place(key, self._next)
        self._next += 1
        made: Alone | Together
        if joint is not None:
            agreed = {name: given[name] for name in fixed}

            def own(_: int, terms: Mapping[str, Term]) -> ContinuousQuery:
                arguments = {**agreed, **terms}
                return bind(self.query, {Variable(n): term for n, term in arguments.items()})

            made = Together(own, self._windows, self._static, place, joint)
        else:
            arguments = {Variable(name): given[name] for name in family.names}
            made = Alone(bind(self.query, arguments), self._windows, self._static, place)
        self._cohorts[key] = self._serials[place.serial] = made
        return made

    def _evaluate(self, end: int, reports: bool) -> bool:
        """The window that ends at ``end`` has closed: the result of every cohort."""
        parts: list[Common | Apart | Joined] = []
        if reports or self._windows.differs:
            for cohort in self._cohorts.values():
                cohort.fold(end)
                parts += cohort.results(end, reports=reports)
        if parts:
            self._results.append(InstanceResults(*self._windows.span(end), tuple(parts)))
        # A cohort that comes later folds the whole window.
        return True
