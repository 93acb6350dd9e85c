"""Long lists are made a little at a time: others are answered in between."""

from __future__ import annotations

import asyncio
import json

import httpx
import pytest
from pydantic import BaseModel

from dyknow.engine.model.errors import UnknownStream
from dyknow.service.http.encodings import json_lists
from dyknow.service.http.encodings.json_lists import listed

TEXT = {"Content-Type": "text/plain"}


class Member(BaseModel):
    number: int


def test_others_have_their_turn_in_between(monkeypatch: pytest.MonkeyPatch) -> None:
    heard: list[int] = []
    made: list[int] = []
    # A member takes a second, and a part four of them.
    monkeypatch.setattr(json_lists, "monotonic", lambda: len(made))
    monkeypatch.setattr(json_lists, "PART", 4)

    def told(number: int) -> Member:
        made.append(number)
        if number == 1:
            raise UnknownStream("it has gone meanwhile")
        return Member(number=number)

    async def other() -> None:
        while len(made) < 40:
            heard.append(len(made))
            await asyncio.sleep(0)

    async def both() -> bytes:
        answer, _ = await asyncio.gather(listed(range(40), told), other())
        return bytes(answer.body)

    numbers = [member["number"] for member in json.loads(asyncio.run(both()))]
    assert numbers == [number for number in range(40) if number != 1]
    assert heard == [4 * turn for turn in range(1, 10)]


@pytest.mark.parametrize(
    ("path", "made"),
    [
        ("/streams", ["status", "s1", "s2"]),
        ("/annotations", ["s1", "s2"]),
        ("/events", []),
        ("/subscriptions", ["s1"]),
        ("/queries", ["q2", "q1"]),
        ("/kpl", ["a", "b"]),
        ("/transformations", None),
    ],
)
def test_lists_are_whole_and_in_order(
    http: httpx.Client, monkeypatch: pytest.MonkeyPatch, path: str, made: list[str] | None
) -> None:
    monkeypatch.setattr(json_lists, "PART", 0)
    for number in (1, 2):
        said = f"stream s{number} contains speed(UAV) = v for every UAV = id"
        http.post("/annotations", content=said, headers=TEXT).raise_for_status()
    for number in (2, 1):
        text = (
            f"REGISTER QUERY q{number} AS SELECT ?o FROM STREAM "
            "<http://www.ida.liu.se/dyknow/s1.trdf> [RANGE 1s STEP 1s] WHERE { ?o ?p ?v }"
        )
        http.post("/queries", content=text, headers=TEXT).raise_for_status()
    http.post("/kpl", content="source float a\nsource float b", headers=TEXT).raise_for_status()
    http.post("/subscriptions", json={"stream": "s1"}).raise_for_status()
    answer = http.get(path)
    assert answer.headers["content-type"] == "application/json"
    found = [each.get("name") or each.get("stream") for each in answer.json()]
    if made is None:
        assert "coordinatesToSpeed" in found
        one = http.get(f"/transformations/{found[0]}").json()
        assert answer.json()[0] == one
    else:
        assert [name for name in found if name in made] == made
        assert answer.json() == [] or all(answer.json())
