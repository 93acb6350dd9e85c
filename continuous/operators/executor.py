"""Executes a logical plan on the columns of one window (SPARQL 1.1 §18.5).

Everything is numpy: a call per column, not per row. The order of solutions depends on the rows
only, not on how they were cut into batches.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence, Set
from dataclasses import dataclass, replace
from typing import Protocol, TypeAlias, assert_never

import numpy as np
from numpy.typing import NDArray

from ...rdf.timed import Kind, ObjectColumn, TripleRows, split_term
from ..algebra.expressions import Const, Var
from ..algebra.plan import (
    Aggregate,
    AnyScan,
    Closure,
    Distinct,
    Exists,
    Extend,
    Filter,
    Given,
    Join,
    LeftJoin,
    Minus,
    Order,
    Plan,
    Position,
    Project,
    Scan,
    Slice,
    TypeScan,
    Union,
    Values,
    certain,
    named_variables,
    used_variables,
    walk,
    with_inputs,
)
from ..columns.expression_evaluation import evaluate, holds
from ..columns.relation import (
    NeedsOxigraph,
    Pairs,
    Relation,
    TermValues,
    concatenate,
    first_rows,
    key_codes,
    term_column,
    unbound,
)
from .grouping import aggregate, ordered
from .joins import has_match, join_all, left_join, minus, parted_by_bound
from .path_closure import closure
from .profile import Profile


class Source(Protocol):
    """The leaves of a plan, and the profile that records the cost of its operators."""

    @property
    def profile(self) -> Profile | None: ...

    def pairs(self, scan: Scan | TypeScan) -> Pairs:
        """Return the triples of a scan's predicate (a superset of those that its constants
        select)."""

    def matches(self, scan: Scan | AnyScan) -> Relation:
        """Return the triples of a scan with columns that `pairs` lacks, under `SUBJECT`,
        `PREDICATE` (of `AnyScan`), `OBJECT` and the names of its times."""

    def nodes(self, graph: str) -> ObjectColumn:
        """Return each subject and object of a graph, once."""

    def ready(self, plan: Plan) -> Relation | None:
        """Return the solutions of ``plan`` if another mechanism has computed them already."""


SUBJECT, PREDICATE, OBJECT = "\0s", "\0p", "\0o"


def execute(plan: Plan, source: Source, terms: TermValues) -> Relation:
    """Return the solutions of ``plan``. Cost: that of sorting each join and group key once."""
    terms.budget.pauses.pause()
    profile = source.profile
    if profile is None:
        return _execute(plan, source, terms)
    begin = profile.clock()
    relation = _execute(plan, source, terms)
    profile.add(plan, relation.rows, profile.clock() - begin)
    return relation


def _execute(plan: Plan, source: Source, terms: TermValues) -> Relation:
    ready = source.ready(plan)
    if ready is not None:
        return ready
    match plan:
        case Scan(subject, _, object) if not plan.times.names:
            return select_pairs(source.pairs(plan), subject, object, terms)
        case Scan() | AnyScan():
            return _selected(source.matches(plan), plan, terms)
        case TypeScan(subject, object):
            return select_pairs(source.pairs(plan), subject, object, terms)
        case Closure():
            step = execute(plan.step, source, terms)
            pairs = closure(plan, step, source.nodes(plan.graph), terms)
            return select_pairs(pairs, plan.subject, plan.object, terms)
        case Values(variables, rows):
            columns = {
                name: term_column([row[i] for row in rows], terms.dictionary.transient_id)
                for i, name in enumerate(variables)
            }
            return Relation(columns, len(rows))
        case Given(variables):
            raise AssertionError(f"nothing was given for {variables}")
        case Join(parts):
            return join_all([execute(part, source, terms) for part in parts], terms)
        case LeftJoin(child, optional, condition):
            left, right = execute(child, source, terms), execute(optional, source, terms)
            return left_join(left, right, condition, terms)
        case Union(parts):
            return united([execute(part, source, terms) for part in parts], terms)
        case Minus(child, removed):
            return minus(
                execute(child, source, terms), execute(removed, source, terms), terms, SEED
            )
        case Exists():
            return _marked(plan, source, terms)
        case Aggregate():
            return aggregate(plan, execute(plan.child, source, terms), terms)
        case Filter() | Extend() | Project() | Distinct() | Order() | Slice():
            return apply(plan, execute(plan.child, source, terms), terms)
        case _:
            assert_never(plan)


Step: TypeAlias = Filter | Extend | Project | Distinct | Order | Slice
"""An operator that reads the solutions of its child alone."""


def apply(step: Step, relation: Relation, terms: TermValues) -> Relation:
    """Return the solutions of ``step`` if ``relation`` has those of its child."""
    match step:
        case Filter(condition):
            return relation.take(holds(condition, relation.columns, relation.rows, terms))
        case Extend(variable, expression):
            if variable in relation.columns:
                raise NeedsOxigraph(f"?{variable} is bound twice")
            value = evaluate(expression, relation.columns, relation.rows, terms)
            return Relation({**relation.columns, variable: value}, relation.rows, relation.key)
        case Project(variables):
            return _projected(relation, variables)
        case Distinct():
            return relation if relation.key is not None else distinct(relation, terms)
        case Order(keys):
            return ordered(relation, keys, terms)
        case Slice(start, length):
            stop = relation.rows if length is None else min(relation.rows, start + length)
            return relation.take(np.arange(min(start, stop), stop))
        case _:
            assert_never(step)


def run(steps: Sequence[Step], relation: Relation, terms: TermValues) -> Relation:
    """Return the solutions of the last of ``steps``; ``relation`` has those below the first."""
    for step in steps:
        terms.budget.pauses.pause()
        relation = apply(step, relation, terms)
    return relation


def steps_above(plan: Plan, leaf: Plan) -> tuple[Step, ...] | None:
    """Return the steps from ``leaf`` to ``plan``, in the order of their execution; None if another
    operator is between the two."""
    steps: list[Step] = []
    while plan is not leaf:
        if not isinstance(plan, Step):
            return None
        steps.append(plan)
        plan = plan.child
    return tuple(reversed(steps))


def _projected(relation: Relation, variables: tuple[str, ...]) -> Relation:
    columns = {name: relation.column(name) for name in variables}
    # Without a variable of its key a relation may have equal rows.
    key = relation.key if relation.key is not None and relation.key <= set(columns) else None
    return Relation(columns, relation.rows, key)


def distinct(relation: Relation, terms: TermValues) -> Relation:
    """Keep the first of equal solutions."""
    if not relation.columns or relation.rows < 2:
        return relation.take(np.arange(min(relation.rows, 1)))
    codes = key_codes([[column] for column in relation.columns.values()], terms.dictionary)[0]
    return relation.take(first_rows(codes))


def united(parts: list[Relation], terms: TermValues) -> Relation:
    """Concatenate the parts. A variable that a part does not bind is unbound in its rows."""
    terms.budget.check(sum(part.rows for part in parts), "a union")
    names = dict.fromkeys(name for part in parts for name in part.columns)
    columns = {}
    for name in names:
        known = [part for part in parts if name in part.columns]
        # The kind of an empty part must not turn the numbers of others into terms.
        kinds = {part.columns[name].kind for part in known if part.rows}
        kind = kinds.pop() if len(kinds) == 1 else Kind.TERM
        columns[name] = concatenate(
            [p.columns[name] if name in p.columns else unbound(p.rows, kind) for p in parts],
            terms.dictionary,
        )
    return Relation(columns, sum(part.rows for part in parts))


# -- EXISTS --------------------------------------------------------------------------------


def _marked(plan: Exists, source: Source, terms: TermValues) -> Relation:
    """Add a column to the child: whether the pattern has a compatible solution.

    A pattern may use outer variables (in a FILTER). It is then solved over the distinct bindings of
    the child, which are joined in at each leaf: that is the meaning of substituting them (§18.6).
    """
    child = execute(plan.child, source, terms)
    pattern = plan.pattern
    names = named_variables(pattern) & child.columns.keys()
    # Else substitution only selects solutions, which a join does without a changed plan.
    if _looks_outside(pattern, names) or _depends(pattern, names):
        found = _substituted(pattern, child, names, source, terms)
    else:
        found = has_match(child, execute(pattern, source, terms), terms)
    mark = ObjectColumn(Kind.BOOLEAN, found)
    return Relation({**child.columns, plan.variable: mark}, child.rows, child.key)


def _substituted(
    pattern: Plan, child: Relation, names: Set[str], source: Source, terms: TermValues
) -> NDArray[np.bool_]:
    """Return for which rows of ``child`` the pattern has a solution after substitution of the row's
    terms of ``names``. Rows are grouped by which of these they bind: the others stay variables."""
    found = np.zeros(child.rows, np.bool_)
    for at, known in parted_by_bound(child, tuple(sorted(names))):
        part = child.take(at)
        bound = distinct(_projected(part, known), terms)
        row = ObjectColumn(Kind.INTEGER, np.arange(bound.rows))
        given = Given(known)
        seeds = Relation({**bound.columns, SEED: row}, bound.rows)
        solved = execute(_seeded(pattern, given), _SourceWithSeeds(source, given, seeds), terms)
        hit = np.zeros(bound.rows, np.bool_)
        if SEED in solved.columns:
            hit[solved.columns[SEED].values] = True
        # Solutions without a seed hold for every row.
        elif solved.rows:
            hit[:] = True
        found[at] = has_match(part, bound.take(hit), terms)
    return found


SEED = "\0seed"
"""A column with the number of the substituted row that a solution belongs to."""


@dataclass(frozen=True, slots=True)
class _SourceWithSeeds:
    """A source that also has the solutions of one `Given`."""

    source: Source
    given: Given
    relation: Relation

    @property
    def profile(self) -> Profile | None:
        return self.source.profile

    def pairs(self, scan: Scan | TypeScan) -> Pairs:
        return self.source.pairs(scan)

    def matches(self, scan: Scan | AnyScan) -> Relation:
        return self.source.matches(scan)

    def nodes(self, graph: str) -> ObjectColumn:
        return self.source.nodes(graph)

    def ready(self, plan: Plan) -> Relation | None:
        return self.relation if plan is self.given else self.source.ready(plan)


def _looks_outside(plan: Plan, names: Set[str]) -> bool:
    """Whether an expression uses one of ``names`` that not every row below it binds."""
    for node in walk(plan):
        below: frozenset[str] = frozenset()
        if isinstance(node, Filter | Extend | Order | Aggregate):
            below = certain(node.child)
        elif isinstance(node, LeftJoin):
            below = certain(node.child) | certain(node.optional)
        if used_variables(node) & names - below:
            return True
    return False


def _depends(plan: Plan, names: Set[str]) -> bool:
    """Whether substituting ``names`` does more than select solutions of ``plan``.

    It does so in the right side of an OPTIONAL, as it decides which left rows have a partner; in
    the right side of a MINUS, as a substituted name is no longer a shared variable; and in an
    EXISTS if the rows of ``plan`` do not bind all names.
    """
    for node in walk(plan):
        if isinstance(node, LeftJoin) and named_variables(node.optional) & names - certain(
            node.child
        ):
            return True
        if isinstance(node, Minus) and named_variables(node.removed) & names:
            return True
        if isinstance(node, Exists) and named_variables(node.pattern) & names - certain(node.child):
            return True
    return False


def _seeded(plan: Plan, given: Given) -> Plan:
    """Join the given solutions in at each leaf of ``plan``."""
    match plan:
        case Minus(child, removed):
            # Substituted names do not count as shared.
            own = tuple(sorted(named_variables(removed) - frozenset(given.variables)))
            return Minus(_seeded(child, given), Project((*own, SEED), _seeded(removed, given)))
        # These hide names or read all of their input, so the solutions are joined in above.
        case Project() | Distinct() | Aggregate() | Slice() | Order() | Closure():
            return Join((given, plan))
        case Scan() | TypeScan() | AnyScan() | Values() | Given():
            return Join((given, plan))
        case Join(()):
            return given
        case Exists():
            return replace(plan, child=_seeded(plan.child, given))
        case _:
            return with_inputs(plan, lambda child: _seeded(child, given))


# -- scans ---------------------------------------------------------------------------------


def _selected(found: Relation, scan: Scan | AnyScan, terms: TermValues) -> Relation:
    """Select the matches that fit the positions of a scan, and name columns by its variables."""
    places: list[tuple[Position, str]] = [(scan.subject, SUBJECT), (scan.object, OBJECT)]
    if isinstance(scan, AnyScan):
        places.insert(1, (scan.predicate, PREDICATE))
    named: dict[str, str] = {}
    for position, column in places:
        if isinstance(position, Const):
            found = found.take(equals(found.columns[column], position, terms))
        elif position.name in named:
            pair = [found.columns[named[position.name]], found.columns[column]]
            left, right = key_codes([pair], terms.dictionary)
            found = found.take(left == right)
        else:
            named[position.name] = column
    columns = {name: found.columns[column] for name, column in named.items()}
    columns |= {name: found.columns[name] for name in sorted(scan.times.names)}
    return Relation(columns, found.rows)


def select_pairs(pairs: Pairs, subject: Position, object: Position, terms: TermValues) -> Relation:
    """Return the pairs that match a pattern, as a relation over its variables."""
    keep: NDArray[np.bool_] | None = None
    for position, column in zip((subject, object), pairs, strict=True):
        if isinstance(position, Const):
            same = equals(column, position, terms)
            keep = same if keep is None else keep & same
    # With one variable at both ends neither is a constant, so there is no mask yet.
    if isinstance(subject, Var) and subject == object:
        left, right = key_codes([[pairs[0], pairs[1]]], terms.dictionary)
        keep = left == right
    columns = {
        position.name: column if keep is None else column.take(keep)
        for position, column in zip((subject, object), pairs, strict=True)
        if isinstance(position, Var)
    }
    rows = len(pairs[0]) if keep is None else int(np.count_nonzero(keep))
    return Relation(columns, rows)


def equals(column: ObjectColumn, constant: Const, terms: TermValues) -> NDArray[np.bool_]:
    """Return which rows of a column without nulls are the constant."""
    kind, value = split_term(constant.term, terms.dictionary.transient_id)
    if column.kind is Kind.TERM:
        return np.asarray(column.values == terms.dictionary.find(constant.term))
    # A pattern matches terms, and numbers of two kinds are two terms.
    if column.kind is not kind:
        return np.zeros(len(column), np.bool_)
    return np.asarray(column.values == value)


def pairs_of(
    tables: Iterable[TripleRows], predicate: int, extra: Pairs | None, terms: TermValues
) -> Pairs:
    """Return the triples of ``predicate`` in ``tables``, then ``extra``."""
    subjects: list[ObjectColumn] = []
    objects: list[ObjectColumn] = []
    for table in tables:
        column = table.objects.get(predicate)
        if column is None:
            continue
        subject = table.subject
        if column.null is not None:
            present = ~column.null
            subject = subject[present]
            column = ObjectColumn(column.kind, column.values[present])
        subjects.append(ObjectColumn(Kind.TERM, subject))
        objects.append(column)
    if extra is not None and len(extra[0]):
        subjects.append(extra[0])
        objects.append(extra[1])
    if not subjects:
        nothing = ObjectColumn(Kind.TERM, np.zeros(0, np.int32))
        return nothing, nothing
    return concatenate(subjects, terms.dictionary), concatenate(objects, terms.dictionary)
