"""Instances of a template: how they come and go, what is shared, what each one gets."""

from __future__ import annotations

import numpy as np
import pytest
from pyoxigraph import BlankNode, Literal, NamedNode, Quad, Store, Variable

from dyknow.continuous.columns.relation import NeedsOxigraph
from dyknow.continuous.evaluation.evaluator import ContinuousEvaluator
from dyknow.continuous.operators.background import Background
from dyknow.continuous.sharing import cohorts
from dyknow.continuous.sharing.instance_results import JoinedResults, SeparateResults
from dyknow.continuous.sharing.template_instances import TemplateEvaluator
from dyknow.languages.csparql import bind, parse_query, parse_template
from dyknow.rdf.dictionary import TermDictionary
from dyknow.rdf.namespaces import DYKNOW, OWL, RDF_TYPE, XSD
from dyknow.rdf.terms_to_columns import from_terms

S = 10**9
X = DYKNOW + "x.trdf"
SPEED, UAV, CAR = (NamedNode(DYKNOW + name) for name in ("speed", "UAV", "Car"))
ONE, TWO, THREE = (NamedNode(f"{DYKNOW}uav{i}") for i in (1, 2, 3))
WHO, TYPE, THRESHOLD = Variable("o"), Variable("type"), Variable("threshold")
HIGH_SPEED = f"""REGISTER TEMPLATE dyknow:HighSpeedEvent(?o, ?type, ?threshold) COMPUTE EVERY 1s AS
PREFIX dyknow: <{DYKNOW}>
CONSTRUCT {{?o dyknow:speed ?avgSpeed}}
WHERE {{ ?o a ?type . ?o dyknow:speed ?spd . }}
AGGREGATE {{(?avgSpeed, AVG, {{?spd}}) FILTER (?avgSpeed > ?threshold)}}
WINDOW [RANGE 5s STEP 1s]
"""


class Run:
    """A template over one stream, and for each instance its own query over the same."""

    def __init__(self, query) -> None:
        store = Store()
        store.extend(Quad(o, RDF_TYPE, UAV) for o in (ONE, TWO))
        store.add(Quad(THREE, RDF_TYPE, CAR))
        self.background, self.dictionary = Background(store), TermDictionary()
        self.query = query
        self.template = TemplateEvaluator(query, self.dictionary, self.background, [X])
        self.own: dict[int, ContinuousEvaluator] = {}

    def add(self, **given) -> int:
        arguments = {Variable(name): term for name, term in given.items()}
        number = self.template.add(arguments)
        self.own[number] = ContinuousEvaluator(
            bind(self.query, arguments), self.dictionary, self.background, [X]
        )
        return number

    def push(self, *rows) -> None:
        triples = from_terms([(at, o, SPEED, Literal(v)) for at, o, v in rows], self.dictionary)
        self.template.push(X, triples)
        for own in self.own.values():
            own.push(X, triples)

    def advance(self, watermark: int | None) -> list:
        """The results of the template, which are those of the own queries."""

        def go(evaluator) -> list:
            return evaluator.end(X) if watermark is None else evaluator.advance(X, watermark)

        results = go(self.template)
        for number, own in self.own.items():
            wanted = [shown(result) for result in go(own)]
            assert [shown(r) for w in results if (r := w.of(number)) is not None] == wanted
        return results


def shown(result) -> object:
    if result.triples is not None:
        content = sorted(map(str, result.triples))
    elif result.solutions is not None:
        content = sorted(map(str, result.solutions.rows()))
    else:
        content = result.answer
    return result.start, result.end, content


def high_speed() -> Run:
    return Run(parse_template(HIGH_SPEED).query)


def test_each_instance_has_its_own_object_and_threshold() -> None:
    run = high_speed()
    slow = run.add(o=ONE, type=UAV, threshold=Literal(10))
    fast = run.add(o=ONE, type=UAV, threshold=Literal(100.0))
    other = run.add(o=THREE, type=UAV, threshold=Literal(10))
    every = run.add(type=UAV, threshold=Literal(10))
    car = run.add(o=THREE, type=CAR, threshold=Literal(10))
    run.push((S, ONE, 50.0), (S, TWO, 60.0), (S, THREE, 70.0))
    (result,) = run.advance(S + 1)
    sizes = {i: result.of(i).size for i in (slow, fast, other, every, car)}
    assert sizes == {slow: 1, fast: 0, other: 0, every: 2, car: 1}
    assert result.instances.tolist() == [slow, fast, other, every, car]
    told = sorted(n for numbers, _ in result.triples() for n in numbers.tolist())
    assert told == [slow, every, every, car]
    assert result.size == 4


def test_one_that_comes_later_sees_whole_windows_from_then_on() -> None:
    run = high_speed()
    run.add(o=ONE, type=UAV, threshold=Literal(10))
    run.push((S, ONE, 50.0), (2 * S, TWO, 60.0))
    run.advance(2 * S + 1)
    late = run.template.add({WHO: ONE, TYPE: UAV, THRESHOLD: Literal(20)})
    # Of another cohort, which has to fold what had come before it.
    car = run.template.add({TYPE: UAV})
    run.push((3 * S, TWO, 60.0))
    (result,) = run.advance(3 * S + 1)
    assert (result.start, result.end) == (-2 * S, 3 * S)
    assert [t[3] for t in result.of(late).triples] == [Literal(50.0)]
    assert result.of(car).size == 0


