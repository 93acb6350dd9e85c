"""The alert rules and the dashboard ask for metrics and labels that the service has."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Any

import httpx
import pytest
import yaml
from places import ROOT

RULES = ROOT / "docker" / "prometheus-rules.yml"
DASHBOARD = ROOT / "docker" / "grafana-dashboard.json"
PAGE = (ROOT / "docs" / "reference" / "metrics.md").read_text()
HOW_TO = (ROOT / "docs" / "how-to" / "monitor.md").read_text()
SCRAPED = {"instance", "job"}
"""Labels that Prometheus adds."""


def rules() -> list[dict[str, Any]]:
    (group,) = yaml.safe_load(RULES.read_text())["groups"]
    return list(group["rules"])


def panels() -> list[dict[str, Any]]:
    return [panel for panel in json.loads(DASHBOARD.read_text())["panels"] if "targets" in panel]


def expressions() -> Iterator[tuple[str, str]]:
    """Each PromQL expression, after the name of its alert or panel."""
    yield from ((rule["alert"], rule["expr"]) for rule in rules())
    for panel in panels():
        yield from ((panel["title"], target["expr"]) for target in panel["targets"])


def labels_on_the_page() -> dict[str, set[str]]:
    """The labels of each metric in the tables of docs/reference/metrics.md."""
    found: dict[str, set[str]] = {}
    before: set[str] = set()
    for name, cell in re.findall(r"^\| `((?:dyknow|process)_\w+)` \| ([^|]*)\|", PAGE, re.M):
        own = set(re.findall(r"`(\w+)`", cell))
        before = before | own if "the same" in cell else own
        # `dyknow_unit_failed` adds a label to those of the row before.
        found[name] = before
    return found


@pytest.fixture
def there(http: httpx.Client) -> set[str]:
    """The names that the service exposes, with those of the samples of histograms."""
    types = re.findall(r"^# TYPE (\w+) (\w+)", http.get("/metrics").text, re.MULTILINE)
    names = {name for name, _ in types}
    histograms = (name for name, kind in types if kind == "histogram")
    return names | {f"{name}_{part}" for name in histograms for part in ("bucket", "sum", "count")}


def test_every_metric_exists(there: set[str]) -> None:
    named = [
        (where, name)
        for where, text in expressions()
        for name in re.findall(r"\b(?:dyknow|process)_\w+", text)
    ]
    assert [(where, name) for where, name in named if name not in there] == []
    assert len({name for _, name in named}) > 30


def test_every_label_is_one_of_its_metric() -> None:
    labels = labels_on_the_page()
    assert labels["dyknow_unit_failed"] == {"stream", "transformation", "unit", "reason"}
    for where, text in expressions():
        for name, selected in re.findall(r"((?:dyknow|process)_\w+)\{([^}]*)\}", text):
            chosen = set(re.findall(r"(\w+)=~?\"", selected))
            assert chosen <= labels[_family(name)] | SCRAPED, (where, name)


def test_what_is_grouped_and_shown_are_labels_of_the_expression() -> None:
    labels = labels_on_the_page()
    shown = [(rule["expr"], rule["annotations"]["summary"]) for rule in rules()]
    targets = [target for panel in panels() for target in panel["targets"]]
    shown += [(target["expr"], target["legendFormat"]) for target in targets]
    checked = 0
    for text, told in shown:
        grouped = re.findall(r"\b(?:by|ignoring) \(?([\w, ]+)\)", text)
        names = {name for group in grouped for name in group.split(", ")}
        names |= set(re.findall(r"\{\{ ?(?:\$labels\.)?(\w+) ?\}\}", told))
        metrics = map(_family, re.findall(r"\b(?:dyknow|process)_\w+", text))
        known = SCRAPED | {"le"} | {label for metric in metrics for label in labels[metric]}
        assert names <= known, (text, told)
        checked += len(names)
    assert checked > 20


def _family(name: str) -> str:
    return re.sub(r"(?<=_seconds)_(bucket|sum|count)$", "", name)


def test_every_alert_says_what_happens_and_is_on_the_page() -> None:
    names = [rule["alert"] for rule in rules()]
    assert len(names) == len(set(names)) > 10
    for rule in rules():
        assert rule["labels"]["severity"] in ("warning", "critical"), rule["alert"]
        assert rule["annotations"]["summary"], rule["alert"]
    table = HOW_TO.partition("## Alert rules")[2].partition("\n## ")[0]
    assert set(re.findall(r"`([A-Z]\w+)`", table)) == set(names)


def test_a_comparison_of_two_label_sets_ignores_what_differs() -> None:
    """`fate="late"` and `fate="accepted"` match no series otherwise, so the alert never fires."""
    (late,) = (rule["expr"] for rule in rules() if rule["alert"] == "SamplesAreLate")
    assert "> ignoring(fate) " in late


def test_the_dashboard_can_be_imported() -> None:
    dashboard = json.loads(DASHBOARD.read_text())
    every = dashboard["panels"]
    assert len({panel["id"] for panel in every}) == len(every)
    variables = {variable["name"] for variable in dashboard["templating"]["list"]}
    assert variables == {"datasource", "instance"}
    for panel in panels():
        assert panel["description"], panel["title"]
        for target in panel["targets"]:
            assert target["datasource"]["uid"] == "${datasource}", panel["title"]
            assert 'instance=~"$instance"' in target["expr"], panel["title"]
    # No two panels cover each other.
    places = [panel["gridPos"] for panel in every]
    cells = [
        (x, y)
        for place in places
        for x in range(place["x"], place["x"] + place["w"])
        for y in range(place["y"], place["y"] + place["h"])
    ]
    assert len(cells) == len(set(cells))
    assert max(x for x, _ in cells) < 24
