"""Workers: what they may not, how they end, and that their copies of the ontology follow."""

from __future__ import annotations

import os
import signal
import socket
import threading
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import anyio
import httpx
import pytest
from asking import asking
from pyoxigraph import BlankNode, Literal, NamedNode, Quad, Triple
from waiting import until

from dyknow.continuous.columns.budget import BudgetExceeded
from dyknow.continuous.columns.oxigraph_port import DIRECT, NO_QUADS, StoredQuads
from dyknow.continuous.columns.oxigraph_port import Table as Solutions
from dyknow.engine.engine import Engine
from dyknow.ontology.ontology import Ontology
from dyknow.ontology.replicas import MOST
from dyknow.service.app import create_app
from dyknow.service.config.settings import Settings
from dyknow.service.http.encodings.sparql_formats import GRAPHS
from dyknow.service.server import running
from dyknow.service.workers.messages import (
    Ask,
    BadAnswer,
    Failed,
    Follow,
    Job,
    Query,
    Table,
    Truth,
    Written,
    cell_of,
    decode_answer,
    encode,
    term_of,
)
from dyknow.service.workers.oxigraph_client import MOST_CACHED
from dyknow.service.workers.pool import Busy, Pool
from dyknow.service.workers.services import Windows
from dyknow.service.workers.sparql import IsolatedQueries, NotUpToDate
from dyknow.service.workers.worker import (
    Died,
    End,
    TookTooLong,
    Worker,
    WorkerError,
)

MEMORY = 64 << 20
ENDLESS = "ASK { " + " ".join(f"VALUES ?v{i} {{ 1 2 3 4 5 6 7 8 9 0 }}" for i in range(12))
ENDLESS += " FILTER(?v0 + ?v5 + ?v11 < 0) }"
HUNGRY = "ASK { BIND('aaaaaaaa' AS ?c0) "
HUNGRY += " ".join(f"BIND(CONCAT(?c{i}, ?c{i}, ?c{i}) AS ?c{i + 1})" for i in range(30))
HUNGRY += " FILTER(STRLEN(?c30) > 0) }"


def job(text: str, seconds: float = 20) -> Job:
    return Job(Query(text, "application/json", 1000, 1 << 20), seconds)


@pytest.fixture
def worker() -> Any:
    made = Worker.start(MEMORY)
    yield made
    made.close()


def test_what_a_worker_may_not(worker: Worker) -> None:
    limits = Path(f"/proc/{worker.pid}/limits").read_text()
    found = {line[:26].strip(): line[26:].split()[:2] for line in limits.splitlines()[1:]}
    assert found["Max open files"] == ["3", "3"]
    assert found["Max core file size"] == ["0", "0"]
    soft, hard = found["Max address space"]
    assert soft == hard
    assert int(soft) < 1 << 30
    environment = Path(f"/proc/{worker.pid}/environ").read_bytes().split(b"\0")
    names = {entry.partition(b"=")[0].decode() for entry in environment if entry}
    assert names <= {
        "PYTHONPATH",
        "PYTHONHASHSEED",
        "PYTHONDONTWRITEBYTECODE",
        "LC_ALL",
        "OPENBLAS_NUM_THREADS",
    }
    # Without memory the kernel ends a worker, and not the service.
    assert Path(f"/proc/{worker.pid}/oom_score_adj").read_text() == "1000\n"
    assert worker.call(job("ASK {}"), 1000)
    usage = Path(f"/proc/{worker.pid}/limits").read_text()
    assert "Max cpu time              unlimited" not in usage


def test_a_job_that_takes_too_long_ends_the_worker(worker: Worker) -> None:
    with pytest.raises(TookTooLong):
        worker.call(job(ENDLESS, 0.3), 1000)
    assert not worker.is_alive


def test_a_job_that_needs_too_much_memory_ends_the_worker(worker: Worker) -> None:
    with pytest.raises(Died, match="memory"):
        worker.call(job(HUNGRY), 1000)
    assert not worker.is_alive


def test_a_worker_that_is_ended_from_outside(worker: Worker) -> None:
    os.kill(worker.pid, signal.SIGKILL)
    with pytest.raises(Died, match="SIGKILL"):
        worker.call(job("ASK {}"), 1000)