def test_one_that_goes_is_not_told_of_any_more() -> None:
    run = high_speed()
    stays = run.add(o=ONE, type=UAV, threshold=Literal(10))
    numbers = [run.template.add({WHO: ONE, TYPE: UAV, THRESHOLD: Literal(i)}) for i in range(9)]
    run.push((S, ONE, 50.0))
    (first,) = run.advance(S + 1)
    for number in numbers:
        run.template.remove(number)
    (second,) = run.advance(2 * S + 1)
    assert second.instances.tolist() == [stays]
    assert second.of(numbers[0]) is None
    assert len(run.template) == 1
    # What was told stays told.
    assert first.of(numbers[0]).size == 1
    assert first.instances.tolist() == [stays, *numbers]
    again = run.template.add({WHO: ONE, TYPE: UAV, THRESHOLD: Literal(0)})
    assert again > max(numbers)
    assert run.advance(3 * S + 1)[0].of(again).size == 1


def test_a_template_may_have_arguments_before() -> None:
    run = Run(bind(parse_template(HIGH_SPEED).query, {TYPE: UAV}))
    for who in (ONE, THREE):
        run.add(o=who, threshold=Literal(10))
    run.push((S, ONE, 50.0), (S, THREE, 70.0))
    (result,) = run.advance(S + 1)
    assert [result.of(i).size for i in (0, 1)] == [1, 0]
    assert "?threshold: compared, found by order" in run.template.explain()


def test_a_window_that_columns_cannot_judge_is_evaluated_for_each(monkeypatch) -> None:
    def refuse(*_arguments: object) -> None:
        raise NeedsOxigraph

    run = Run(
        parse_query(
            f"PREFIX dyknow: <{DYKNOW}> REGISTER QUERY q AS SELECT ?o "
            f"FROM STREAM <{X}> [RANGE 5s STEP 1s] "
            "WHERE { ?o dyknow:speed ?v FILTER(?threshold) }"
        )
    )
    date = Literal("2020-01-01", datatype=NamedNode(XSD + "date"))
    yes, strange = run.add(threshold=Literal(1)), run.add(threshold=date)
    run.push((S, ONE, 50.0))
    with monkeypatch.context() as patched:
        patched.setattr(cohorts, "holds", refuse)
        (result,) = run.advance(S + 1)
    assert (result.of(yes).size, result.of(strange).size) == (1, 0)
    assert [type(part) for part in result.parts] == [SeparateResults]
    assert result.answered.tolist() == [yes]
    run.template.remove(strange)
    del run.own[strange]
    (result,) = run.advance(2 * S + 1)
    assert [type(part) for part in result.parts] == [JoinedResults]


def test_what_is_wrong_is_refused() -> None:
    run = high_speed()
    with pytest.raises(ValueError, match="does not use"):
        run.template.add({Variable("altitude"): ONE})
    for _ in range(2):
        with pytest.raises(ValueError, match="blank node"):
            run.template.add({WHO: BlankNode("b")})
    number = run.template.add({WHO: ONE})
    run.template.remove(number)
    for gone in (number, 77, -1):
        with pytest.raises(KeyError):
            run.template.remove(gone)
    run.push((S, ONE, 50.0))
    assert run.template.end(X) == []


def test_explain_says_what_is_shared_and_why_something_is_not() -> None:
    run = high_speed()
    for i in range(3):
        run.add(o=ONE, type=UAV, threshold=Literal(i))
    run.add(o=ONE)
    text = run.template.explain()
    assert "4 instances in 2 cohorts" in text
    assert "?o: joined, patterns bind it" in text
    assert "?threshold: compared, found by order" in text
    assert "?type: fixed, ?type is a sort, of which there are few" in text
    assert "in columns, incrementally" in text


@pytest.mark.parametrize(
    "body",
    [
        "SELECT ?v WHERE { ?o a ?type; dyknow:speed ?v FILTER(?v > ?threshold) } "
        "ORDER BY ?v LIMIT 1",
        "SELECT ?o ?v WHERE { ?o dyknow:speed ?v OPTIONAL { ?o a ?type } FILTER(?v > ?threshold) }",
        "ASK WHERE { ?o dyknow:speed ?v MINUS { ?o a ?type } FILTER(?v > ?threshold) }",
        # The truth of a date is an error that Oxigraph has to find.
        "SELECT ?o ?v WHERE { ?o dyknow:speed ?v . ?o a ?type FILTER(?threshold) }",
        "SELECT ?v (NOW() AS ?n) WHERE { ?o dyknow:speed ?v . ?o a ?type FILTER(?v > ?threshold) }",
        "DESCRIBE ?o WHERE { ?o dyknow:speed ?v . ?o a ?type FILTER(?v > ?threshold) }",
    ],
)
@pytest.mark.parametrize("window", ["RANGE 5s STEP 1s", "TRIPLES 3", "LANDMARK STEP 1s"])
def test_what_cannot_be_shared_is_evaluated_alone(body, window) -> None:
    at = body.index("WHERE")
    query = parse_query(
        f"PREFIX dyknow: <{DYKNOW}> REGISTER QUERY q AS {body[:at]} "
        f"FROM STREAM <{X}> [{window}] {body[at:]}"
    )
    run = Run(query)
    date = Literal("2020-01-01", datatype=NamedNode(XSD + "date"))
    for threshold in (Literal(55), Literal(0.5), date, Literal("x")):
        run.add(type=UAV, threshold=threshold)
        run.add(o=ONE, type=CAR, threshold=threshold)
    for second in range(1, 9):
        run.push((second * S, ONE, 50.0 + second), (second * S, TWO, 60.0 - second))
        run.advance(second * S + 1)
    run.advance(None)


