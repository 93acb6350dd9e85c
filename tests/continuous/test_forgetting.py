"""What an hour of new terms leaves behind, and who has to hold what.

Sizes are counted in terms, not bytes: bench/queries/terms.py measures those.
"""

import numpy as np
import pytest
from pyoxigraph import Literal, NamedNode, Store, Variable

from dyknow.continuous.algebra.options import Options
from dyknow.continuous.estimation.input_rates import Traffic
from dyknow.continuous.evaluation.evaluator import ContinuousEvaluator
from dyknow.continuous.incremental import aggregation
from dyknow.continuous.operators.background import Background
from dyknow.continuous.sharing.template_instances import TemplateEvaluator
from dyknow.languages.csparql import parse_query
from dyknow.rdf import dictionary as module
from dyknow.rdf.dictionary import TermDictionary
from dyknow.rdf.namespaces import RDF_TYPE, XSD
from dyknow.rdf.terms_to_columns import from_terms

PLACE = "http://example.org/"
STREAM = PLACE + "s"
SECOND = 10**9
VALUE, TEXT, AFTER, SORT = (NamedNode(PLACE + n) for n in ("value", "text", "after", "Sort"))


def node(name: object) -> NamedNode:
    return NamedNode(f"{PLACE}{name}")


def literal(text: str, datatype: str) -> Literal:
    return Literal(text, datatype=NamedNode(XSD + datatype))


class Asked:
    """A query over one stream; what it gives is read at once, and every push is swept after."""

    def __init__(self, head: str, body: str, window: str = "[RANGE 10s STEP 10s]", **how) -> None:
        text = f"PREFIX : <{PLACE}> {head} FROM STREAM <{STREAM}> {window} {body}"
        self.dictionary = TermDictionary()
        self.evaluator = ContinuousEvaluator(
            parse_query(f"REGISTER QUERY q AS {text}"),
            self.dictionary,
            Background(Store()),
            [STREAM],
            Options(**how),
        )

    def push(self, *triples) -> list:
        """``(second, subject, predicate, object)``; the rows of the windows that close with it."""
        timed = [(int(time * SECOND), *rest) for time, *rest in triples]
        self.evaluator.push(STREAM, from_terms(timed, self.dictionary))
        results = self.evaluator.advance(STREAM, timed[-1][0])
        found = [result.solutions.rows() for result in results if result.solutions is not None]
        del results
        self.dictionary._sweep()
        return found


QUERIES = {
    "groups": ("SELECT ?o (AVG(?v) AS ?a)", "WHERE { ?o :value ?v } GROUP BY ?o"),
    "groups of a set": ("SELECT ?o (MIN(?v) AS ?a)", "WHERE { ?o :value ?v } GROUP BY ?o", "set"),
    "joins": ("SELECT ?b ?v", "WHERE { ?a :after ?b . ?b :value ?v }"),
    "mixed numbers": ("SELECT ?s ?p ?o", "WHERE { ?s ?p ?o }"),
    "either of two kinds": (
        "SELECT ?x",
        "WHERE { { ?o :value ?x } UNION { ?o :text ?x } } ORDER BY ?x",
    ),
    "computed texts": ("SELECT (CONCAT(?t, STR(?v)) AS ?c)", "WHERE { ?o :text ?t ; :value ?v }"),
    "joined texts": ("SELECT (GROUP_CONCAT(?t) AS ?c)", "WHERE { ?o :text ?t }"),
    "blank nodes": ("CONSTRUCT { [] :of ?o ; :value ?v }", "WHERE { ?o :value ?v }"),
}


@pytest.mark.parametrize("name", QUERIES)
def test_an_hour_of_new_terms_is_flat(name, monkeypatch) -> None:
    monkeypatch.setattr(module, "SWEEP_FLOOR", 256)
    monkeypatch.setattr(aggregation, "COMPACT", 16)
    head, body, *how = QUERIES[name]
    asked = Asked(head, body, "[RANGE 40s STEP 20s]", semantics=how[0] if how else "bag")
    dictionary, most, came = asked.dictionary, 0, 0
    for second in range(0, 3600, 20):
        rows = []
        for i in range(second, second + 20, 4):
            value = Literal(i) if i % 8 else Literal(i + 0.5)
            rows += [
                (i * SECOND, node(f"o{i}"), VALUE, value),
                (i * SECOND, node(f"o{i}"), TEXT, Literal(f"text {i}")),
                (i * SECOND, node(f"o{i}"), AFTER, node(f"o{i - 4}")),
            ]
        before = dictionary.count
        asked.evaluator.push(STREAM, from_terms(rows, dictionary))
        results = asked.evaluator.advance(STREAM, (second + 20) * SECOND)
        assert second < 40 or results[-1].size
        came += dictionary.count - before
        del results
        dictionary.collect()
        most = max(most, dictionary.count)
    # What a step brings may come on top of what is not worth a sweep.
    assert most < 256 + 64
    assert len(dictionary) <= len(asked.evaluator._windows.terms._sort) < 2 * (256 + 64)
    assert came >= 1_800


