"""``make bench``: the figures of docs/explanation/performance.md, in one run.

Machines are noisy: read the ratios, which are between rows of one run.
"""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent
TABLES = (
    "speed_query.py",
    "windows.py",
    "evaluate.py",
    "terms.py",
    "citybench.py",
    "two_stars.py",
    "instances.py",
    "requests.py",
    "queries.py",
    "service.py",
    "latency.py",
    "sse.py",
    "sse_messages.py",
    "turns.py",
    "batches.py",
    "bombs.py",
    "journal.py",
    "ingest.py",
    "rdf.py",
    "accuracy.py",
    "policies.py",
    "joining.py",
    "growth.py",
    "matching.py",
    "optimum.py",
    "keyed_joining.py",
    "adaptive.py",
)


def main() -> int:
    """Run each table in a process of its own; the worst exit status is ours."""
    print(f"Python {platform.python_version()}, {os.cpu_count()} cores, {platform.machine()}\n")
    worst = 0
    for name in TABLES:
        worst = max(worst, subprocess.run([sys.executable, HERE / name], check=False).returncode)
        print()
    return worst


if __name__ == "__main__":
    sys.exit(main())
