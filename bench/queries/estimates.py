"""What an operator of a plan costs: the constants of `continuous/estimation/estimates.py`.

Run by ``python bench/queries/estimates.py``, one process, one core. Each operator runs over windows
of few and of many rows; its own time, as `explain` measures it, is taken as a constant a call and
one a row in or out. They are rough: a row costs more if it has more columns, or keys in no order.
"""

from __future__ import annotations

import statistics
import sys
import time

import numpy as np
from pyoxigraph import NamedNode, Quad, Store

from dyknow.continuous.algebra.plan import Plan, inputs, walk
from dyknow.continuous.estimation.estimates import COST, FOREIGN, Way, estimate
from dyknow.continuous.evaluation import execution as executions
from dyknow.continuous.evaluation.evaluator import ContinuousEvaluator
from dyknow.continuous.operators.background import Background
from dyknow.continuous.operators.profile import Profile
from dyknow.languages.csparql import parse_query
from dyknow.rdf.dictionary import TermDictionary
from dyknow.rdf.namespaces import RDF_TYPE
from dyknow.rdf.timed import Kind, ObjectColumn, TimedTriples, TripleRows

SECOND = 10**9
PLACE = "http://bench.example/"
STREAM = PLACE + "s"
SIZES = (100, 30_000)
WINDOWS = 9

A, B, NEAR = ("?o :a ?x", "?o :b ?y", "?o :near ?n")
QUERIES = {
    "Scan": f"SELECT * WHERE {{ {A} }}",
    "TypeScan": "SELECT * WHERE { ?o a :Thing }",
    "AnyScan": "SELECT * WHERE { ?o ?p ?x }",
    "Closure": "SELECT * WHERE { ?o :near+ ?n }",
    "Join": f"SELECT * WHERE {{ {A} . {B} }}",
    "LeftJoin": f"SELECT * WHERE {{ {A} OPTIONAL {{ {B} }} }}",
    "Union": f"SELECT * WHERE {{ {{ {A} }} UNION {{ {B} }} }}",
    "Minus": f"SELECT * WHERE {{ {A} MINUS {{ {B} }} }}",
    "Exists": f"SELECT * WHERE {{ {A} FILTER EXISTS {{ {B} }} }}",
    "Filter": f"SELECT * WHERE {{ {A} FILTER (?x > 50) }}",
    "Extend": f"SELECT * WHERE {{ {A} BIND (?x + 1 AS ?z) }}",
    "Aggregate": f"SELECT ?o (AVG(?x) AS ?z) WHERE {{ {A} }} GROUP BY ?o",
    "Project": f"SELECT ?o WHERE {{ {A} }}",
    "Distinct": f"SELECT DISTINCT ?o ?x WHERE {{ {A} }}",
    "Order": f"SELECT * WHERE {{ {A} }} ORDER BY ?x",
    "Slice": f"SELECT * WHERE {{ {A} }} LIMIT 1000000",
    "INCREMENTAL": f"SELECT ?o (AVG(?x) AS ?z) WHERE {{ {A} }} GROUP BY ?o",
    "FOLDED": f"SELECT ?o (AVG(?x) AS ?z) WHERE {{ {A} }} GROUP BY ?o",
    "COMPILED": f"SELECT * WHERE {{ {A} . {B} }}",
    "foreign": f"SELECT * WHERE {{ {A} FILTER (STRLEN(STR(?o)) > 3) }}",
}


def profiled(name: str, text: str, rows: int) -> tuple[float, float]:
    """Rows in and out of the operator ``name`` and its own ns, the median of some windows."""
    dictionary, random = TermDictionary(), np.random.default_rng(5)
    head, body = text.split("WHERE", 1)
    full = (
        f"REGISTER QUERY q AS PREFIX : <{PLACE}> {head} "
        f"FROM STREAM <{STREAM}> [RANGE 1s STEP 1s] WHERE {body}"
    )
    first = len(dictionary)
    terms = [NamedNode(f"{PLACE}o{i}") for i in range(rows)]
    for term in terms:
        dictionary.id(term)
    store = Store()
    if name == "TypeScan":
        store.extend(Quad(term, RDF_TYPE, NamedNode(PLACE + "Thing")) for term in terms)
    evaluator = ContinuousEvaluator(parse_query(full), dictionary, Background(store), [STREAM])
    execution = evaluator._solver.execution
    assert execution is not None
    if name not in ("INCREMENTAL", "FOLDED"):
        execution.incremental = None
    spent, moved = [], 0.0
    for window in range(WINDOWS):
        at = window * SECOND + 1 + np.sort(random.integers(0, SECOND - 1, rows))
        subject = (random.permutation(rows) + first).astype(np.int32)
        columns = {
            dictionary.id(NamedNode(PLACE + p)): ObjectColumn(
                Kind.DOUBLE, np.round(random.uniform(0, 99, rows), 1)
            )
            for p in "ab"
        }
        # Pairs: a path of one step each, so that the closure has as many pairs as rows.
        near = np.where(subject % 2, subject, np.minimum(subject + 1, first + rows - 1))
        columns[dictionary.id(NamedNode(PLACE + "near"))] = ObjectColumn(Kind.TERM, near)
        triples = TimedTriples(dictionary, (TripleRows(at, at, subject, columns),))
        evaluator.profile = profile = Profile(time.perf_counter_ns)
        evaluator.push(STREAM, triples)
        evaluator.advance(STREAM, (window + 1) * SECOND + 1)
        node = _node(evaluator, name)
        cost = profile.measured(node)
        assert cost is not None, name
        spent.append(cost.nanoseconds)
        below = [profile.measured(part) for part in inputs(node)]
        if name == "COMPILED":
            moved = cost.rows + 2 * rows
        else:
            moved = cost.rows + sum(one.rows for one in below if one is not None)
        if name == "INCREMENTAL":
            moved = cost.rows
        if name == "foreign":
            moved = rows
    return moved, statistics.median(spent[2:])


def _node(evaluator: ContinuousEvaluator, name: str) -> Plan:
    """The operator that is looked at: the first of its kind, or the one done in that way."""
    execution = evaluator._solver.execution
    assert execution is not None
    plan, known = execution.plan, evaluator._solver.known({})
    shape = None if isinstance(execution.shape, str) else execution.shape
    ways = {id: one.way for id, one in estimate(plan, known, shape, execution.served).items()}
    if name == "foreign":
        name = "Filter"
    if name in Way.__members__:
        return next(node for node in walk(plan) if ways[id(node)] is Way[name])
    return next(node for node in walk(plan) if type(node).__name__ == name)


def main() -> int:
    """Print the table, beside the constants in use."""
    print(f"own time of an operator; {SIZES[0]:,} and {SIZES[1]:,} rows a pattern")
    print(f"{'':<14}{'µs a call':>12}{'ns a row':>12}{'in use: µs':>14}{'ns':>8}")
    compiled = executions.JIT
    for name, text in QUERIES.items():
        executions.JIT = compiled and name == "COMPILED"
        (few, short), (many, long) = (profiled(name, text, rows) for rows in SIZES)
        row = (long - short) / (many - few)
        call = max(short - row * few, 0.0)
        told = COST.get(name, (0.0, FOREIGN))
        print(f"{name:<14}{call / 1e3:>12.1f}{row:>12.1f}{told[0] / 1e3:>14.1f}{told[1]:>8.1f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
