"""Esper 9, an oracle for patterns: built by Maven, and run over events of `pattern_data`."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dyknow.reasoning.patterns.plans.rows import Rows

PROJECT = Path(__file__).parents[2] / "conformance" / "esper"
JAVA = ("java", "-XX:ActiveProcessorCount=1", "-XX:+UseSerialGC", "-Xmx3g")
WITHIN = "where timer:within(1000.5 sec)"
"""A match may last 1,000 s: Esper's timer fires before an event at its very end."""
ANY = (
    "select a.row as a, b.row as b, c.row as c from pattern [every a=A -> "
    f"(every b=B(key=a.key) -> every c=C(key=a.key)) {WITHIN}]"
)
NEXT = (
    "select a.row as a, b.row as b, c.row as c from pattern [every a=A -> "
    f"(b=B(key=a.key) -> c=C(key=a.key)) {WITHIN}]"
)
WITHOUT_D = (
    "select a.row as a, c.row as c from pattern [every a=A -> "
    f"(every c=C(key=a.key) and not D(key=a.key)) {WITHIN}]"
)
ENDING_WITHOUT_D = (
    "select a.row as a from pattern [every a=A -> "
    "(timer:interval(1000.5 sec) and not D(key=a.key))]"
)


class NoEsper(RuntimeError):
    """Esper cannot be built here; the message says why."""


@dataclass(frozen=True)
class Ran:
    """``rows``: the matches, in order of their rows; ``seconds`` of processor time of the thread,
    the least of all runs."""

    rows: NDArray[np.int64]
    seconds: float


class Esper:
    """Built in a folder. Raises `NoEsper` where its tools or its libraries are not there."""

    def __init__(self, folder: Path) -> None:
        missing = [name for name in ("java", "javac", "mvn") if shutil.which(name) is None]
        if missing:
            raise NoEsper(f"{' and '.join(missing)} not installed")
        project = folder / "esper"
        shutil.copytree(PROJECT, project, dirs_exist_ok=True)
        fetched = subprocess.run(
            [
                *("mvn", "--quiet", "--batch-mode"),
                *("dependency:build-classpath", "-Dmdep.outputFile=classpath"),
            ],
            cwd=project,
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
        if fetched.returncode:
            raise NoEsper(f"Maven does not fetch it: {fetched.stdout[:300]}")
        path = (project / "classpath").read_text().strip()
        subprocess.run(["javac", "-cp", path, "Patterns.java"], cwd=project, check=True)
        self._path = f"{project}:{path}"
        self._folder = project

    def run(self, pattern: str, rows: Rows, columns: int, runs: int = 1) -> Ran:
        """Evaluate a pattern whose matches have so many columns."""
        events, matches = self._folder / "events", self._folder / "matches"
        table = [rows.end // 10**9, rows.kind, rows.columns["x"]]
        np.stack(table, axis=1).astype("<i4").tofile(events)
        done = subprocess.run(
            [*JAVA, "-cp", self._path, "Patterns", events, pattern, str(runs), matches],
            capture_output=True,
            text=True,
            timeout=300,
            check=True,
        )
        seconds = [float(line.split()[2]) for line in done.stdout.splitlines()]
        found = np.fromfile(matches, ">i4").reshape(-1, columns).astype(np.int64)
        return Ran(found[np.lexsort(found.T[::-1])], min(seconds))
