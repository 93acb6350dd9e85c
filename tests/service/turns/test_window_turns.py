"""Windows that are closed a little at a time, beside what others have to do."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import pytest
from asking import asking
from waiting import until

from dyknow.continuous.columns.budget import Budget, Stopped
from dyknow.engine.durability.commands import Annotate, DeclareStream, Publish
from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.engine.engine import Engine
from dyknow.engine.model.views import StreamDeclaration
from dyknow.engine.units import windowed
from dyknow.journal.durability import Durability
from dyknow.journal.errors import JournalFull
from dyknow.service.app import create_app
from dyknow.service.config.settings import Settings
from dyknow.service.server import running
from dyknow.service.turns import backlog_task
from dyknow.service.turns.window_turns import WindowTurns
from dyknow.streams.sample import Field, FieldType

NDJSON, TEXT = "application/x-ndjson", "text/plain"
SECOND = 10**9
COUNT = """REGISTER QUERY count COMPUTE EVERY 1s AS SELECT (COUNT(?v) AS ?many)
FROM STREAM <http://www.ida.liu.se/dyknow/s.trdf> [RANGE 1s STEP 1s] WHERE { ?o dyknow:speed ?v }"""


def patient() -> WindowTurns:
    return WindowTurns(5, 60)


def windows(*, steps: int, work: Callable[[], None], count: int = 1) -> Callable[[], bool]:
    """Closes ``count`` windows, each with ``steps`` of work."""
    left = [count]

    def close_next() -> bool:
        if not left[0]:
            return False
        for _ in range(steps):
            work()
        left[0] -= 1
        return True

    return close_next


def test_it_pauses_where_it_may_when_the_time_is_over() -> None:
    pausing, seen = patient(), []

    def work() -> None:
        seen.append(threading.current_thread())
        pausing.pause()

    pausing.allow(0)
    task = pausing.start(windows(steps=3, work=work))
    counts = []
    while True:
        is_done = task.run()
        counts.append(len(seen))
        if is_done:
            break
    assert counts == [1, 2, 3, 3]
    assert set(seen).isdisjoint({threading.current_thread()})
    assert len(set(seen)) == 1
    assert task.spent > 0


def test_no_window_is_begun_when_the_time_is_over() -> None:
    pausing, closed = patient(), []
    pausing.allow(0)
    close = windows(steps=1, work=lambda: closed.append(1), count=3)
    assert pausing.start(close).run()
    assert len(closed) == 1
    pausing.allow(60)
    assert pausing.start(close).run()
    assert len(closed) == 3


def test_others_have_the_turn_while_it_does_something_apart() -> None:
    pausing, ready, may = patient(), threading.Event(), threading.Event()
    pausing.on_ready = ready.set
    after = []

    def work() -> None:
        with pausing.released():
            assert may.wait(120)
        after.append(1)

    pausing.allow(0)
    task = pausing.start(windows(steps=1, work=work))
    assert not task.run()
    assert not task.is_ready
    may.set()
    assert ready.wait(120)
    # It is not its turn.
    assert task.is_ready
    assert not after
    while not task.run():
        assert task.is_ready
    assert after == [1]


def test_what_is_soon_done_apart_is_waited_for() -> None:
    pausing = patient()

    def work() -> None:
        with pausing.released():
            pass

    pausing.allow(20)
    assert pausing.start(windows(steps=100, work=work)).run()


def test_to_the_end_of_the_window_that_is_half_done() -> None:
    pausing, may, closed = patient(), threading.Event(), []

    def work() -> None:
        with pausing.released():
            may.wait(120)
        pausing.pause()
        closed.append(1)

    pausing.allow(0)
    task = pausing.start(windows(steps=1, work=work, count=5))
    assert not task.run()
    threading.Timer(0.05, may.set).start()
    assert task.run(to_end=True)
    assert closed == [1]


def test_what_is_left_is_enough_to_tell_what_windows_gave() -> None:
    pausing, closed = patient(), []
    pausing.allow(20)
    task = pausing.start(windows(steps=1, work=lambda: closed.append(1), count=1000), emitting=1.0)
    assert task.run()
    assert 10 <= len(closed) <= 20


