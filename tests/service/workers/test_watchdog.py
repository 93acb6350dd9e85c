"""Processes that do not come back: stopped, reported, and nobody else waits for them."""

import threading

import pytest
from process_running import Events, content, offer, stream, unit

from dyknow.engine.processes.supervision import UnitBlocked
from dyknow.service.runtime.process_watchdog import Watchdog

SHORT = "250ms"
LONG = 60_000_000_000


@pytest.fixture
def watchdog():
    made = Watchdog()
    yield made
    made.close()


@pytest.fixture
def gate():
    """Whoever waits here blocks until the test is over."""
    made = threading.Event()
    yield made
    made.set()


def still():
    return 0


def test_results_and_errors_come_back(watchdog):
    assert watchdog.run(lambda: 5, LONG, still) == 5
    with pytest.raises(ZeroDivisionError):
        watchdog.run(lambda: 1 // 0, LONG, still)
    with pytest.raises(KeyboardInterrupt):
        watchdog.run(interrupt, LONG, still)
    assert watchdog.abandoned == 0


def interrupt():
    raise KeyboardInterrupt


def test_one_thread_does_the_work_and_without_deadline_the_caller_does(watchdog):
    threads = {watchdog.run(threading.current_thread, LONG, still) for _ in range(5)}
    assert len(threads) == 1
    assert threads.pop().daemon
    assert watchdog.run(threading.current_thread, None, still) is threading.current_thread()


def test_a_call_within_a_call_does_not_wait_for_itself(watchdog):
    assert watchdog.run(lambda: watchdog.run(lambda: 7, LONG, still), LONG, still) == 7


def test_who_blocks_is_left_behind_and_the_next_gets_a_new_thread(watchdog, gate):
    threads = []

    def block():
        threads.append(threading.current_thread())
        gate.wait()

    with pytest.raises(UnitBlocked, match="did not come back within 20ms"):
        watchdog.run(block, 20_000_000, still)
    assert watchdog.abandoned == 1
    other = watchdog.run(threading.current_thread, LONG, still)
    assert other is not threads[0]
    gate.set()
    threads[0].join(30)
    assert not threads[0].is_alive()  # it ends when it comes back at last


def test_who_makes_progress_is_not_blocked(watchdog):
    """Longer than the deadline as a whole, but each call comes back: no sleep, a counted wait."""
    calls = []
    never = threading.Event()

    def work():
        while len(calls) < 10:
            never.wait(0.05)
            calls.append(1)
        return len(calls)

    assert watchdog.run(work, 250_000_000, lambda: len(calls)) == 10


def test_a_blocked_unit_stops_and_others_go_on(watchdog, gate):
    came_back = threading.Event()

    def stuck(time, samples, state):
        if time == 3:
            gate.wait()
            came_back.set()
        return (state or 0) + 1, (state or 0) + 1

    pos, events = stream(v="integer"), Events()
    bad = unit(stuck, [pos], events=events, runner=watchdog, deadline=SHORT, on_error="skip")
    good = unit(lambda t, s, state: (t, None), [pos], runner=watchdog, deadline="60s")
    offer(pos, *[(t, t, 0) for t in range(1, 6)])
    offer(pos, (6, 6, 0))
    assert [row[0] for row in content(bad.output)] == [1, 2]  # what was made before goes out
    assert [row[0] for row in content(good.output)] == [1, 2, 3, 4, 5, 6]
    assert events.kinds == ["unit failed", "unit stopped by rule"]
    assert "UnitBlocked: it did not come back within 250ms" in bad.failure
    assert (bad.counters.errors, bad.counters.last_error_time) == (1, 3)
    assert bad.output.is_ended
    assert watchdog.abandoned == 1
    gate.set()
    assert came_back.wait(30)
    assert [row[0] for row in content(bad.output)] == [1, 2]  # what came too late went nowhere
    assert bad.counters.errors == 1
