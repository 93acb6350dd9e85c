"""The places of mutants, which `make soak` runs, are still there."""

from __future__ import annotations

import runpy

import pytest
from places import ROOT

LAWS = ROOT / "tests" / "laws" / "reasoning"
MUTANTS = runpy.run_path(str(LAWS / "mutants.py"))["MUTANTS"]


@pytest.mark.parametrize(("file", "text", "other", "law"), MUTANTS)
def test_the_text_stands_once(file: str, text: str, other: str, law: str) -> None:
    assert (ROOT / "reasoning" / file).read_text(encoding="utf-8").count(text) == 1
    assert text != other
    assert (LAWS / law).exists()
