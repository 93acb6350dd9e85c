"""Golden cases of `explain`: ``tests/cases/explain/*.case`` (title, query, ``----``, printout).

``DYKNOW_REWRITE=1 pytest tests/continuous/evaluation/test_explain.py`` writes the printouts anew.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from places import TESTS

from dyknow.continuous.evaluation.evaluator import ContinuousEvaluator
from dyknow.continuous.operators.background import Background
from dyknow.languages.csparql import parse_query
from dyknow.rdf.dictionary import TermDictionary
from dyknow.streams.jit import JIT

CASES = sorted((TESTS / "cases" / "explain").glob("*.case"))


def test_there_are_cases() -> None:
    assert CASES


@pytest.mark.skipif(not JIT, reason="no compiled loop: the plans run in columns")
@pytest.mark.parametrize("path", CASES, ids=lambda path: path.stem)
def test_case(path: Path) -> None:
    title, _, rest = path.read_text(encoding="utf-8").partition("\n")
    text, _, expected = rest.partition("----\n")
    query = parse_query(text.rstrip("\n"))
    inputs = [clause.iri for clause in query.streams]
    evaluator = ContinuousEvaluator(query, TermDictionary(), Background(), inputs)
    printed = evaluator.explain()
    if os.environ.get("DYKNOW_REWRITE") == "1":
        path.write_text(f"{title}\n{text}----\n{printed}\n", encoding="utf-8")
        return
    assert printed == expected.rstrip("\n"), title