def test_a_unit_knows_how_long_its_windows_took_to_be_told() -> None:
    class Clocked(WindowTurns):
        """Telling takes three seconds, whatever is told."""

        def start(self, close_next: Callable[[], bool], emitting: float = 0.0) -> Any:
            emittings.append(emitting)
            return super().start(close_next, emitting)

        def time(self, what: Callable[[], None]) -> float:
            super().time(what)
            return 3.0

    emittings: list[float] = []
    pausing = Clocked(5, 60)
    engine = engine_with(QUERIES[0], pausing)
    for second in (1, 2, 5, 9):
        Publish("s", "ndjson", batch(second, 2), second * SECOND).apply(engine)
        pausing.allow(1000)
        while engine.backlog:
            engine.work_backlog()
    counts = [3.0 / emitting for emitting in emittings if emitting]
    assert emittings[0] == 0.0
    assert counts
    assert counts == [round(count) for count in counts]


def test_a_window_that_takes_too_long_is_stopped() -> None:
    pausing, ends = WindowTurns(0.05, 60), []

    def close_next() -> bool:
        try:
            while True:
                pausing.pause()
        except Stopped as stopped:
            ends.append(str(stopped))
        return False

    pausing.allow(20)
    assert pausing.start(close_next).run()
    assert ends == ["it took more than 0.05 s of processor time (DYKNOW_QUERY_SECONDS)"]


def test_an_error_is_raised_where_it_is_waited_for_and_the_thread_is_used_again() -> None:
    pausing, threads = patient(), set()

    def fails() -> bool:
        threads.add(threading.get_ident())
        raise ArithmeticError("no")

    pausing.allow(20)
    for _ in range(3):
        with pytest.raises(ArithmeticError):
            pausing.start(fails).run()
    assert len(threads) == 1
    pausing.close()


def test_without_a_task_there_are_no_pauses() -> None:
    pausing = patient()
    pausing.pause()
    with pausing.released():
        pausing.pause()


QUERIES = [
    "SELECT ?a ?c WHERE { ?a dyknow:speed ?b . ?c dyknow:speed ?d FILTER (?b < ?d) }",
    "SELECT ?a (AVG(?b) AS ?m) WHERE { ?a dyknow:speed ?b } GROUP BY ?a",
    "SELECT ?a ?c WHERE { ?a (dyknow:speed|dyknow:p)* ?c }",
    "SELECT ?a ?n WHERE { ?a dyknow:speed ?b BIND (CONCAT(STR(?a), 'x') AS ?n) }",
    "SELECT ?a WHERE { { ?a dyknow:speed 1 } UNION { ?a dyknow:speed 2 } "
    "MINUS { ?a dyknow:speed 3 } }",
]
HEAD = "REGISTER QUERY q AS PREFIX dyknow: <http://www.ida.liu.se/dyknow/> "
FROM = "FROM STREAM <http://www.ida.liu.se/dyknow/s.trdf> [RANGE 3s STEP 1s] WHERE"
ROWS = [(second, number) for second in range(8) for number in range(second % 4 + 1)]


def engine_with(query: str, turns: WindowTurns | None) -> Engine:
    budget = Budget() if turns is None else Budget(pauses=turns)
    engine = Engine(epoch="e1", budget=budget, turns=turns)
    with_streams(engine)
    engine.queries.register(HEAD + query.replace("WHERE", FROM, 1))
    return engine


def with_streams(engine: Engine) -> None:
    fields = (Field("id", FieldType.STRING), Field("spd", FieldType.FLOAT))
    DeclareStream(StreamDeclaration("s", fields)).apply(engine)
    Annotate("stream s contains speed(UAV) = spd for every UAV = id").apply(engine)


def batch(second: int, count: int) -> bytes:
    rows = []
    for number in range(count):
        at = second * SECOND + number
        rows.append({"valid": at, "available": at, "id": f"u{number}", "spd": float(number)})
    return "\n".join(map(json.dumps, rows)).encode()


@pytest.mark.parametrize("query", QUERIES)
def test_pauses_change_no_result(query: str) -> None:
    pausing = patient()
    at_once, paused = engine_with(query, None), engine_with(query, pausing)
    turns = 0
    for second in range(1, 9):
        for engine in (at_once, paused):
            Publish("s", "ndjson", batch(second, second), second * SECOND).apply(engine)
        pausing.allow(0)
        for _ in range(second % 3):
            paused.work_backlog()
            turns += 1
    at_once.end("s")
    paused.end("s")
    while paused.backlog:
        pausing.allow(0)
        paused.work_backlog()
        turns += 1
    found, expected = (
        [
            (one.start, one.end, None if one.solutions is None else list(one.solutions.rows()))
            for one in engine.queries.results("q")
        ]
        for engine in (paused, at_once)
    )
    assert expected
    assert found == expected
    # It did pause within windows.
    assert turns > len(expected)
    pausing.close()