@pytest.mark.parametrize("operator", ["RSTREAM", "ISTREAM", "DSTREAM"])
def test_differences_are_those_of_an_instance(operator) -> None:
    query = parse_query(
        f"PREFIX dyknow: <{DYKNOW}> REGISTER {operator} <{DYKNOW}out> AS SELECT ?o ?v "
        f"FROM NAMED WINDOW dyknow:w ON <{X}> [RANGE PT2S STEP PT1S] "
        "WHERE { WINDOW dyknow:w { ?o dyknow:speed ?v } FILTER(?v > ?threshold) }"
    )
    run = Run(query)
    for threshold in (50, 52, 99):
        run.add(o=ONE, threshold=Literal(threshold))
        run.add(threshold=Literal(threshold))
    for second in range(1, 9):
        run.push((second * S, ONE, 50.0 + second // 2), (second * S, TWO, 60.0))
        run.advance(second * S + 1)
    run.advance(None)


def test_many_come_and_go_by_columns() -> None:
    run = high_speed()
    random = np.random.default_rng(3)
    limits = random.uniform(0, 100, 5000)
    numbers = [
        run.template.add({WHO: (ONE, TWO)[i % 2], TYPE: UAV, THRESHOLD: Literal(float(limit))})
        for i, limit in enumerate(limits)
    ]
    gone = set()
    for second in range(1, 6):
        run.push((second * S, ONE, 40.0), (second * S, TWO, 70.0))
        (result,) = run.advance(second * S + 1)
        fired = {n for found, _ in result.triples() for n in found.tolist()}
        speeds = {i: (40.0, 70.0)[i % 2] for i in range(5000)}
        assert fired == {i for i in numbers if i not in gone and speeds[i] > limits[i]}
        for number in random.choice(sorted(set(numbers) - gone), 700, replace=False).tolist():
            run.template.remove(number)
            gone.add(number)


def test_requests_of_own_objects_share_nothing_where_triples_tell_of_other_objects() -> None:
    """A stream of one object lacks what those of others entail of it."""
    near = NamedNode("http://d.example/near")
    text = """REGISTER TEMPLATE d:Beside(?o) AS PREFIX d: <http://d.example/>
        SELECT ?o ?p WHERE { ?o d:near ?p } WINDOW [RANGE 1s STEP 1s]"""
    store = Store()

    def agreement() -> frozenset[str] | None:
        template = TemplateEvaluator(
            parse_template(text).query, TermDictionary(), Background(store), [X]
        )
        return template.agreement({Variable("o"): ONE}, ["o"], [near.value])

    assert agreement() == frozenset()
    store.add(Quad(near, RDF_TYPE, NamedNode(OWL + "SymmetricProperty")))
    assert agreement() is None


def test_limits_that_floats_do_not_tell_apart() -> None:
    """Instances are searched by floats only where these decide."""
    run = Run(
        parse_query(
            f"PREFIX dyknow: <{DYKNOW}> REGISTER QUERY q AS SELECT ?o "
            f"FROM STREAM <{X}> [RANGE 5s STEP 1s] "
            "WHERE { ?o dyknow:speed ?v FILTER(?v > ?threshold) }"
        )
    )
    near = Literal("9007199254740992", datatype=NamedNode(XSD + "decimal"))
    far = Literal(str(2**63), datatype=NamedNode(XSD + "integer"))
    low, exact, high = (run.add(threshold=term) for term in (near, Literal(2**53 + 1), far))
    run.push((S, ONE, 2**53 + 1), (S, TWO, 3))
    (result,) = run.advance(S + 1)
    assert [result.of(i).size for i in (low, exact, high)] == [1, 0, 0]
    decimal = Literal("9007199254740994.0", datatype=NamedNode(XSD + "decimal"))
    greater = run.add(threshold=far)
    run.template.push(X, from_terms([(2 * S, ONE, SPEED, decimal)], run.dictionary))
    run.template.push(X, from_terms([(2 * S, TWO, SPEED, Literal(1e30))], run.dictionary))
    (result,) = run.template.advance(X, 2 * S + 1)
    assert [result.of(i).size for i in (low, exact, high, greater)] == [3, 2, 1, 1]
