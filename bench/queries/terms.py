"""What is held over an hour of virtual time of a stream that never says a term twice.

Run by ``make bench`` (``python bench/queries/terms.py``; ``--quick``: six minutes of it). One
process, one core. A second brings 20 observations, each an IRI of its own with a value (a double
and an integer in turn), a text of its own and the observation before it: 144,000 new terms an hour
before anything is computed. MB are what Python holds (tracemalloc), *terms* how many the dictionary
has in the end, *all* how many it would have without forgetting.
"""

from __future__ import annotations

import argparse
import gc
import sys
import tracemalloc
from dataclasses import dataclass

from pyoxigraph import Literal, NamedNode, Store

from dyknow.continuous.algebra.options import Options, Semantics
from dyknow.continuous.evaluation.evaluator import ContinuousEvaluator
from dyknow.continuous.operators.background import Background
from dyknow.languages.csparql import parse_query
from dyknow.rdf.dictionary import Term, TermDictionary
from dyknow.rdf.terms_to_columns import from_terms

SECOND = 10**9
PLACE = "http://bench.example/"
STREAM = PLACE + "s"
VALUE, TEXT, AFTER = (NamedNode(PLACE + name) for name in ("value", "text", "after"))
RATE = 20


@dataclass(frozen=True)
class Case:
    """A query over the last ten seconds."""

    name: str
    head: str
    body: str
    semantics: Semantics = "bag"
    oxigraph: bool = False

    def text(self) -> str:
        return (
            f"PREFIX : <{PLACE}> REGISTER QUERY q AS {self.head} "
            f"FROM STREAM <{STREAM}> [RANGE 10s STEP 1s] {self.body}"
        )


CASES = (
    Case(
        "aggregate by new IRIs", "SELECT ?o (AVG(?v) AS ?a)", "WHERE { ?o :value ?v } GROUP BY ?o"
    ),
    Case(
        "the same, as a set",
        "SELECT ?o (AVG(?v) AS ?a)",
        "WHERE { ?o :value ?v } GROUP BY ?o",
        "set",
    ),
    Case("join of new IRIs", "SELECT ?b ?v", "WHERE { ?a :after ?b . ?b :value ?v }"),
    Case("numbers of several kinds", "SELECT ?s ?p ?o", "WHERE { ?s ?p ?o }"),
    Case(
        "computed texts",
        "SELECT (CONCAT(?t, STR(?v)) AS ?c)",
        "WHERE { ?o :text ?t ; :value ?v }",
    ),
    Case("blank nodes", "CONSTRUCT { [] :of ?o ; :value ?v }", "WHERE { ?o :value ?v }"),
    Case("by Oxigraph", "SELECT ?b ?v", "WHERE { ?a :after ?b . ?b :value ?v }", oxigraph=True),
)


class Observed:
    """A stream of observations, each new."""

    def __init__(self, case: Case) -> None:
        self.dictionary = TermDictionary()
        self.second = self.given = 0
        self.evaluator = ContinuousEvaluator(
            parse_query(case.text()),
            self.dictionary,
            Background(Store()),
            [STREAM],
            Options(case.semantics),
        )
        if case.oxigraph:
            self.evaluator._solver.execution = None

    def step(self) -> None:
        """The next second."""
        rows: list[tuple[int, Term, NamedNode, Term]] = []
        for i in range(self.second * RATE, (self.second + 1) * RATE):
            at = i * SECOND // RATE
            observed, before = (NamedNode(f"{PLACE}o{n}") for n in (i, i - 1))
            value = Literal(i) if i % 2 else Literal(i / 8)
            rows += (
                (at, observed, VALUE, value),
                (at, observed, TEXT, Literal(f"text {i}")),
                (at, observed, AFTER, before),
            )
        self.second += 1
        known = self.dictionary.count
        self.evaluator.push(STREAM, from_terms(rows, self.dictionary))
        results = self.evaluator.advance(STREAM, self.second * SECOND)
        assert self.second < 3 or results[-1].size
        self.given += self.dictionary.count - known
        del results
        self.dictionary.collect()


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    minute = 6 if parser.parse_args().quick else 60
    minutes_of = "an hour" if minute == 60 else "six minutes"
    print(f"{minutes_of} of {RATE} observations a second, RANGE 10s STEP 1s; MB held (tracemalloc)")
    print(f"{'':<26}{'2 min':>8}{'20 min':>8}{'40 min':>8}{'60 min':>8}{'terms':>10}{'all':>12}")
    for case in CASES:
        warm = Observed(case)
        for _ in range(3):
            warm.step()
        del warm
        gc.collect()
        tracemalloc.start()
        stream = Observed(case)
        held = []
        for minutes in (2, 18, 20, 20):
            for _ in range(minute * minutes):
                stream.step()
            gc.collect()
            held.append(tracemalloc.get_traced_memory()[0] / 1e6)
        tracemalloc.stop()
        told = "".join(f"{mb:>8.2f}" for mb in held)
        print(f"{case.name:<26}{told}{stream.dictionary.count:>10,}{stream.given:>12,}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