JUMP = """REGISTER QUERY jump AS PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
SELECT (COUNT(*) AS ?n) FROM STREAM <http://www.ida.liu.se/dyknow/s.trdf> [RANGE 10s STEP 1ms]
WHERE { ?o dyknow:speed ?v }"""


def line(seconds: float) -> bytes:
    at = int(seconds * SECOND)
    return json.dumps({"valid": at, "available": at, "id": "u1", "spd": 1.0}).encode() + b"\n"


def declared(http: httpx.Client, name: str) -> None:
    fields = {"id": "string", "spd": "float"}
    http.put(f"/streams/{name}", json={"fields": fields}).raise_for_status()
    ssl = f"stream {name} contains speed(UAV) = spd for every UAV = id"
    http.post("/annotations", content=ssl, headers={"Content-Type": TEXT}).raise_for_status()


def publish(http: httpx.Client, name: str, body: bytes) -> None:
    answer = http.post(f"/streams/{name}/samples", content=body, headers={"Content-Type": NDJSON})
    assert answer.status_code == 202, answer.text


def query(http: httpx.Client, name: str) -> dict[str, object]:
    found: dict[str, object] = http.get(f"/queries/{name}").raise_for_status().json()
    return found


def told(http: httpx.Client, name: str) -> int:
    """How many windows of a query that counts have said something."""
    return int(str(query(http, name)["position"]).split("-")[-1])


def served(engine: Engine | RecordedEngine) -> object:
    settings = Settings(port=0, tick=0.02, sse_ping=0, slow_request=60)
    return running(create_app(engine, settings, lambda: 10**18), settings)


def test_ten_thousand_windows_of_one_sample_hold_nobody_up() -> None:
    engine = Engine(epoch="e1", turns=patient())
    with (
        served(engine) as url,  # type: ignore[attr-defined]
        asking(url) as http,
    ):
        declared(http, "s")
        declared(http, "other")
        http.post("/queries", content=JUMP, headers={"Content-Type": TEXT}).raise_for_status()
        count = JUMP.replace("jump", "count").replace("STEP 1ms", "STEP 1s")
        count = count.replace("s.trdf", "other.trdf")
        http.post("/queries", content=count, headers={"Content-Type": TEXT}).raise_for_status()
        body = line(1) + line(100)
        sender = threading.Thread(target=publish, args=(http, "s", body))
        with asking(url) as other:
            sender.start()
            before = 0
            for second in range(1, 6):
                publish(other, "other", line(second))
                # Whoever publishes to another stream has its results at once.
                assert query(other, "count")["windows"] == second - 1
                now = told(other, "jump")
                assert before <= now <= 10_000
                before = now
            # What changes more than streams is done, too: between two windows.
            declared(other, "third")
            until(lambda: query(other, "jump")["position"] == "e1-10000")
            sender.join()
            assert query(other, "jump")["state"] == "running"


def test_a_unit_that_cannot_keep_up_is_cut_off_alone() -> None:
    engine = Engine(epoch="e1", turns=WindowTurns(5, 0.05))
    with (
        served(engine) as url,  # type: ignore[attr-defined]
        asking(url) as http,
    ):
        declared(http, "s")
        for text in (JUMP, JUMP.replace("jump", "beside").replace("STEP 1ms", "STEP 1s")):
            http.post("/queries", content=text, headers={"Content-Type": TEXT}).raise_for_status()
        publish(http, "s", line(1) + line(100) + line(101))
        until(lambda: query(http, "jump")["state"] == "failed")
        failure = str(query(http, "jump")["failure"])
        assert "Overwhelmed: its windows took 0 s, and more of them wait" in failure
        beside = query(http, "beside")
        assert (beside["state"], beside["windows"]) == ("running", 11)


def test_a_unit_that_cannot_keep_up_with_a_live_stream_is_cut_off() -> None:
    """Each batch makes one window due: what waits is mostly what was put by."""

    def work() -> None:
        for _ in range(3):
            end = time.thread_time() + 0.004
            while time.thread_time() < end:
                pass
            pausing.pause()

    pausing = WindowTurns(5, 0.3)
    engine = engine_with(QUERIES[1], pausing)
    (unit,) = engine.units()
    closed = unit.evaluator._close_window  # type: ignore[attr-defined]

    def slow(end: int, reports: bool) -> bool:
        work()
        return bool(closed(end, reports))

    unit.evaluator._close_window = slow  # type: ignore[attr-defined]
    for second in range(1, 400):
        Publish("s", "ndjson", batch(second, 1), second * SECOND).apply(engine)
        pausing.allow(0)
        engine.work_backlog()
        if unit.failure is not None:
            break
    assert unit.failure is not None
    assert unit.failure.startswith("Overwhelmed")
    assert second > 15
    assert not engine.backlog
    pausing.close()


