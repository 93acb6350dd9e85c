"""The same windows by Flink SQL: samples a second of processor time on both sides, and the ratio.

    python bench/queries/flink_sql.py FLINK_PYTHON RECORDING

``FLINK_PYTHON`` is an interpreter of another environment, with ``pip install apache-flink`` and
Java; ``RECORDING`` a table of ADS-B reports like examples/adsb.csv.gz, whose columns ``timestamp``
(ms), ``icao24`` and ``groundspeed`` (kt) are used. Average speeds by aircraft over [RANGE 5s STEP
1s] above a limit: one query; 100 with limits of their own; 100 for one aircraft each. Flink has one
task slot, a warm compiler and one job for all queries, and drops the results; here they are kept in
the streams of the events. Start and decoding do not count: a job that reads the same file and finds
nothing is subtracted. Processor time is of all threads, Flink's compiler and collector included.
Events are counted in a run by itself: the counts must be equal.
"""

from __future__ import annotations

import argparse
import csv
import gzip
import json
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from dyknow.converters.recordings.recording import open_recording
from dyknow.engine.engine import Engine
from dyknow.engine.model.views import StreamDeclaration

ROOT = Path(__file__).parents[2]
KMH_OF_KNOT = 1.852
REPEATS = 3
QUERIES = 100


@dataclass(frozen=True)
class Query:
    """Aircraft, or one of them, whose average speed is above a limit (km/h)."""

    limit: float
    aircraft: str | None = None

    @property
    def request(self) -> str:
        who = f"dyknow:{self.aircraft}" if self.aircraft else "?o"
        return f"dyknow:HighSpeedEvent({who}, dyknow:Aircraft, {self.limit})"

    @property
    def sql(self) -> str:
        who = f"WHERE icao24 = '{self.aircraft}'" if self.aircraft else ""
        return (
            "SELECT icao24, window_end, AVG(groundspeed) AS speed FROM TABLE("
            "HOP(TABLE reports, DESCRIPTOR(t), INTERVAL '1' SECOND, INTERVAL '5' SECOND)) "
            f"{who} GROUP BY icao24, window_start, window_end "
            f"HAVING AVG(groundspeed) * {KMH_OF_KNOT} > {self.limit}"
        )


# A window of DyKnow is (end - 5 s, end], one of Flink [start, start + 5 s): a millisecond earlier,
# its samples are the same. Samples are in order; those of one instant may still come.
FLINK = """
import json, os, sys
from pathlib import Path
from pyflink.table import EnvironmentSettings, TableEnvironment

task = json.loads(sys.stdin.read())
table = TableEnvironment.create(EnvironmentSettings.in_streaming_mode())
for name, value in (
    ("parallelism.default", "1"),
    ("taskmanager.numberOfTaskSlots", "1"),
    ("taskmanager.memory.managed.size", "2 gb"),
    ("table.local-time-zone", "UTC"),
):
    table.get_config().set(name, value)

def made(path):
    table.execute_sql("DROP TABLE IF EXISTS reports")
    table.execute_sql(
        "CREATE TABLE reports (`timestamp` BIGINT, icao24 STRING, groundspeed DOUBLE, "
        "t AS TO_TIMESTAMP_LTZ(`timestamp` - 1, 3), "
        "WATERMARK FOR t AS t - INTERVAL '0.001' SECOND) "
        f"WITH ('connector' = 'filesystem', 'path' = 'file://{path}', 'format' = 'csv', "
        "'csv.ignore-parse-errors' = 'false', 'csv.null-literal' = '')"
    )

def seconds():
    # Of all threads of the virtual machines that run below this process.
    parents = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                text = (entry / "stat").read_text().rpartition(") ")[2].split()
            except OSError:  # it has ended meanwhile
                continue
            parents[int(entry.name)] = int(text[1]), int(text[11]) + int(text[12])
    def below(pid):
        while pid in parents:
            if pid == os.getpid():
                return True
            pid = parents[pid][0]
        return False
    ticks = sum(used for pid, (_, used) in parents.items() if below(pid))
    return ticks / os.sysconf("SC_CLK_TCK")

def run(path, texts):
    made(path)
    queries = table.create_statement_set()
    for text in texts:
        queries.add_insert_sql("INSERT INTO dropped " + text)
    begin = seconds()
    queries.execute().wait()
    return seconds() - begin

table.execute_sql(
    "CREATE TABLE dropped (icao24 STRING, window_end TIMESTAMP(3), speed DOUBLE) "
    "WITH ('connector' = 'blackhole')"
)
nothing = ["SELECT icao24, CAST(t AS TIMESTAMP(3)), groundspeed FROM reports WHERE groundspeed < 0"]
path = task["path"]
run(path, task["queries"])
run(path, nothing)
found = {"seconds": run(path, task["queries"]), "none": run(path, nothing)}
if task["count"]:
    made(path)
    query = task["queries"][0]
    last = f"TO_TIMESTAMP_LTZ({task['last']}, 3)"
    counted = f"SELECT COUNT(*) FROM ({query}) WHERE window_end <= {last}"
    for row in table.execute_sql(counted).collect():
        found["events"] = row[0]
print(json.dumps(found))
"""


