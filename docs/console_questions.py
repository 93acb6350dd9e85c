"""Write service/console/questions.js from the questions of docs/how-to/ask-the-system.md.

    .venv/bin/python docs/console_questions.py

tests/service/console/test_questions.py fails while the file is not current, and asks each question.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

HERE = Path(__file__).parent
PAGE = HERE / "how-to" / "ask-the-system.md"
FILE = HERE.parent / "service" / "console" / "questions.js"
FIRST = {
    "Which streams are there, and what do they mean?": """SELECT ?stream ?unit ?feature {
  ?s a :Stream ; :hasName ?stream
  OPTIONAL { ?s :isOutput/:hasName ?unit }
  OPTIONAL { ?s :hasAnnotation/:hasOutputAnnotation/:describesFeature ?feature }
} ORDER BY ?stream ?feature""",
    "Which streams have a feature? It is a field": """SELECT ?stream ?feature {
  ?s a :Stream ; :hasName ?stream ; :hasAnnotation/:hasOutputAnnotation/:describesFeature $feature
} ORDER BY ?stream ?feature""",
    "How are streams and units connected, as a graph?": """CONSTRUCT {
  ?unit :hasInput ?in . ?unit :hasOutput ?out
} WHERE {
  ?unit a :ComputationalUnit
  OPTIONAL { ?unit :hasInput ?in }
  OPTIONAL { ?unit :hasOutput ?out }
}""",
}
"""Questions that the page has not: it shows them first."""
EXAMPLE = "gps|out|both"
"""The streams of the page's example."""


def questions() -> dict[str, str]:
    """The questions and their SPARQL, in the order of the page."""
    found = re.findall(
        r"^## \d+\. ([^\n]*)\n\n```sparql\n(.*?)\n```", PAGE.read_text(), re.M | re.S
    )
    return FIRST | {title.replace("`", ""): query for title, query in found}


def render() -> str:
    """The module, as the page of this checkout has it: of each question the title and the SPARQL,
    as parts of which every second one is a name of the page's example."""
    parts = [
        (re.split(rf"\b({EXAMPLE})\b", title), re.split(rf"(?<=:)({EXAMPLE})\b", query))
        for title, query in questions().items()
    ]
    head = "// Written by docs/console_questions.py from docs/how-to/ask-the-system.md."
    return f"{head}\nexport const QUESTIONS = {json.dumps(parts, indent=2, ensure_ascii=False)};\n"


if __name__ == "__main__":
    FILE.write_text(render())
