"""What people are told of a template: its window in words."""

import pytest

from dyknow.engine.planning import explanations
from dyknow.languages.csparql import parse_template


@pytest.mark.parametrize(
    ("window", "words"),
    [
        ("[RANGE 5s STEP 1s]", "the last 5s, every 1s"),
        ("[TRIPLES 10 STEP 2]", "the last 10 triples, every 2"),
        ("[TRIPLES 1]", "the last triple, every triple"),
        ("[LANDMARK STEP 1s]", "all since the beginning, every 1s"),
        (
            '[LANDMARK "2021-10-07T19:12:53Z"^^xsd:dateTime STEP 1s]',
            "all since 2021-10-07T19:12:53Z, every 1s",
        ),
    ],
)
def test_windows_in_words(window: str, words: str) -> None:
    text = f"REGISTER TEMPLATE dyknow:E(?o) AS SELECT ?o WHERE {{ ?o ?p ?v }} WINDOW {window}"
    assert f"window: {words}\n" in explanations.explain_template(parse_template(text))
