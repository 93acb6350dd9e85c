"""The form of a query: what it has to agree on with others, and what its constants are."""

import pytest
from pyoxigraph import Literal, NamedNode, Store

from dyknow.continuous.algebra import plan
from dyknow.continuous.algebra.constant_lifting import generalize, match_constants
from dyknow.continuous.algebra.expressions import Var
from dyknow.continuous.algebra.options import Options
from dyknow.continuous.columns.relation import TermValues
from dyknow.continuous.estimation.input_rates import Flow
from dyknow.continuous.operators.background import Background
from dyknow.continuous.operators.sources import StaticSide
from dyknow.continuous.sharing import similar_queries
from dyknow.continuous.sharing.similar_queries import (
    SimilarQueriesEvaluator,
    Unshared,
    break_even_count,
    form_of,
)
from dyknow.languages.csparql import parse_query
from dyknow.rdf.dictionary import TermDictionary

DYKNOW = "http://www.ida.liu.se/dyknow/"
STREAM = f"FROM STREAM <{DYKNOW}s.trdf> [RANGE 5s STEP 1s]"
MANY = " || ".join(f"?v = {i}" for i in range(129))


def read(select, where, after="", stream=STREAM):
    text = f"REGISTER QUERY q AS SELECT {select} {stream} WHERE {{ {where} }} {after}"
    return parse_query(text)


def form(*parts, options=None, **more):
    return form_of(read(*parts, **more), ["s"], options or Options())


def node(name):
    return NamedNode(DYKNOW + name)


def test_white_space_and_prefixes_make_no_difference():
    one = form("?o", "?o dyknow:speed ?v FILTER (?v > 1)")
    other = form("?o", f"?o  <{DYKNOW}speed> ?v\n FILTER(?v>2)")
    assert one[0] == other[0]
    assert (one[1], other[1]) == ((Literal(1),), (Literal(2),))


def test_a_name_is_one_constant_and_a_literal_one_wherever_it_is_written():
    found = form("?v", "dyknow:a dyknow:speed ?v ; dyknow:heading ?h FILTER (?v > 1 && ?h > 1)")
    assert sorted(map(str, found[1])) == sorted(map(str, (node("a"), Literal(1), Literal(1))))
    assert form("?v", "dyknow:a dyknow:speed ?v . dyknow:a dyknow:heading ?h")[1] == (node("a"),)


@pytest.mark.parametrize(
    ("parts", "constants"),
    [
        # A sort, what is compared below an aggregate, what an implicit group is made of.
        (("?v", "?o a dyknow:UAV ; dyknow:speed ?v FILTER (?v > 1)"), [Literal(1)]),
        (
            ("(SUM(?v) AS ?x)", "?o dyknow:speed ?v FILTER (?v > 1)", "HAVING (SUM(?v) > 2)"),
            [Literal(2)],
        ),
        (("(COUNT(*) AS ?n)", "dyknow:a dyknow:speed ?v"), []),
        (("?v (COUNT(*) AS ?n)", "dyknow:a dyknow:speed ?v", "GROUP BY ?v"), [node("a")]),
        (("?v", "?o dyknow:speed ?v FILTER (?v > 1)", "LIMIT 1"), []),
    ],
)
def test_what_the_plan_has_to_have_stays_in_the_form(parts, constants):
    assert list(form(*parts)[1]) == constants


@pytest.mark.parametrize(
    ("parts", "more", "why"),
    [
        (("?v", "?o dyknow:speed ?v"), {"options": Options(report="close")}, "when it began"),
        (("?v", "?o dyknow:speed ?v", "ORDER BY ?v"), {}, "ORDER BY"),
        (("(NOW() AS ?t)", "?o dyknow:speed ?v"), {}, "NOW"),
        (("(UUID() AS ?t)", "?o dyknow:speed ?v"), {}, "another value each time"),
        (("(BNODE() AS ?t)", "?o dyknow:speed ?v"), {}, "Oxigraph, because of BNODE"),
        (
            ("?v", "?o dyknow:speed ?v"),
            {"stream": STREAM.replace("RANGE 5s", "LANDMARK")},
            "lasts",
        ),
        (("?v", f"?o dyknow:speed ?v FILTER({MANY})"), {}, "129 constants, more than 128"),
    ],
)
def test_what_is_a_querys_own_has_no_form(parts, more, why):
    with pytest.raises(Unshared, match=why):
        form(*parts, **more)