class Table:
    """A recording as text, several times over, without what no query needs."""

    def __init__(self, recording: Path, repeats: int, path: Path) -> None:
        with gzip.open(recording, "rt", encoding="utf-8") as file:
            rows = [
                (int(row["timestamp"]), row["icao24"], row["groundspeed"])
                for row in csv.DictReader(file)
            ]
        rows.sort(key=lambda row: row[0])
        period = rows[-1][0] - rows[0][0] + 10_000
        self.path = path
        self.last = rows[-1][0] + (repeats - 1) * period
        self.samples = len(rows) * repeats
        self.aircraft = [name for name, _ in Counter(row[1] for row in rows).most_common(QUERIES)]
        lines = "".join(
            f"{time + i * period},{who},{knots}\n"
            for i in range(repeats)
            for time, who, knots in rows
        )
        self.rows = path.with_suffix(".rows")
        """For Flink, which would take a line of names for a sample."""
        self.rows.write_text(lines, encoding="utf-8")
        path.write_text("timestamp,icao24,groundspeed\n" + lines, encoding="utf-8")


def by_flink(python: str, table: Table, queries: list[Query], count: bool) -> tuple[float, int]:
    """Seconds of processor time, and the events of the first query."""
    task = {
        "queries": [query.sql for query in queries],
        "path": str(table.rows),
        "last": table.last,
        "count": count,
    }
    done = subprocess.run(
        [python, "-c", FLINK], input=json.dumps(task), capture_output=True, text=True, check=False
    )
    if done.returncode:
        sys.exit(done.stderr)
    found = json.loads(done.stdout.splitlines()[-1])
    return found["seconds"] - found["none"], found.get("events", -1)


def by_dyknow(path: Path, queries: list[Query]) -> tuple[float, int]:
    """Seconds of processor time to evaluate a table, and the events of the first query."""
    engine = Engine()
    engine.annotate(
        "stream adsb contains speed(Aircraft) = groundspeed [kn] for every Aircraft = icao24"
    )
    engine.register_template((ROOT / "templates" / "library" / "high_speed.rq").read_text())
    source = open_recording(path)
    engine.declare(StreamDeclaration("adsb", source.schema.fields))
    requests = [engine.request_event(engine.parse_request(query.request)) for query in queries]
    batches = list(source)
    begin = time.process_time()
    for incoming in batches:
        engine.publish("adsb", incoming, 0)
    engine.end("adsb")
    seconds = time.process_time() - begin
    return seconds, engine.generator(requests[0].stream).stream.last_number


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("flink_python")
    parser.add_argument("recording", type=Path)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        long = Table(given.recording, REPEATS, Path(folder) / "long.csv")
        short = Table(given.recording, 1, Path(folder) / "short.csv")
        for name, table, queries in (
            ("1 query", long, [Query(800.05)]),
            ("100 limits", short, [Query(700.05 + i) for i in range(QUERIES)]),
            ("100 aircraft", short, [Query(700.05, name) for name in short.aircraft]),
        ):
            by_dyknow(table.path, queries)
            ours, events = by_dyknow(table.path, queries)
            theirs, counted = by_flink(given.flink_python, table, queries, table is long)
            same = "" if counted in (-1, events) else f"; Flink finds {counted:,}"
            print(
                f"{name:12} {table.samples / ours / 1e6:7.3f} M samples/s, Flink "
                f"{table.samples / theirs / 1e6:6.3f}: {theirs / ours:6.1f} ×; {events:,} events "
                f"of the first query{same}",
                flush=True,
            )


if __name__ == "__main__":
    main()