def test_what_fails_while_the_unit_is_changed_is_told_in_its_turn() -> None:
    pausing = patient()
    engine = engine_with(QUERIES[1], pausing)
    (unit,) = engine.units()

    def fails(end: int, reports: bool) -> bool:
        pausing.pause()
        raise ArithmeticError("no")

    unit.evaluator._close_window = fails  # type: ignore[attr-defined]
    for second in range(1, 3):
        Publish("s", "ndjson", batch(second, 1), second * SECOND).apply(engine)
    pausing.allow(0)
    engine.work_backlog()
    assert engine.backlog.is_mid_window
    engine.backlog.finish_windows()
    # It is not told before it is the unit's turn.
    assert engine.backlog.is_mid_window
    assert unit.failure is None
    engine.work_backlog(begins=False)
    assert unit.failure == "ArithmeticError: no"
    assert not engine.backlog
    pausing.close()


@pytest.mark.long
def test_what_is_behind_when_the_service_stops_goes_on_at_the_next_start(tmp_path: Path) -> None:
    def opened() -> RecordedEngine:
        return RecordedEngine(tmp_path, now=0, durability=Durability.WRITE, turns=patient())

    recorded = opened()
    with (
        served(recorded) as url,  # type: ignore[attr-defined]
        asking(url) as http,
    ):
        declared(http, "s")
        text = JUMP.replace("1ms", "400us")
        http.post("/queries", content=text, headers={"Content-Type": TEXT}).raise_for_status()
        sender = threading.Thread(target=publish, args=(http, "s", line(1) + line(100)))
        sender.start()
        until(lambda: query(http, "jump")["last_window"] is not None)
        sender.join()
        assert 0 < told(http, "jump") < 25_000
    with (
        served(opened()) as url,  # type: ignore[attr-defined]
        asking(url) as http,
    ):
        assert query(http, "jump")["state"] == "running"
        # That takes seconds of a processor, of which others may have most.
        until(lambda: str(query(http, "jump")["position"]).endswith("-25000"), 600)
        assert told(http, "jump") == 25_000


@pytest.fixture
def _small_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(windowed, "_PART", 10)
    monkeypatch.setattr(backlog_task, "_PATIENCE", 0.0)
    monkeypatch.setattr(backlog_task, "FIRST", 0.0)
    monkeypatch.setattr(backlog_task, "FURTHER", 0.0001)


def published(http: httpx.Client) -> int:
    """The status of a large batch of objects that nobody has named before."""
    rows = [{"valid": i, "available": i, "id": f"uav{i}", "v": 1.0} for i in range(1, 2000)]
    body = "\n".join(map(json.dumps, rows))
    headers = {"content-type": NDJSON}
    return http.post("/streams/s/samples", content=body, headers=headers).status_code


def counting(http: httpx.Client) -> None:
    http.put("/streams/s", json={"fields": {"id": "string", "v": "float"}}).raise_for_status()
    contains = "stream s contains speed(UAV) = v for every UAV = id"
    http.post("/annotations", content=contains).raise_for_status()
    http.post("/queries", content=COUNT).raise_for_status()


@pytest.mark.usefixtures("_small_parts")
def test_who_publishes_waits_until_a_large_batch_is_taken(
    http: httpx.Client, engine: Engine
) -> None:
    """Else any number of samples would wait."""
    counting(http)
    assert published(http) == 202
    assert not any(unit.is_taking_parts for unit in engine.backlog_of("s"))


@pytest.mark.usefixtures("_small_parts")
def test_nobody_waits_for_what_is_not_taken_as_the_log_takes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorded = RecordedEngine(tmp_path, now=0, durability=Durability.WRITE, turns=patient())
    work_backlog, is_full = recorded.work_backlog, threading.Event()

    def when_there_is_room(**given: bool) -> None:
        if is_full.is_set():
            raise JournalFull("no room", "make some")
        work_backlog(**given)

    monkeypatch.setattr(recorded, "work_backlog", when_there_is_room)
    with (
        served(recorded) as url,  # type: ignore[attr-defined]
        asking(url) as http,
    ):
        counting(http)
        is_full.set()
        assert published(http) == 202
        assert recorded.engine.backlog_of("s")[0].is_taking_parts
        is_full.clear()
        until(lambda: not recorded.engine.backlog_of("s"))
