"""The pure functions of the console's modules, run in the browser: layout, graph, format, http."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from chromium import Browser, Page

from dyknow.engine.engine import Engine
from dyknow.service.app import create_app
from dyknow.service.config.settings import Settings
from dyknow.service.server import running

Run = Callable[[str], Any]


@pytest.fixture(scope="module")
def run(browser: Browser) -> Iterator[Run]:
    """Runs the body of an async function with the modules at hand."""
    settings = Settings(port=0, sse_ping=0)
    with running(create_app(Engine(epoch="e1"), settings, time.time_ns), settings) as url:
        page: Page = browser.page()
        page.open(url)
        page.wait("document.querySelector('.brand') !== null")
        names = ("layout", "graph", "format", "http", "widgets")
        head = "".join(f"const {name} = await import('/console/{name}.js');" for name in names)
        yield lambda body: page.run(f"(async () => {{ {head} {body} }})()")
        page.close()


OVERLAPS = """
  const all = [...found.places.values()], h = 40;
  const overlaps = all.flatMap((a, i) => all.slice(i + 1).filter((b) =>
    a.x < b.x + b.w && b.x < a.x + a.w && Math.abs(a.y - b.y) < h));"""


@pytest.mark.parametrize(
    ("n", "edges"),
    [
        (1, "[]"),
        (6, "[[0,1],[1,2],[0,2],[3,2],[4,5]]"),
        (4, "[[0,1],[1,2],[2,0],[3,3]]"),
        (60, "Array.from({length: 59}, (_, i) => [0, i + 1])"),
        (120, "Array.from({length: 240}, (_, i) => [(i * 7) % 120, (i * 13 + 5) % 120])"),
    ],
    ids=["one", "layers", "cycle", "fan", "dense"],
)
def test_boxes_do_not_overlap_and_edges_go_right(run: Run, n: int, edges: str) -> None:
    found = run(
        f"""const nodes = Array.from({{length: {n}}}, (_, id) => ({{id, w: 100, h: 40}}));
        const edges = {edges};
        const found = layout.layout(nodes, edges);{OVERLAPS}
        const left = found.paths.filter((path) => path.some((p, i) => i && p[0] < path[i - 1][0]));
        return {{ places: all.length, overlaps: overlaps.length, left: left.length,
          outside: all.filter((each) => each.y - 20 < -1e-6 || each.y + 20 > found.height + 1e-6
            || each.x + each.w > found.width + 1e-6).length }};"""
    )
    assert found == {"places": n, "overlaps": 0, "left": 0, "outside": 0}


def test_a_thousand_streams_are_laid_out_soon(run: Run) -> None:
    took = run(
        """const nodes = Array.from({length: 1000}, (_, id) => ({id, w: 184, h: 44}));
        const edges = Array.from({length: 999}, (_, i) => [Math.floor(i / 3), i + 1]);
        layout.layout(nodes, edges);
        const begun = performance.now();
        layout.layout(nodes, edges);
        return performance.now() - begun;"""
    )
    assert took < 30_000  # 20 ms on an idle machine


UNITS = """const unit = (name, inputs, transformation = 't') =>
    ({ name, output: `o_${name}`, inputs, transformation, parameters: {} });
  const streams = (units) => [{ name: 'in' }, { name: 'status' },
    ...units.map((each) => ({ name: each.output }))];"""


def test_a_unit_is_part_of_its_stream_or_apart(run: Run) -> None:
    joined, apart = run(
        f"""{UNITS} const units = [unit('a', ['in']), unit('b', ['o_a', 'in'])];
        return [false, true].map((apart) => {{
          const found = graph.model(streams(units), units, [], {{ apart }});
          return [found.nodes.map((each) => each.id),
            found.edges.map((each) => each.join(' '))]; }});"""
    )
    assert joined == [["in", "o_a", "o_b"], ["in o_a in", "o_a o_b o_a", "in o_b in"]]
    assert len(apart[0]) == 5
    assert "unit a o_a o_a" in apart[1]


def test_many_alike_ends_are_one_stack(run: Run) -> None:
    found = run(
        f"""{UNITS} const units = Array.from({{length: 9}}, (_, i) => unit(`u${{i}}`, ['in']));
        const folded = graph.model(streams(units), units, []);
        const whole = graph.model(streams(units), units, [], {{ fold: false }});
        return [folded.nodes.map((each) => each.kind), whole.nodes.length];"""
    )
    assert found == [["stream", "stack"], 10]


def test_the_chain_of_a_node_is_all_above_and_below(run: Run) -> None:
    found = run(
        """const edges = [['a', 'b'], ['b', 'c'], ['a', 'd'], ['x', 'c'], ['c', 'a']];
        const tree = [['a', 'b'], ['b', 'c'], ['a', 'd'], ['x', 'c']];
        return [[...graph.chain('b', tree)].sort(), [...graph.reached('a', edges, 1)].sort()];"""
    )
    assert found == [["a", "b", "c"], ["b", "c", "d"]]


@pytest.mark.parametrize(
    ("call", "text"),
    [
        ("unit('km.h-1')", "km/h"),
        ("unit('m.s-2')", "m/s²"),
        ("unit('ft')", "ft"),
        ("unit('h-1')", "1/h"),
        ("unit('kg.m2')", "kg·m²"),
        ("unit('')", ""),
        ("unit('m.s-17')", "m.s-17"),
        ("unit(null)", ""),
        ("unit('no_unit')", ""),
        ("ago(null)", "–"),
        ("ago(-0.4)", "now"),
        ("ago(1.9)", "now"),
        ("ago(75)", "75 s ago"),
        ("ago(-14400)", "in 4.0 h"),
        ("words('HighSpeedEvent')", "High speed event"),
        ("words('http://www.ida.liu.se/dyknow/Low_altitude')", "Low altitude"),
        ("local('<http://x.org/a#b>')", "b"),
        ("local('dyknow:speed')", "speed"),
        ("duration(0.0123)", "12 ms"),
        ("duration(null)", "–"),
        ("duration(7300)", "2.0 h"),
        ("duration(400000)", "5 days"),
        ("rate(12345)", "12.3 k/s"),
        ("rate(9.96)", "10/s"),
        ("bytes(3 * 2 ** 30)", "3.0 GiB"),
        ("plural(1, 'row')", "1 row"),
        ("plural(1200, 'row')", "1,200 rows"),
        ("value(0.123456)", "0.123"),
        ("value(null)", "–"),
        ("shorten('http://x.org/a', {x: 'http://x.org/'})", "x:a"),
        ("shorten('http://x.org/', {x: 'http://x.org/'})", "http://x.org/"),
    ],
)
def test_formats(run: Run, call: str, text: str) -> None:
    assert run(f"return format.{call};") == text


def test_messages_of_an_event_stream(run: Run) -> None:
    found = run(
        r"""const text = 'id: e1-1\nevent: sample\ndata: {"v": 1}\n\n: ping\n\n'
          + 'id: e1-2\nevent: gap\ndata: {"from":\ndata:  2}';
        return http.messages(text);"""
    )
    assert found == [[{"event": "sample", "v": 1}, {"event": "gap", "from": 2}], "e1-2"]


def test_lines_are_aligned_with_gaps(run: Run) -> None:
    found = run(
        """return widgets.aligned([[[1, 'a'], [2, 'b'], [20, 'c']], [[2, 'x'], [3, 'y']]])
          .map((row) => Array.from(row, (each) => (each === undefined ? '-' : each)));"""
    )
    assert found == [
        [1, 2, 3, 11, 20],
        ["a", "b", None, None, "c"],
        ["-", "x", "y", "-", "-"],
    ]


def test_a_gap_holds_at_all_times_of_others_and_is_more_than_the_usual_step(run: Run) -> None:
    found = run(
        """const slow = [[0, 1], [10, 2], [20, 3]];
        const gone = [[0, 'a'], [1, 'b'], [2, 'c'], [20, 'd']];
        return widgets.aligned([slow, gone])
          .map((row) => Array.from(row, (each) => (each === undefined ? '-' : each)));"""
    )
    assert found == [
        [0, 1, 2, 10, 11, 20],
        [1, "-", "-", 2, "-", 3],
        ["a", "b", "c", None, None, "d"],
    ]