def test_random_numbers_of_workers_differ() -> None:
    workers = [Worker.start(MEMORY) for _ in range(3)]
    try:
        for text in (
            "SELECT (RAND() AS ?x) {}",
            "SELECT (STRUUID() AS ?x) {}",
            "SELECT (BNODE() AS ?x) {}",
        ):
            query = Job(Query(text, "text/csv", 10, 1 << 20), 20)
            found = [worker.call(query, 1 << 20) for worker in workers for _ in range(2)]
            assert all(isinstance(each, Written) for each in found)
            assert len(set(map(str, found))) == len(found)
    finally:
        for worker in workers:
            worker.close()


def test_an_answer_that_is_larger_than_it_may_be(worker: Worker) -> None:
    with pytest.raises(Died, match="its answer has"):
        worker.call(job("SELECT ?x { VALUES ?x { 'aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa' } }"), 20)


@pytest.mark.parametrize(
    "said",
    [
        b"",
        b"\x80\x04\x95",
        encode({"type": "nothing"}),
        encode({"type": "table", "variables": ["a"], "rows": [[[0, "x"]]]}),
        b"\x91" * 100_000,
    ],
)
def test_nonsense_of_a_worker_is_no_answer(said: bytes) -> None:
    with pytest.raises(BadAnswer):
        decode_answer(said)


def test_terms_of_a_worker_are_checked() -> None:
    for term in (NamedNode("urn:a"), BlankNode("b"), Literal("x", language="en"), Literal(1.5)):
        assert term_of(cell_of(term)) == term
    for cell in ((0, "no iri >", ""), (3, "x", "no language >"), (9, "x", ""), (2, "x", "no iri")):
        with pytest.raises(BadAnswer):
            term_of(cell)


def test_so_many_may_wait_and_no_more() -> None:
    release = threading.Event()
    begun: list[int] = []

    def wait(worker: Worker) -> Any:
        begun.append(worker.pid)
        release.wait(120)
        return worker.call(job("ASK {}"), 1000)

    async def scenario() -> None:
        pool = Pool(1, MEMORY, waiting=1)
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(pool.run, wait, 20)
            while pool.busy == 0:
                await anyio.sleep(0.01)
            tasks.start_soon(pool.run, wait, 20)
            while pool.waiting == 0:
                await anyio.sleep(0.01)
            with pytest.raises(Busy):
                await pool.run(wait, 20)
            release.set()
        # Nobody waits longer than it likes, either.
        release.clear()
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(pool.run, wait, 20)
            while pool.busy == 0:
                await anyio.sleep(0.01)
            with pytest.raises(Busy):
                await pool.run(wait, 0.05)
            release.set()
        pool.close()

    anyio.run(scenario)
    assert len(begun) == 3
    assert len(set(begun)) == 1


def test_senders_take_turns() -> None:
    begun: list[str] = []
    releases: dict[str, threading.Event] = defaultdict(threading.Event)

    async def ask(pool: Pool, name: str) -> None:
        def work(worker: Worker) -> Any:
            begun.append(name)
            releases[name].wait(120)
            return worker.call(job("ASK {}"), 1000)

        await pool.run(work, 60, name[0])

    async def scenario() -> None:
        pool = Pool(2, MEMORY, waiting=8)
        async with anyio.create_task_group() as tasks:

            async def told(*names: str) -> None:
                while begun != [*names]:
                    await anyio.sleep(0.01)

            for number, name in enumerate(("a1", "a2", "a3")):
                tasks.start_soon(ask, pool, name)
                while len(begun) + pool.waiting <= number:
                    await anyio.sleep(0.01)
            # One has not all workers: another need not wait for it.
            await told("a1")
            tasks.start_soon(ask, pool, "b1")
            await told("a1", "b1")
            for name in ("b2", "c1"):
                tasks.start_soon(ask, pool, name)
                await anyio.sleep(0.05)
            assert pool.waiting == 4
            releases["a1"].set()
            await told("a1", "b1", "a2")
            releases["b1"].set()
            await told("a1", "b1", "a2", "b2")
            # a3 came before c1, whose sender has not had its turn.
            releases["a2"].set()
            await told("a1", "b1", "a2", "b2", "c1")
            for each in ("b2", "c1", "a3"):
                releases[each].set()
        pool.close()

    anyio.run(scenario)


