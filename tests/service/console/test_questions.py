"""The console's questions are those of the page on introspection."""

from __future__ import annotations

import importlib.util

from places import ROOT

SCRIPT = ROOT / "docs" / "console_questions.py"


def test_the_questions_are_current() -> None:
    spec = importlib.util.spec_from_file_location("console_questions", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    assert len(script.questions()) == 23
    file = ROOT / "service" / "console" / "questions.js"
    assert file.read_text() == script.render(), "run .venv/bin/python docs/console_questions.py"