def test_what_queries_have_in_common_is_no_parameter():
    a, b, one, two = node("a"), node("b"), Literal(1), Literal(2)
    pattern = generalize([(a, one, one, b), (b, one, one, a), (a, one, two, b)])
    first, second, third, fourth = pattern
    assert second == one
    assert isinstance(first, Var)
    assert len({first, third, fourth}) == 3
    # Constants that differ alike are one.
    assert len(set(generalize([(a, a, one), (b, b, two)]))) == 2
    assert match_constants(pattern, (a, one, two, a)) == {
        first.name: a,
        third.name: two,
        fourth.name: a,
    }
    assert match_constants(pattern, (a, two, two, a)) is None
    assert match_constants(generalize([(a, a), (b, b)]), (a, b)) is None


def likely(*parts, others, rate=1_000.0):
    """From how many on it is worth while; ``others`` are words and what stands for them."""
    members = [form(*(part.replace(*other) for part in parts)) for other in (("", ""), others)]
    pattern = generalize([constants for _, constants in members])
    static = StaticSide(Background(Store()), TermValues(TermDictionary()))
    return break_even_count(members[0][0], pattern, members[0][1], static, {"s": Flow(rate)})


def test_a_plan_without_its_constants_may_be_larger():
    assert likely("?o", "?o dyknow:speed ?v FILTER (?v > 1)", others=("1", "2")) <= 2
    pairs = "dyknow:a dyknow:speed ?v ; dyknow:heading ?h"
    assert likely("?v", pairs, others=("dyknow:a", "dyknow:b")) > 4
    apart = "dyknow:a dyknow:speed ?v . ?x dyknow:heading ?h"
    slow = likely("?v", apart, others=("dyknow:a", "dyknow:b"), rate=10.0)
    assert slow < 4 < likely("?v", apart, others=("dyknow:a", "dyknow:b"))


def test_who_does_not_fit_is_refused():
    query = read("?o", "?o dyknow:speed ?v FILTER (?v > 1)")
    found, constants = form_of(query, ["s"], Options())
    evaluator = SimilarQueriesEvaluator(
        query, found, constants, TermDictionary(), Background(Store()), ["s"]
    )
    number = evaluator.add(query, constants)
    assert len(evaluator) == 1
    with pytest.raises(ValueError, match="differs in more"):
        evaluator.add(query, (Literal(2),))
    evaluator.remove(number)
    with pytest.raises(KeyError):
        evaluator.remove(number)


def test_all_constants_that_have_to_be_kept_are_found_in_one_look(monkeypatch):
    """Finding one at a time took a minute for a query of 75 branches."""
    looks = []
    joint = similar_queries.build_joint

    def counted(*given):
        looks.append(given)
        return joint(*given)

    monkeypatch.setattr(similar_queries, "build_joint", counted)
    branches = (f"{{ ?o dyknow:speed ?v FILTER (?v > {number}) }}" for number in range(40))
    assert form("?o", " UNION ".join(branches))[1] == ()
    assert len(looks) <= 3


def test_names_are_looked_for_once_in_each_part(monkeypatch):
    asked = []
    own_names = plan.own_names

    def counted(node):
        asked.append(node)
        return own_names(node)

    monkeypatch.setattr("dyknow.continuous.algebra.template_parameters.own_names", counted)
    form("?o", " UNION ".join(f"{{ dyknow:a dyknow:p{i} ?v }}" for i in range(30)))
    # Unions stand in each other: asked anew on each level, it would be some 30 times as often.
    assert len(asked) < 500