def test_who_is_cancelled_while_waiting_leaves_its_place() -> None:
    async def scenario() -> None:
        pool = Pool(1, MEMORY, waiting=1)
        try:
            begin = threading.Event()
            async with anyio.create_task_group() as tasks:

                def work(worker: Worker) -> Any:
                    begin.wait(120)
                    return worker.call(job("ASK {}"), 1000)

                tasks.start_soon(pool.run, work, 60, "a")
                while pool.busy == 0:
                    await anyio.sleep(0.01)
                with anyio.move_on_after(0.05):
                    await pool.run(work, 60, "b")
                assert pool.waiting == 0
                begin.set()
            await pool.run(lambda worker: worker.call(job("ASK {}"), 1000), 20, "b")
        finally:
            pool.close()

    anyio.run(scenario)


def test_who_is_cancelled_frees_the_worker() -> None:
    async def scenario() -> tuple[int, float]:
        pool = Pool(1, MEMORY)
        try:
            begin = time.monotonic()
            with anyio.move_on_after(1.0):
                await pool.run(lambda worker: worker.call(job(ENDLESS, 600), 1000), 5)
            answer = await pool.run(lambda worker: worker.call(job("ASK {}"), 1000), 20)
            assert answer is not None
            return pool.ended, time.monotonic() - begin
        finally:
            pool.close()

    ended, seconds = anyio.run(scenario)
    assert ended == 1
    assert seconds < 300


def test_a_closed_pool_gives_no_worker() -> None:
    pool = Pool(1, MEMORY)
    pool.warm()
    pool.close()
    with pytest.raises(WorkerError, match="stops"):
        pool.acquire()


# -- the copy of the ontology --------------------------------------------------------------


def test_copies_follow_every_change() -> None:
    ontology = Ontology.open()
    first = ontology.changes_since(None)
    assert first.dump is not None
    assert ontology.changes_since(first.position).added == b""
    triple = Triple(NamedNode("urn:a"), NamedNode("urn:p"), Literal('x"\n'))
    ontology.mirror([triple], [])
    second = ontology.changes_since(first.position)
    assert second.dump is None
    assert b"urn:a" in second.added
    ontology.mirror([], [triple])
    third = ontology.changes_since(second.position)
    assert b"urn:a" in third.removed
    # On balance nothing has happened since the first.
    assert b"urn:a" not in ontology.changes_since(first.position).added
    many = [Triple(NamedNode(f"urn:a{i}"), NamedNode("urn:p"), Literal(i)) for i in range(MOST)]
    ontology.mirror(many, [])
    assert ontology.changes_since(first.position).dump is not None


def test_a_worker_whose_copy_changes_for_long_needs_no_more_memory(worker: Worker) -> None:
    before: bytes = b""
    for number in range(1500):
        quads = "".join(f"<urn:s{number}> <urn:p> <urn:o{number}_{i}> .\n" for i in range(150))
        assert worker.call(Job(Follow(None, quads.encode(), before), 20), 1000) == Truth(True)
        before = quads.encode()
    found = worker.call(job("SELECT (COUNT(*) AS ?n) { ?s ?p ?o }"), 1 << 20)
    assert isinstance(found, Written)
    assert b'"150"' in found.body


def test_what_no_worker_can_take_is_not_the_fault_of_a_query() -> None:
    ontology = Ontology.open()
    text = "x" * 1000
    many = [
        Triple(NamedNode(f"urn:a{i}"), NamedNode("urn:p"), Literal(f"{text}{i}"))
        for i in range(MOST + 40_000)
    ]

    async def scenario(queries: Any) -> None:
        assert isinstance(await queries.answer("ASK {}", "application/json"), Written)
        ontology.mirror(many, [])
        with pytest.raises(NotUpToDate, match="the ontology exceeds the memory or the time"):
            await queries.answer("ASK {}", "application/json")
        ontology.mirror([], many)
        assert isinstance(await queries.answer("ASK {}", "application/json"), Written)

    with queries_of(ontology) as (_, queries):
        anyio.run(scenario, queries)


