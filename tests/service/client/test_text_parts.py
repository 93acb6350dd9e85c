"""A whole system's text can be sent back, though it declares more than one request may: the client
sends it in parts (docs/reference/http-conventions.md, "Sizes")."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import httpx
import pytest
from asking import asking

from dyknow.engine.engine import Engine
from dyknow.languages.kpl import parse_kpl
from dyknow.languages.ssl import parse_ssl
from dyknow.service.app import create_app
from dyknow.service.client.client import Client, ServiceError
from dyknow.service.client.parts import (
    kpl_parts,
    send_parts,
    specification_parts,
    ssl_parts,
)
from dyknow.service.config.settings import Settings
from dyknow.service.config.text_bounds import (
    LONGEST,
    MOST_CONTENTS,
    MOST_DECLARATIONS,
    MOST_WORDS,
    count_words,
)
from dyknow.service.server import running
from dyknow.streams.time import Clock

THINGS = 1_000
FIELDS = {"id": "string", "v": "float"}
SPEED = "stream s{} contains speed(UAV) = v for every UAV = id"
POLICY = '<cu name="every{0}" type="policy"><parameter name="policy" value="sample every {0}s"/>'
HEAD = '<specification xmlns="http://www.dyknow.eu/ontology#Specification"><insertions>'
END = "</insertions></specification>"


@contextmanager
def fresh(settings: Settings, clock: Clock) -> Iterator[Client]:
    """Another service, of which nobody knows anything."""
    app = create_app(Engine(epoch="e2"), settings, clock)
    with running(app, settings) as url, Client(url, timeout=120) as client:
        yield client


def test_a_specification_comes_back_whole(client: Client, settings: Settings, clock: Clock) -> None:
    client.put_stream("s", FIELDS)
    written = [f'{POLICY.format(i + 1)}<stream name="s"/></cu>' for i in range(THINGS - 100)]
    after = POLICY.replace("every{0}", "then{0}", 1)
    written += [f'{after.format(i + 1)}<stream name="every{i + 1}"/></cu>' for i in range(100)]
    # What is read stands behind its readers here.
    changed = client.apply_specification(HEAD + "".join(written[::-1]) + END)
    assert len(changed["started"]) == len(changed["named"]) == THINGS
    current = client.current_specification()
    with fresh(settings, clock) as other:
        other.put_stream("s", FIELDS)
        assert len(other.apply_specification(current)["started"]) == THINGS
        assert other.current_specification() == current
        again = other.apply_specification(current)
        assert (again["started"], len(again["there"])) == ([], THINGS)


def test_annotations_come_back_whole(
    client: Client, http: httpx.Client, settings: Settings, clock: Clock
) -> None:
    def ssl(http: httpx.Client) -> str:
        return http.get("/annotations", headers={"Accept": "text/plain"}).text

    text = "\n".join(SPEED.format(i) for i in range(THINGS))
    assert len(client.annotate(text)) == THINGS
    told = ssl(http)
    with (
        fresh(settings, clock) as other,
        asking(other.url) as other_http,
    ):
        before = ssl(other_http)
        assert len(parse_ssl(told)) == THINGS + len(parse_ssl(before))
        other.annotate(told)
        assert ssl(other_http) == told


def test_kpl_comes_back_whole(
    client: Client, http: httpx.Client, settings: Settings, clock: Clock
) -> None:
    def kpl(http: httpx.Client) -> str:
        return http.get("/kpl", headers={"Accept": "text/plain"}).text

    lines = ["unit s"]
    for i in range(THINGS // 2):
        lines += [f"source float v{i}", f"strmgen f{i} = v{i} # every"]
    assert len(client.declare_kpl("\n".join(lines))) == THINGS
    told = kpl(http)
    assert len(parse_kpl(told).declarations) == THINGS
    with (
        fresh(settings, clock) as other,
        asking(other.url) as other_http,
    ):
        other.declare_kpl(told)
        assert kpl(other_http) == told


def test_descriptions_go_in_parts(client: Client) -> None:
    of = [{"name": "dyknow:UAV", "id": "id"}]
    content = {"feature": "dyknow:speed", "field": "v", "of": of}
    many = [{"stream": f"s{i}", "contents": [content]} for i in range(MOST_DECLARATIONS + 1)]
    assert len(client.describe(many)) == MOST_DECLARATIONS + 1
    large = [{**each, "contents": [content] * (MOST_CONTENTS // 2)} for each in many[:3]]
    assert client.describe([]) == []
    with pytest.raises(ServiceError, match="part 1 of 2, nothing took effect"):
        client.describe(large)  # the same feature twice


def test_a_part_that_is_refused_says_what_is_done(client: Client) -> None:
    lines = [SPEED.format(i) for i in range(200)]
    lines[180] = SPEED.format(180).replace("speed", "velocity")
    with pytest.raises(ServiceError) as refused:
        client.annotate("\n".join(lines))
    error = refused.value
    assert "part 2 of 2, 1 before it took effect" in str(error)
    assert "send all of it again" in error.hint
    assert error.problem["hint"] == error.hint
    # The place is that in the whole text.
    assert (error.line, error.column) == (181, len("stream s180 contains ") + 1)
    assert "velocity" in error.excerpt
    there = {one["name"] for one in client.annotations()}
    assert "s0" in there
    assert "s179" not in there


def test_a_text_that_fits_is_sent_as_it_is() -> None:
    text = "\n".join(f"# as it is\nstream s{i} contains speed(uav1)=v" for i in range(100))
    assert ssl_parts(text) == [text]
    assert ssl_parts("stream") == ["stream"]
    assert ssl_parts("") == [""]
    assert kpl_parts("unit s\nsource float a  # a") == ["unit s\nsource float a  # a"]
    assert kpl_parts("source") == ["source"]
    whole = HEAD + f'{POLICY.format(1)}<stream name="s"/></cu>' + END
    assert specification_parts(whole) == [whole]
    assert specification_parts(b"<x/>") == [b"<x/>"]


@pytest.mark.parametrize(
    ("parts_of", "declaration", "read"),
    [
        (ssl_parts, SPEED, parse_ssl),
        (ssl_parts, "stream s{} contains speed(uav1)=v\n", parse_ssl),
        (kpl_parts, "source float a{} # " + 1000 * "x", lambda t: parse_kpl(t).declarations),
        (kpl_parts, "source float a{}", lambda t: parse_kpl(t).declarations),
    ],
)
def test_parts_are_the_text_and_have_bounds(
    parts_of: Callable[[str], list[str]], declaration: str, read: Callable[[str], tuple[Any, ...]]
) -> None:
    text = "\n".join(declaration.format(i) for i in range(THINGS))
    parts = parts_of(text)
    assert len(parts) > 2
    assert sum((read(part) for part in parts), ()) == read(text)
    for part in parts:
        assert len(read(part)) <= MOST_DECLARATIONS
        assert count_words(part) <= MOST_WORDS
        assert len(part.encode()) <= LONGEST


def test_each_part_of_kpl_says_what_integers_are() -> None:
    text = "unit s\n" + "\n".join(f"source float a{i}" for i in range(300))
    units = [parse_kpl(part).unit for part in kpl_parts(text)]
    assert [unit.text for unit in units if unit] == ["s"] * 3


def test_one_part_is_answered_as_it_is() -> None:
    error = ServiceError(400, "wrong", "all of it", hint="another", line=3)

    def refuse(part: str) -> None:
        raise error

    with pytest.raises(ServiceError) as refused:
        list(send_parts(["text"], refuse))
    assert refused.value is error


def test_the_command_line_sends_parts(dyknow: Any, client: Client, tmp_path: Any) -> None:
    client.put_stream("s", FIELDS)
    written = "".join(f'{POLICY.format(i + 1)}<stream name="s"/></cu>' for i in range(150))
    (tmp_path / "spec.xml").write_text(HEAD + written + END)
    dyknow("specification", "apply", str(tmp_path / "spec.xml"))
    assert len(client.insertions()) == 150