def test_by_oxigraph_it_is_flat_as_well(monkeypatch) -> None:
    monkeypatch.setattr(module, "SWEEP_FLOOR", 256)
    asked = Asked("SELECT (CONCAT(?t, '!') AS ?c) ?v", "WHERE { ?o :text ?t ; :value ?v }")
    asked.evaluator._solver.execution = None
    dictionary, most = asked.dictionary, 0
    for second in range(0, 3600, 10):
        rows = [
            (second * SECOND, node(f"o{second}"), VALUE, Literal(second)),
            (second * SECOND, node(f"o{second}"), TEXT, Literal(f"text {second}")),
        ]
        asked.evaluator.push(STREAM, from_terms(rows, dictionary))
        results = asked.evaluator.advance(STREAM, (second + 10) * SECOND)
        assert second < 20 or results[-1].size == 1
        del results
        dictionary.collect()
        most = max(most, dictionary.count)
    assert most < 300


# -- who holds what --------------------------------------------------------------------------


def test_a_sort_that_was_told_before_the_rows_came_is_still_known() -> None:
    asked = Asked(
        "SELECT ?o (AVG(?v) AS ?m)",
        "WHERE { ?o a :Sort ; :value ?v } GROUP BY ?o",
        "[RANGE 10s STEP 1s]",
    )
    assert not asked.evaluator._solver.retains
    asked.push((0.5, node("a"), RDF_TYPE, SORT))
    for second, name in ((2, "y"), (3, "x")):
        asked.push((second, node(name), VALUE, Literal(0)))
    asked.push((4, node("b"), VALUE, Literal(1)), (4.5, node("a"), VALUE, Literal(2.0)))
    assert asked.push((6, node("z"), VALUE, Literal(0)))[-1] == [
        {"o": node("a"), "m": Literal(2.0)}
    ]


def test_what_has_been_seen_in_the_window_is_known_to_be_the_same() -> None:
    asked = Asked(
        "SELECT (COUNT(?v) AS ?n)",
        "WHERE { :o :value ?v }",
        "[RANGE 9s STEP 1s]",
        semantics="set",
    )
    assert not asked.evaluator._solver.retains
    for second in range(1, 9):
        text = Literal("again" if second % 2 else f"text {second}")
        found = asked.push((second, node("o"), VALUE, text))
    assert found[-1] == [{"n": Literal(4)}]


def test_the_one_spelling_of_a_term_stays_as_long_as_the_term() -> None:
    asked = Asked("SELECT ?o ?v", "WHERE { ?o ?p ?v }")
    spelled = literal("2020-01-01T00:00:00.000Z", "dateTime")
    kept = from_terms([(0, node("a"), VALUE, spelled)], asked.dictionary)
    asked.push((1, node("a"), VALUE, spelled))
    asked.push((30, node("b"), VALUE, node("c")))
    asked.push((60, node("d"), VALUE, node("e")))
    asked.push((61, node("f"), VALUE, node("g")), (62, node("a"), VALUE, spelled))
    (found,) = asked.push((75, node("h"), VALUE, node("i")))
    values = {row["o"]: row["v"] for row in found}
    assert values[node("a")] == literal("2020-01-01T00:00:00Z", "dateTime")
    assert len(kept) == 1