@pytest.mark.parametrize("trouble", [Died("no memory", End.MEMORY), Failed("no memory")])
def test_who_could_not_be_told_what_has_changed_is_replaced(
    monkeypatch: pytest.MonkeyPatch, trouble: WorkerError | Failed
) -> None:
    ontology = Ontology.open()
    asked = "ASK { <urn:a> <urn:p> 1 }"
    call = Worker.call
    troubles = [trouble]

    def troubled(worker: Worker, job: Job, most: int) -> Any:
        if isinstance(job.work, Follow) and job.work.dump is None and troubles:
            found = troubles.pop()
            if isinstance(found, WorkerError):
                worker.kill(found.end)
                raise found
            return found
        return call(worker, job, most)

    async def scenario(queries: Any) -> None:
        assert b"false" in (await queries.answer(asked, "application/json")).body
        ontology.mirror([Triple(NamedNode("urn:a"), NamedNode("urn:p"), Literal(1))], [])
        assert b"true" in (await queries.answer(asked, "application/json")).body

    monkeypatch.setattr(Worker, "call", troubled)
    with queries_of(ontology) as (pool, queries):
        anyio.run(scenario, queries)
        assert not troubles
        assert pool.ends[End.MEMORY] == 1


def test_when_no_worker_has_memory_left_a_new_one_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """The next one that is free may be as worn as the first one."""
    ontology = Ontology.open()
    call = Worker.call

    def worn(worker: Worker, job: Job, most: int) -> Any:
        if isinstance(job.work, Follow) and job.work.dump is None:
            worker.kill(End.MEMORY)
            raise Died("no memory", End.MEMORY)
        return call(worker, job, most)

    monkeypatch.setattr(Worker, "call", worn)
    with queries_of(ontology, 2) as (pool, queries):
        workers = [pool.acquire(), pool.acquire()]
        for worker in workers:
            queries._update(worker)
            pool.release(worker)
        ontology.mirror([Triple(NamedNode("urn:a"), NamedNode("urn:p"), Literal(1))], [])
        found = anyio.run(queries.answer, "ASK { <urn:a> <urn:p> 1 }", "application/json")
        assert isinstance(found, Written)
        assert b"true" in found.body
        assert pool.ends[End.MEMORY] == 2


@contextmanager
def queries_of(ontology: Ontology, count: int = 1) -> Iterator[tuple[Pool, Any]]:
    pool = Pool(count, MEMORY)
    try:
        yield pool, IsolatedQueries(ontology, pool, 20, 1000, 1 << 20)
    finally:
        pool.close()


@pytest.fixture
def settings() -> Settings:
    return Settings(
        port=0, tick=0.02, sparql_workers=1, sparql_waiting=0, sparql_deadline=0.5, sparql_rows=50
    )


def ask(http: httpx.Client, query: str) -> httpx.Response:
    return http.get("/sparql", params={"query": query})


def answered(http: httpx.Client, query: str, accept: str) -> httpx.Response:
    """The answer to a query; where a machine is too slow for the deadline, to one asked again."""

    def answer() -> httpx.Response | None:
        found = http.get("/sparql", params={"query": query}, headers={"Accept": accept})
        return None if found.status_code == 503 else found

    found = until(answer)
    assert found is not None
    return found


def test_answers_are_those_of_now(http: httpx.Client) -> None:
    asked = "PREFIX s: <http://www.dyknow.eu/ontology#> SELECT ?n { ?x a s:Stream ; s:hasName ?n }"
    for number in range(5):
        http.put(f"/streams/s{number}", json={"fields": {"id": "string"}}).raise_for_status()
        found = ask(http, asked).json()["results"]["bindings"]
        assert {row["n"]["value"] for row in found} == {
            "status",
            *(f"s{i}" for i in range(number + 1)),
        }
    http.delete("/streams/s0").raise_for_status()
    for _ in range(2):
        found = ask(http, asked).json()["results"]["bindings"]
        assert {row["n"]["value"] for row in found} == {"status", "s1", "s2", "s3", "s4"}
        # A worker that was ended is replaced by one that knows as much.
        assert ask(http, ENDLESS).status_code == 503


