"""docs/reference/ep-sparql.md: examples are evaluated, errors compared."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest
from epsparql_definition import Definition, Sample, Value
from epsparql_drawing import FEATURES, vocabulary
from epsparql_running import Result, Running
from places import ROOT

from dyknow.languages.epsparql import (
    check_epsparql,
    format_epsparql,
    is_epsparql,
    parse_epsparql,
)
from dyknow.languages.epsparql.ast import TIME_FUNCTIONS, Operator
from dyknow.languages.errors import LanguageError
from dyknow.rdf.namespaces import DYKNOW
from dyknow.reasoning.patterns.compilation.epsparql_plans import epsparql_query
from dyknow.reasoning.patterns.plans.query import PatternQuery
from dyknow.streams.time import SECOND, TIME_MAX

PAGE = (ROOT / "docs" / "reference" / "ep-sparql.md").read_text(encoding="utf-8")
TEXTS = re.findall(r"```sparql(?: example)?\n(.*?)```", PAGE, re.S)
EXAMPLES = re.findall(r"```sparql example\n(.*?)```\n\n```text samples\n(.*?)```", PAGE, re.S)
REFUSED = re.findall(r"```sparql refused\n(.*?)```\n\n```text\n(.*?)```", PAGE, re.S)
_SAMPLE = re.compile(r"(\d+)s\s+(\w+) (\w+) (\S+)")


def compiled(text: str) -> PatternQuery:
    return epsparql_query(check_epsparql(parse_epsparql(text), vocabulary()))


def samples_of(lines: str) -> Iterator[Sample]:
    """The samples of an example, in order."""
    for number, found in enumerate(_SAMPLE.finditer(lines)):
        second, owner, feature, written = found.groups()
        value: Value = FEATURES[feature], float(written) if written.isdigit() else written == "true"
        time = int(second) * SECOND
        yield Sample(number, DYKNOW + feature, DYKNOW + owner, value, time, time)


def shown(result: Result, samples: list[Sample]) -> str:
    """A result as the page shows it."""
    numbers, values, _ = result
    times = [samples[number].end // SECOND for number in numbers]
    fields = [f"{name}={_text(value)}" for name, value in values]
    return " ".join([f"    => {min(times)}s-{max(times)}s ", *fields])


def _text(value: Value | None) -> str:
    if value is None:
        return "-"
    kind, found = value
    if kind == "number":
        return f"{found:g}"
    return (
        str(found).removeprefix(DYKNOW).lower() if kind != "object" else found.removeprefix(DYKNOW)
    )


def evaluated(text: str, lines: str) -> str:
    """The samples of an example, with the results that each decides."""
    running = Running(compiled(text))
    samples = list(samples_of(lines))
    found = []
    given = [line for line in lines.splitlines() if _SAMPLE.match(line)]
    for line, sample in zip(given, samples, strict=True):
        found += [line, *(shown(each, samples) for each in running.push([sample]))]
    last = running.advance(TIME_MAX)
    if last:
        found += ["end", *(shown(each, samples) for each in last)]
    return "\n".join(found) + "\n"


@pytest.mark.parametrize(("text", "lines"), EXAMPLES)
def test_examples_give_what_the_page_shows(text: str, lines: str) -> None:
    assert evaluated(text, lines) == lines
    results = sum("=>" in line for line in lines.splitlines())
    samples = list(samples_of(lines))
    assert results == len(Definition(parse_epsparql(text), samples, {}).solutions())
    assert results


@pytest.mark.parametrize("text", TEXTS)
def test_texts_are_right(text: str) -> None:
    query = parse_epsparql(text)
    assert is_epsparql(text)
    assert parse_epsparql(format_epsparql(query)) == query
    check_epsparql(query, vocabulary())


@pytest.mark.parametrize(("text", "error"), REFUSED)
def test_errors(text: str, error: str) -> None:
    with pytest.raises(LanguageError) as refused:
        compiled(text)
    assert refused.value.render().strip() == error.strip()


def test_the_page_shows_each_operator_and_function() -> None:
    shown_texts = "\n".join(text for text, _ in EXAMPLES)
    for operator in Operator:
        assert re.search(rf"\b{operator}\b", shown_texts), operator
    assert all(name in PAGE for name in TIME_FUNCTIONS)
    assert len(EXAMPLES) >= 9
    assert len(REFUSED) >= 5
