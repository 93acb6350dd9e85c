"""How the parameters of a template meet its plan: what one computation serves all instances.

A parameter that is given in an instance is one of three. *Joined*: patterns bind it, so the plan
is computed with it free, and an instance has the solutions with its own term. *Compared*: only
FILTER, HAVING, BIND or the head name it, above all patterns and aggregates; so it is a column of
the table of instances. *Fixed*: its term is put into the plan, which then serves the instances that
agree on it (the sort in ``?o a ?type``, a predicate, whatever stands in OPTIONAL, EXISTS, …).

Law: of an instance, the solutions of `Joint.plan` that have its joined terms, each with its
compared terms, under `Joint.rest`, are those of the plan with all of its terms put in.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

from .expressions import Call, Var
from .plan import (
    Aggregate,
    AnyScan,
    Closure,
    Construct,
    Distinct,
    Exists,
    Extend,
    Filter,
    Head,
    Join,
    LeftJoin,
    Minus,
    Order,
    Plan,
    Project,
    Query,
    Scan,
    Select,
    Slice,
    TypeScan,
    Union,
    Values,
    asked,
    inputs,
    mentioned,
    outputs,
    own_names,
    walk,
    with_inputs,
)
from .plan_text import show
from .triple_times import names_now
from .volatile_functions import has_chance

Step: TypeAlias = Project | Filter | Extend | Distinct
"""What is done to each solution, or to those of one instance, alone."""

_FLIPPED = {"<": ">", "<=": ">=", ">": "<", ">=": "<="}


class Unfit(Exception):
    """The parameter ``name`` has to be fixed ("": all of them), and why. ``also``: others that
    have to be, too."""

    def __init__(self, name: str, reason: str, also: Iterable[str] = ()) -> None:
        super().__init__(reason)
        self.name = name
        self.also = frozenset(also)


@dataclass(frozen=True, slots=True)
class Search:
    """A condition ``?value > ?limit`` with a compared parameter: instances sorted by it are found
    without looking at the others. ``greater``: else the value is less; ``strict``: not equal."""

    value: str
    limit: str
    greater: bool
    strict: bool


@dataclass(frozen=True, slots=True)
class Joint:
    """``plan`` is computed once; joined with the instances, its solutions go through ``rest``.

    ``search``: the condition that the join itself can decide, which is ``rest[0]``.
    """

    head: Head
    plan: Plan
    rest: tuple[Step, ...]
    search: Search | None
    joined: tuple[str, ...]
    compared: tuple[str, ...]

    @property
    def asked(self) -> frozenset[str]:
        """The variables that ``rest`` (after the searched condition) or the head name."""
        steps = self.rest if self.search is None else self.rest[1:]
        found = {name for step in steps for name in asked(step)}
        match self.head:
            case Select(names):
                found |= set(names)
            case Construct(template):
                found |= {p.name for triple in template for p in triple if isinstance(p, Var)}
        return frozenset(found)


def joint(query: Query, names: Sequence[str]) -> Joint:
    """How ``query`` serves all instances that give ``names``, which are free in it.

    Raises `Unfit` with the first of them that has to be fixed. Cost: a pass over the plan, and one
    over what mentions it for each name.
    """
    if names_now(query.plan):
        raise Unfit("", "it asks for NOW()")
    if has_chance(query.plan):
        raise Unfit("", "it asks for what is drawn anew for each window")
    core, steps = _spine(query.plan)
    for name in names:
        if any(isinstance(step, Extend) and step.variable == name for step in steps):
            raise Unfit(name, f"an expression is bound to ?{name}")
    if isinstance(core, Aggregate):
        inner = mentioned(core.child) | asked(core)
        core = replace(core, keys=tuple(k for k in core.keys if k in inner or k not in names))
    known = mentioned(core)
    joined = tuple(name for name in names if name in known)
    compared = tuple(name for name in names if name not in known)
    core = _carrying_all(core, joined)
    shared: Plan = core
    at = 0
    for step in steps:
        if isinstance(step, Project):
            # The join gives the compared ones, and needs the joined ones.
            kept = dict.fromkeys((*step.variables, *joined))
            shared = Project(tuple(name for name in kept if name not in compared), shared)
        elif not asked(step).isdisjoint(compared):
            break
        else:
            shared = replace(step, child=shared)
        at += 1
    rest, search = _search(steps[at:], frozenset(names), frozenset(compared), outputs(shared))
    return Joint(query.head, shared, rest, search, joined, compared)


def _spine(plan: Plan) -> tuple[Plan, list[Step]]:
    """What stands above patterns and aggregates, from below, and what it stands on."""
    steps: list[Step] = []
    while isinstance(plan, Project | Filter | Extend | Distinct | Order):
        # Solutions have no order, where none are cut off.
        if not isinstance(plan, Order):
            steps.append(plan)
        plan = plan.child
    return plan, steps[::-1]


def _search(
    steps: Sequence[Step], names: frozenset[str], compared: frozenset[str], known: frozenset[str]
) -> tuple[tuple[Step, ...], Search | None]:
    """The steps with the condition that can be searched for, if any, in front."""
    for i, step in enumerate(steps):
        if not isinstance(step, Filter):
            break
        match step.condition:
            case Call(operator, (Var(left), Var(right))) if operator in _FLIPPED:
                if left in compared:
                    left, right, operator = right, left, _FLIPPED[operator]
                if right in compared and left in known and left not in names:
                    found = Search(left, right, operator[0] == ">", len(operator) == 1)
                    return (step, *steps[:i], *steps[i + 1 :]), found
    return tuple(steps), None


def _carrying_all(plan: Plan, names: Sequence[str]) -> Plan:
    """``plan`` such that each of its solutions binds all of ``names``; raises `Unfit`."""
    # Not the errors, which would hold each other by the frames that they came through.
    unfit: dict[str, str] = {}
    own = _OwnNames()
    for name in names:
        try:
            plan = _carrying(plan, name, _Places(plan, name, own))
        except Unfit as error:
            unfit[error.name] = str(error)
    if unfit:
        first, *others = unfit
        # No variable has it: its frame, and by that all that the callers knew (evaluators that
        # are gone, with their windows), would wait for a collection of garbage.
        raise Unfit(first, unfit[first], others)
    return plan


class _OwnNames:
    """`own_names` of nodes, each looked at once: most are the same for every name."""

    def __init__(self) -> None:
        # With the node, whose number would be another's when it is gone.
        self._known: dict[int, tuple[Plan, frozenset[str]]] = {}

    def of(self, node: Plan) -> frozenset[str]:
        known = self._known.get(id(node))
        if known is None:
            known = self._known[id(node)] = (node, own_names(node))
        return known[1]


class _Places:
    """Which parts of a plan mention a name: one pass over it."""

    def __init__(self, plan: Plan, name: str, own: _OwnNames) -> None:
        self._name = name
        self._own = own
        self._parts: set[int] = set()
        self._note(plan)

    def __contains__(self, part: Plan) -> bool:
        return id(part) in self._parts

    def _note(self, plan: Plan) -> bool:
        found = self._name in self._own.of(plan)
        for part in inputs(plan):
            found |= self._note(part)
        if found:
            self._parts.add(id(plan))
        return found


def _carrying(plan: Plan, name: str, places: _Places) -> Plan:
    """``plan`` such that each of its solutions binds ``name``, and those with one term are the
    solutions of the plan with that term put in. ``places``: where it stands. Raises `Unfit`."""

    def unfit(reason: str) -> Unfit:
        return Unfit(name, f"?{name} {reason}")

    def below(child: Plan) -> Plan:
        if child not in places:
            raise unfit("stands where no pattern binds it")
        return _carrying(child, name, places)

    def also(part: Plan) -> Plan:
        # Bound on both sides, it is what the sides agree on.
        return _carrying(part, name, places) if part in places else part

    match plan:
        case Scan():
            return plan
        case AnyScan(_, predicate):
            if predicate == Var(name):
                raise unfit("is a predicate")
            return plan
        case TypeScan(_, sort):
            if sort == Var(name):
                raise unfit("is a sort, of which there are few")
            return plan
        case Join(parts):
            return Join(tuple(also(part) for part in parts))
        case Union(parts):
            return Union(tuple(below(part) for part in parts))
        case Extend(variable) if variable == name:
            raise unfit("is bound to an expression")
        case Filter() | Extend() | Distinct() | Order():
            return with_inputs(plan, below)
        case Project(names, child):
            return Project(tuple(dict.fromkeys((*names, name))), below(child))
        case Aggregate(keys, _, child):
            if name not in keys:
                raise unfit("is aggregated over")
            return replace(plan, child=below(child))
        case LeftJoin(child, optional):
            return replace(plan, child=below(child), optional=also(optional))
        case Minus(child, removed):
            if removed in places:
                # MINUS takes nothing away where the two sides share no variable.
                raise unfit("stands in MINUS")
            return replace(plan, child=below(child))
        case Exists(_, pattern, child):
            return replace(plan, child=below(child), pattern=also(pattern))
        case _:
            raise unfit(f"stands in {type(plan).__name__}")


def confined(plan: Plan, names: Collection[str], streamed: Collection[str]) -> bool:
    """Whether solutions with given terms for ``names`` come of the triples about these terms alone,
    and where a window has none of these there are none. ``streamed``: the predicates that may be
    in a window; facts of sorts may be as well."""
    about = {Var(name) for name in names}

    def is_about(leaf: Plan) -> bool:
        match leaf:
            case Scan(subject, predicate, object):
                return predicate.value not in streamed or not about.isdisjoint((subject, object))
            case TypeScan(subject):
                return subject in about
            case _:
                return isinstance(leaf, Values) or bool(inputs(leaf))

    def is_empty(node: Plan) -> bool:
        """Whether it has no solution without triples about the terms."""
        match node:
            case Scan(_, predicate):
                return predicate.value in streamed
            case Join(parts):
                return any(map(is_empty, parts))
            case Union(parts):
                return bool(parts) and all(map(is_empty, parts))
            case Aggregate(implicit=True):
                return False
            case LeftJoin(child) | Minus(child) | Exists(_, _, child):
                return is_empty(child)
            case Filter() | Extend() | Aggregate() | Project() | Distinct() | Order() | Slice():
                return is_empty(node.child)
            case _:
                return False

    odd = (Closure, AnyScan)
    nodes = walk(plan)
    return is_empty(plan) and all(is_about(n) and not isinstance(n, odd) for n in nodes)


def described(joint: Joint, reasons: Mapping[str, str]) -> list[str]:
    """The parameters and what becomes of them, for people."""
    lines = [f"{show(Var(name))}: joined, patterns bind it" for name in joint.joined]
    search = joint.search
    for name in joint.compared:
        sought = search is not None and search.limit == name
        how = "found by order" if sought else "a solution at a time"
        lines.append(f"{show(Var(name))}: compared, {how}")
    return lines + [f"?{name}: fixed, {reason}" for name, reason in reasons.items()]
