"""How long the first result takes on a machine without compiled loops: ``dyknow run`` over three
samples, with an empty cache for loops each time.

    python bench/reasoning/first_result.py
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

RECORDING = """time,id,v
2026-01-01T00:00:00Z,uav1,60
2026-01-01T00:00:09Z,uav1,70
2026-01-01T00:00:19Z,uav1,20
"""
SSL = "stream a contains speed(UAV) = v [km.h-1] for every UAV = id"
RULE = "always [0s, 10s] (speed(?x) > 50 -> eventually [0s, 5s] speed(?x) < 50)"
TEXTS = {
    "a formula": f"monitor m(?x in UAV) = {RULE} with report verdicts",
    "a formula on a grid": f"monitor m(?x in UAV) = {RULE} with sample every 1s, report verdicts",
    "a chronicle": "chronicle c(?x) { event(speed[?x]:(?, > 50), t1); "
    "event(speed[?x]:(?, < 50), t2); t2 - t1 in [1s, 30s]; }",
    "a SASE+ pattern": "PATTERN SEQ(speed a, speed b) WHERE skip_till_next_match [id] "
    "AND a.value > 50 WITHIN 30 seconds RETURN a.id",
}


def seconds(text: str, folder: Path) -> float:
    """Return the time of a run, start of Python included."""
    query, recording = folder / "query.txt", folder / "recording.csv"
    query.write_text(text)
    recording.write_text(RECORDING)
    start = "from dyknow.service.cli import main; main()"
    command = ["-c", start, "run", str(query), "--stream", f"a={recording}", "--ssl", SSL]
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder / "loops")}
    begun = time.monotonic()
    done = subprocess.run(
        [sys.executable, *command], env=environment, capture_output=True, text=True, check=False
    )
    spent = time.monotonic() - begun
    if done.returncode or not done.stdout:
        raise SystemExit(done.stderr)
    return spent


def main() -> None:
    for name, text in TEXTS.items():
        with tempfile.TemporaryDirectory() as folder:
            print(f"{name:20} {seconds(text, Path(folder)):5.1f} s", flush=True)


if __name__ == "__main__":
    main()