@pytest.mark.parametrize(
    "accept",
    [
        "application/json",
        "application/sparql-results+xml",
        "text/csv",
        "text/tab-separated-values",
    ],
)
def test_a_result_of_too_many_rows(http: httpx.Client, accept: str) -> None:
    def rows(number: int) -> httpx.Response:
        values = " ".join(f'"{i}\\n\\"<result>,"' for i in range(number))
        query = f"SELECT ?x {{ VALUES ?x {{ {values} }} }}"
        return answered(http, query, accept)

    assert rows(50).status_code == 200
    refused = rows(51)
    assert refused.status_code == 422
    assert "50 rows" in refused.json()["detail"]
    assert "LIMIT" in refused.json()["hint"]


@pytest.mark.parametrize("accept", GRAPHS)
def test_a_graph_of_too_many_triples(http: httpx.Client, accept: str) -> None:
    def triples(number: int) -> httpx.Response:
        values = " ".join(map(str, range(number)))
        query = f"CONSTRUCT {{ <urn:s> <urn:p> ?x }} {{ VALUES ?x {{ {values} }} }}"
        return answered(http, query, accept)

    assert triples(50).status_code == 200
    refused = triples(51)
    assert refused.status_code == 422
    assert "50 triples" in refused.json()["detail"]


def test_escapes_count_as_bytes_of_a_graph(engine: Engine) -> None:
    settings = Settings(port=0, sparql_workers=1, sparql_bytes=3000)
    returns = "\\r" * 1000
    query = f'CONSTRUCT {{ <urn:s> <urn:p> "{returns}" }} {{}}'
    with (
        running(create_app(engine, settings, lambda: 10**18), settings) as url,
        asking(url) as http,
    ):
        for accept, status in (("text/turtle", 200), ("application/rdf+xml", 422)):
            asked = {"params": {"query": query}, "headers": {"Accept": accept}}
            assert http.get("/sparql", **asked).status_code == status


@pytest.mark.parametrize("graphs", [{}, {"default-graph-uri": "http://www.dyknow.eu/ontology"}])
def test_a_slow_query_says_so(http: httpx.Client, graphs: dict[str, str]) -> None:
    answer = http.get("/sparql", params={"query": ENDLESS, **graphs})
    assert answer.status_code == 503
    assert answer.headers["retry-after"]
    assert answer.json()["title"] == "query too slow"


