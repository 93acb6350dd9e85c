"""The roles of a template's parameters in its plan: which computation all instances can share.

A parameter that an instance binds has one of three roles. *Joined*: patterns bind it. The plan is
computed with it unbound, and an instance has the solutions with its own term. *Compared*: only
FILTER, HAVING, BIND or the head use it, above all patterns and aggregates. It is a column of the
table of instances. *Fixed*: its term is part of the plan, which then serves the instances that
agree on it (the sort in ``?o a ?type``, a predicate, a name within OPTIONAL, EXISTS, …).

Law: take the solutions of `Joint.plan` that have an instance's joined terms, add its compared
terms, and apply `Joint.rest`: these are the solutions of the plan with all its terms bound.
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
    inputs,
    named_variables,
    outputs,
    own_names,
    used_variables,
    walk,
    with_inputs,
)
from .plan_text import show
from .triple_times import names_now
from .volatile_functions import has_volatile

Step: TypeAlias = Project | Filter | Extend | Distinct
"""A step that treats each solution, or those of one instance, separately."""

_FLIPPED = {"<": ">", "<=": ">=", ">": "<", ">=": "<="}


class Unfit(Exception):
    """The parameter ``name`` must be fixed ("": all of them), for the reason of the message.
    ``also``: others that must be, too."""

    def __init__(self, name: str, reason: str, also: Iterable[str] = ()) -> None:
        super().__init__(reason)
        self.name = name
        self.also = frozenset(also)


@dataclass(frozen=True, slots=True)
class Search:
    """A condition ``?value > ?limit`` with a compared parameter: instances sorted by it are found
    without visiting the others. Not ``greater``: the value is less; ``strict``: not equal."""

    value: str
    limit: str
    greater: bool
    strict: bool


@dataclass(frozen=True, slots=True)
class Joint:
    """A shared computation: ``plan`` is computed once and joined with the instances; its solutions
    then go through ``rest``.

    ``search``: the condition that the join itself can decide; it is ``rest[0]``.
    """

    head: Head
    plan: Plan
    rest: tuple[Step, ...]
    search: Search | None
    joined: tuple[str, ...]
    compared: tuple[str, ...]

    @property
    def used_variables(self) -> frozenset[str]:
        """The variables that ``rest`` (after the searched condition) or the head use."""
        steps = self.rest if self.search is None else self.rest[1:]
        found = {name for step in steps for name in used_variables(step)}
        match self.head:
            case Select(names):
                found |= set(names)
            case Construct(template):
                found |= {p.name for triple in template for p in triple if isinstance(p, Var)}
        return frozenset(found)


def build_joint(query: Query, names: Sequence[str]) -> Joint:
    """Return how ``query`` is computed for all instances that bind ``names``, unbound in it.

    Raises `Unfit` for the first parameter that must be fixed. Cost: a pass over the plan, and one
    over the parts that mention it per name.
    """
    if names_now(query.plan):
        raise Unfit("", "it asks for NOW()")
    if has_volatile(query.plan):
        raise Unfit("", "it asks for what is drawn anew for each window")
    core, steps = _spine(query.plan)
    for name in names:
        if any(isinstance(step, Extend) and step.variable == name for step in steps):
            raise Unfit(name, f"an expression is bound to ?{name}")
    if isinstance(core, Aggregate):
        inner = named_variables(core.child) | used_variables(core)
        # A parameter that is a key only has one term in an instance, so it groups nothing.
        core = replace(core, keys=tuple(k for k in core.keys if k in inner or k not in names))
    in_core = named_variables(core)
    joined = tuple(name for name in names if name in in_core)
    compared = tuple(name for name in names if name not in in_core)
    core = _carrying_all(core, joined)
    shared: Plan = core
    at = 0
    for step in steps:
        if isinstance(step, Project):
            # The join adds the compared parameters, and needs the joined ones.
            kept = dict.fromkeys((*step.variables, *joined))
            shared = Project(tuple(name for name in kept if name not in compared), shared)
        # From the first step that needs a term of an instance on, steps come after the join.
        elif not used_variables(step).isdisjoint(compared):
            break
        else:
            shared = replace(step, child=shared)
        at += 1
    rest, search = _search(steps[at:], frozenset(names), frozenset(compared), outputs(shared))
    return Joint(query.head, shared, rest, search, joined, compared)


def _spine(plan: Plan) -> tuple[Plan, list[Step]]:
    """Return the part below which patterns and aggregates begin, and the steps above, bottom-up."""
    steps: list[Step] = []
    while isinstance(plan, Project | Filter | Extend | Distinct | Order):
        # Without LIMIT the order of solutions does not matter.
        if not isinstance(plan, Order):
            steps.append(plan)
        plan = plan.child
    return plan, steps[::-1]


def _search(
    steps: Sequence[Step], names: frozenset[str], compared: frozenset[str], known: frozenset[str]
) -> tuple[tuple[Step, ...], Search | None]:
    """Return the steps with the condition that can be searched for in front, if there is one."""
    for i, step in enumerate(steps):
        # Only filters may change places, so none moves in front of another step.
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
    """Make each solution of ``plan`` bind all of ``names``. Raises `Unfit`."""
    # Keep texts, not errors: tracebacks would refer to each other's frames.
    unfit: dict[str, str] = {}
    own = _OwnNames()
    for name in names:
        try:
            plan = _carrying(plan, name, _Places(plan, name, own))
        except Unfit as error:
            unfit[error.name] = str(error)
    if unfit:
        first, *others = unfit
        # No variable may refer to this error: the cycle through its frame would keep the callers'
        # variables (old evaluators with their windows) until a garbage collection.
        raise Unfit(first, unfit[first], others)
    return plan


class _OwnNames:
    """A cache of `own_names`, which are the same for every parameter."""

    def __init__(self) -> None:
        # The node is part of the value, so that its id is not reused.
        self._cache: dict[int, tuple[Plan, frozenset[str]]] = {}

    def of(self, node: Plan) -> frozenset[str]:
        entry = self._cache.get(id(node))
        if entry is None:
            entry = self._cache[id(node)] = (node, own_names(node))
        return entry[1]


class _Places:
    """The parts of a plan that mention a name, found in one pass."""

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
    """Make each solution of ``plan`` bind ``name``; those with one term are then the solutions of
    the plan with that term bound. ``places``: the parts that mention it. Raises `Unfit`."""

    def unfit(reason: str) -> Unfit:
        return Unfit(name, f"?{name} {reason}")

    def below(child: Plan) -> Plan:
        if child not in places:
            raise unfit("stands where no pattern binds it")
        return _carrying(child, name, places)

    def also(part: Plan) -> Plan:
        # If both sides bind it, they must agree on it.
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
            # Each branch has to bind it: else its solutions would belong to no instance.
            return Union(tuple(below(part) for part in parts))
        case Extend(variable) if variable == name:
            raise unfit("is bound to an expression")
        case Filter() | Extend() | Distinct() | Order():
            return with_inputs(plan, below)
        case Project(names, child):
            return Project(tuple(dict.fromkeys((*names, name))), below(child))
        case Aggregate(keys, _, child):
            # Grouped by the parameter, each instance has groups of its own.
            if name not in keys:
                raise unfit("is aggregated over")
            return replace(plan, child=below(child))
        case LeftJoin(child, optional):
            # Rows without a partner are solutions, too, so the left side has to bind it.
            return replace(plan, child=below(child), optional=also(optional))
        case Minus(child, removed):
            if removed in places:
                # MINUS removes nothing if the two sides share no variable.
                raise unfit("stands in MINUS")
            return replace(plan, child=below(child))
        case Exists(_, pattern, child):
            return replace(plan, child=below(child), pattern=also(pattern))
        case _:
            raise unfit(f"stands in {type(plan).__name__}")


def is_confined(plan: Plan, names: Collection[str], streamed: Collection[str]) -> bool:
    """Whether the solutions for given terms of ``names`` depend only on the triples about these
    terms, and there are none in a window without such triples. ``streamed``: the predicates that a
    window may contain; it may also contain facts of sorts."""
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
            # An implicit group is one row even without any solution.
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


def describe_parameters(joint: Joint, reasons: Mapping[str, str]) -> list[str]:
    """Return the roles of the parameters, as lines for `explain`."""
    lines = [f"{show(Var(name))}: joined, patterns bind it" for name in joint.joined]
    search = joint.search
    for name in joint.compared:
        sought = search is not None and search.limit == name
        how = "found by order" if sought else "a solution at a time"
        lines.append(f"{show(Var(name))}: compared, {how}")
    return lines + [f"?{name}: fixed, {reason}" for name, reason in reasons.items()]