def test_an_id_that_is_used_again_is_looked_at_again() -> None:
    """Decimals that a float holds and such that none does, with each other's ids in turn."""
    asked = Asked("SELECT (COUNT(?v) AS ?n)", "WHERE { :o :value ?v }", semantics="set")
    for start in range(0, 400, 20):
        # One value in two spellings, and a neighbour that is the same float.
        values = [f"{start}.00", f"{start}.0", f"{start}.00000000000000000000001"]
        others = [Literal(f"text {i}") for i in range(start // 20 % 6)]
        terms = [*others, *(literal(text, "decimal") for text in values)]
        asked.push(*((start + 1, node("o"), VALUE, term) for term in terms))
        found = asked.push((start + 15, node("p"), VALUE, Literal(1)))
        assert [{"n": Literal(len(others) + 2)}] in found


def test_rows_stand_in_the_order_of_names_whatever_ids_predicates_get() -> None:
    asked = Asked("SELECT ?p ?o", "WHERE { ?s ?p ?o }", "[RANGE 1s STEP 1s]")
    for second in range(1, 40, 2):
        names = [f"p{(second * k) % 7}" for k in (3, 1, 2)]
        rows = [(second, node("s"), node(name), Literal(second)) for name in dict.fromkeys(names)]
        found = asked.push(*rows) + asked.push((second + 1, node("s"), node("q"), Literal(0)))
        assert [str(row["p"]) for row in found[-1]] == sorted({f"<{PLACE}{n}>" for n in names})


def test_who_counts_distinct_subjects_holds_them() -> None:
    dictionary, traffic = TermDictionary(), Traffic()
    for second in range(20):
        rows = [(second * SECOND, node(f"o{second}"), VALUE, node(f"x{second}"))]
        traffic.add(from_terms(rows, dictionary))
        dictionary._sweep()
    said = traffic.flow().predicates[VALUE.value]
    assert (said.subjects, said.objects) == (20, 20)


def test_results_that_are_kept_keep_their_terms() -> None:
    asked = Asked("SELECT (CONCAT(STR(?o), '!') AS ?c)", "WHERE { ?o :value ?v }")
    asked.evaluator.push(STREAM, from_terms([(0, node("a"), VALUE, Literal(1))], asked.dictionary))
    (result,) = asked.evaluator.advance(STREAM, 1)
    asked.push((100, node("b"), VALUE, Literal(1)))
    asked.push((200, node("c"), VALUE, Literal(1)))
    assert result.solutions.rows() == [{"c": Literal(f"{PLACE}a!")}]
    part = result.solutions.take(np.array([0]))
    del result
    asked.push((300, node("d"), VALUE, Literal(1)))
    assert part.rows() == [{"c": Literal(f"{PLACE}a!")}]


# -- instances of a template -----------------------------------------------------------------


class Instances:
    """A template over one stream, an instance for each of its arguments."""

    def __init__(self, body: str, *arguments: dict) -> None:
        text = f"PREFIX : <{PLACE}> REGISTER QUERY q AS SELECT ?o ?v FROM STREAM <{STREAM}> "
        self.dictionary = TermDictionary()
        self.evaluator = TemplateEvaluator(
            parse_query(f"{text} [RANGE 2s STEP 2s] WHERE {{ {body} }}"),
            self.dictionary,
            Background(Store()),
            [STREAM],
        )
        for given in arguments:
            self.evaluator.add({Variable(name): term for name, term in given.items()})

    def push(self, *triples) -> list:
        """``(second, subject, predicate, object)``; the results of the windows that close."""
        timed = [(time * SECOND, *rest) for time, *rest in triples]
        self.evaluator.push(STREAM, from_terms(timed, self.dictionary))
        found = self.evaluator.advance(STREAM, timed[-1][0])
        self.dictionary._sweep()
        return found


def rows_of(results: list, instance: int) -> list:
    return [row for result in results for row in result.of(instance).solutions.rows()]


def test_the_arguments_of_instances_are_held() -> None:
    asked = Instances("?o :value ?v", {"o": node("a")}, {"o": node("b")})
    asked.push((1, node("x"), VALUE, node("y")))
    for second in range(4, 40, 4):
        names = "bzxa" if second % 8 else "axb"
        rows = [(second, node(name), VALUE, Literal(f"{name} {second}")) for name in names]
        asked.push(*rows)
        found = asked.push((second + 3, node(f"n{second}"), VALUE, node(f"m{second}")))
        for instance, name in enumerate("ab"):
            told = [row["v"] for row in rows_of(found, instance)]
            assert told == [Literal(f"{name} {second}")]


def test_arguments_that_are_compared_are_held() -> None:
    asked = Instances("?o :value ?v FILTER (?o != ?x)", {"x": node("a")}, {"x": node("b")})
    for second in range(0, 120, 12):
        asked.push(*((second, node(f"{n}{second}"), VALUE, Literal(n)) for n in range(6)))
        rows = ((second + 2, node(name), VALUE, Literal(0)) for name in ("x", "a", "y", "b"))
        found = asked.push(*rows) + asked.push((second + 3, node("z"), VALUE, Literal(0)))
        told = [{row["o"] for row in rows_of(found, instance)} for instance in (0, 1)]
        del found  # else the results hold them
        asked.push((second + 9, node("z"), VALUE, Literal(1)))
        asked.dictionary._sweep()
        assert told[0] ^ told[1] == {node("a"), node("b")}
        assert node("b") in told[0]


def test_numbers_that_arguments_are_stay_what_they_are_in_mixed_columns() -> None:
    asked = Instances("?o :value ?v", {"v": Literal(5)}, {"v": Literal(2.5)})
    for second in range(4, 40, 4):
        values = [Literal(5), Literal(2.5), Literal(f"text {second}"), node(f"n{second}")]
        if second % 8:
            values = values[2:]
        asked.push(*((second, node(f"o{i}"), VALUE, value) for i, value in enumerate(values)))
        found = asked.push((second + 3, node(f"x{second}"), VALUE, node(f"y{second}")))
        for instance in (0, 1):
            told = [row["o"] for row in rows_of(found, instance)]
            assert told == ([] if second % 8 else [node(f"o{instance}")])


def test_results_of_templates_that_are_kept_keep_their_terms() -> None:
    asked = Instances("?o :value ?v", {"v": Literal(5)})
    asked.push((1, node("a"), VALUE, Literal(5)))
    kept = asked.push((3, node("b"), VALUE, Literal(6)))
    for second in range(10, 30, 5):
        asked.push((second, node(f"c{second}"), VALUE, Literal(second)))
    assert [row["o"] for row in rows_of(kept, 0)] == [node("a")]