def test_a_client_that_goes_frees_its_worker(engine: Engine) -> None:
    settings = Settings(port=0, sparql_workers=1, sparql_waiting=0, sparql_deadline=60)
    app = create_app(engine, settings, lambda: 10**18)
    with running(app, settings) as url, asking(url) as http:
        assert ask(http, "ASK {}").status_code == 200
        host, port = url.removeprefix("http://").split(":")
        with socket.create_connection((host, int(port))) as gone:
            query = httpx.QueryParams({"query": ENDLESS})
            gone.sendall(f"GET /sparql?{query} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
            until(lambda: app.state.service.isolation.pools["sparql"].busy == 1)
            refused = ask(http, "ASK {}")
            assert refused.status_code == 503
            assert refused.json()["title"] == "too many queries"
        until(lambda: app.state.service.isolation.pools["sparql"].busy == 0)
        assert ask(http, "ASK {}").status_code == 200


def test_heavy_queries_of_one_address_do_not_hold_up_another(engine: Engine) -> None:
    settings = Settings(port=0, sparql_workers=2, sparql_deadline=120)
    app = create_app(engine, settings, lambda: 10**18)
    with running(app, settings) as url, ExitStack() as senders:
        host, port = url.removeprefix("http://").split(":")
        query = httpx.QueryParams({"query": ENDLESS})
        pool = app.state.service.isolation.pools["sparql"]
        for _ in range(4):
            heavy = senders.enter_context(socket.create_connection((host, int(port))))
            heavy.sendall(f"GET /sparql?{query} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
        until(lambda: (pool.busy, pool.waiting) == (1, 3))
        other = httpx.HTTPTransport(local_address="127.0.0.2")
        with httpx.Client(base_url=url, timeout=60, transport=other) as http:
            assert ask(http, "ASK {}").status_code == 200
        assert (pool.busy, pool.waiting) == (1, 3)


# -- Oxigraph for continuous queries ---------------------------------------------------------


@pytest.fixture
def windows() -> Any:
    made = Windows(Settings(query_results=100, query_deadline=0.5))
    yield made
    made.close()


def quads(number: int) -> list[Quad]:
    return [
        Quad(
            BlankNode(f"b{i}"),
            NamedNode("urn:p"),
            Literal(f'"{i}\n', language="en"),
            NamedNode("urn:g"),
        )
        for i in range(number)
    ]


@pytest.mark.parametrize(
    "text",
    [
        "SELECT * { GRAPH ?g { ?s ?p ?o } } ORDER BY ?s ?o",
        "SELECT ?s ?none { GRAPH ?g { ?s ?p ?o } } ORDER BY ?s",
        "CONSTRUCT { ?s ?p ?o } { GRAPH ?g { ?s ?p ?o } }",
        "ASK { GRAPH ?g { ?s ?p ?o } }",
        "ASK { ?s ?p ?o }",
    ],
)
def test_a_worker_answers_what_oxigraph_answers(windows: Windows, text: str) -> None:
    asking = windows.budget.oxigraph
    for kept, content in (
        (NO_QUADS, quads(3)),
        (StoredQuads(quads(5)), []),
        (StoredQuads(quads(2)), quads(4)),
    ):
        for _ in range(2):
            mine, theirs = DIRECT.ask(text, kept, content), asking.ask(text, kept, content)
            if isinstance(mine, list):
                assert isinstance(theirs, list)
                assert set(mine) == set(theirs)
            else:
                assert theirs == mine


def test_quads_that_a_worker_could_not_keep_are_sent_again(
    windows: Windows, monkeypatch: pytest.MonkeyPatch
) -> None:
    asking, kept = windows.budget.oxigraph, StoredQuads(quads(5))
    text = "SELECT * { GRAPH ?g { ?s ?p ?o } }"
    with monkeypatch.context() as patched:
        patched.setattr(Worker, "call", lambda *_: Failed("it needs more memory than it may have"))
        with pytest.raises(ValueError, match="more memory"):
            asking.ask(text, kept, [])
    found = asking.ask(text, kept, [])
    assert isinstance(found, Solutions)
    assert len(found.rows) == 5


def test_quads_of_which_it_may_have_some_are_forgotten(
    windows: Windows, monkeypatch: pytest.MonkeyPatch
) -> None:
    """When nobody has asked about them for long, as others are."""
    asking, told = windows.budget.oxigraph, list[str]()
    call = Worker.call

    def noted(worker: Worker, job: Job, most: int) -> Any:
        assert isinstance(job.work, Ask)
        told.extend(job.work.forget)
        return call(worker, job, most)

    monkeypatch.setattr(Worker, "call", noted)
    failed = [StoredQuads(quads(3)) for _ in range(5)]
    for kept in failed:
        with pytest.raises(ValueError, match="expected"):
            asking.ask("ASK { 1 }", kept, [])
    for kept in [StoredQuads(quads(1)) for _ in range(MOST_CACHED)]:
        asking.ask("ASK {}", kept, [])
    assert told == [str(kept.number) for kept in failed]


def test_more_sets_of_quads_than_a_worker_keeps(windows: Windows) -> None:
    sets = [StoredQuads(quads(i + 1)) for i in range(40)]
    for _ in range(2):
        for number, kept in enumerate(sets):
            found = windows.budget.oxigraph.ask("SELECT * { GRAPH ?g { ?s ?p ?o } }", kept, ())
            assert len(found.rows) == number + 1  # type: ignore[union-attr]


@pytest.mark.parametrize("text", [ENDLESS, HUNGRY])
def test_what_oxigraph_cannot_answer_in_time_or_space(windows: Windows, text: str) -> None:
    asking = windows.budget.oxigraph
    with pytest.raises(BudgetExceeded, match="stopped"):
        asking.ask(text, NO_QUADS, ())
    with pytest.raises(BudgetExceeded, match="100 rows"):
        asking.ask("SELECT * { GRAPH ?g { ?s ?p ?o } }", NO_QUADS, quads(101))
    assert asking.ask("ASK {}", NO_QUADS, ()) is True


def test_the_kinds_of_answers() -> None:
    assert decode_answer(encode(Truth(True))) == Truth(True)
    table = Table(["a"], [[(0, "urn:a", "")], [None]])
    assert decode_answer(encode(table)) == table
