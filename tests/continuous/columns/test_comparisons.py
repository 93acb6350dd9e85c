"""The short way of a comparison with a constant equals the way of any two columns."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyoxigraph import Literal, NamedNode

from dyknow.continuous.algebra.expressions import COMPARISONS, Call, Const, Var
from dyknow.continuous.columns import expression_evaluation
from dyknow.continuous.columns.expression_evaluation import evaluate
from dyknow.continuous.columns.relation import TermValues
from dyknow.rdf.dictionary import TermDictionary
from dyknow.rdf.namespaces import XSD
from dyknow.rdf.timed import Kind, ObjectColumn

whole = st.sampled_from([0, 1, -3, 2**53, 2**53 + 1, -(2**53) - 1, 2**63 - 1, -(2**63)])
doubles = st.sampled_from([0.0, -0.0, 0.1, 2.5, -3.0, 2.0**53, 9.3e18, np.inf, -np.inf, np.nan])
decimals = st.sampled_from([0.0, 0.1, 2.5, -3.0, 2.0**53, 9e15, 1e17])
VALUES = {
    Kind.INTEGER: whole,
    Kind.DECIMAL: decimals,
    Kind.FLOAT: doubles,
    Kind.DOUBLE: doubles,
    Kind.BOOLEAN: st.booleans(),
}
CONSTANTS = [
    ("integer", ["0", "1", "-3", "007", str(2**53), str(2**53 + 1), str(2**63 - 1), str(2**64)]),
    ("int", ["1", "-3"]),
    ("decimal", ["0.1", "2.5", "-3", "9007199254740993", "0.1000000000000000000001", "1.0"]),
    ("double", ["0.1", "2.50", "-0", "9007199254740993", "INF", "NaN", "x"]),
    ("float", ["0.1", "1e1"]),
    ("boolean", ["true"]),
    ("string", ["a"]),
]
constants = st.sampled_from(
    [Literal(text, datatype=NamedNode(XSD + name)) for name, texts in CONSTANTS for text in texts]
)


@given(st.sampled_from(COMPARISONS), constants, st.sampled_from(sorted(VALUES)), st.data())
def test_the_short_way_changes_no_value(name, constant, kind, data) -> None:
    values = data.draw(st.lists(VALUES[kind], max_size=6))
    marks = data.draw(st.none() | st.lists(st.booleans(), min_size=6, max_size=6))
    null = None if marks is None else np.array(marks[: len(values)], np.bool_)
    columns = {"x": ObjectColumn(kind, np.array(values, kind.dtype), null)}
    call, terms = Call(name, (Var("x"), Const(constant))), TermValues(TermDictionary())
    found = evaluate(call, columns, len(values), terms)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(expression_evaluation, "_compared", lambda *_: None)
        wanted = evaluate(call, columns, len(values), terms)
    assert np.array_equal(found.present, wanted.present)
    assert np.array_equal(found.values[found.present], wanted.values[wanted.present])
