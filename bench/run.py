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
    "queries/speed_query.py",
    "queries/windows.py",
    "queries/evaluate.py",
    "queries/terms.py",
    "queries/citybench.py",
    "queries/two_stars.py",
    "queries/instances.py",
    "queries/requests.py",
    "queries/queries.py",
    "service/service.py",
    "service/latency.py",
    "service/sse.py",
    "service/sse_messages.py",
    "service/turns.py",
    "service/batches.py",
    "service/bombs.py",
    "service/workers.py",
    "service/journal.py",
    "service/ingest.py",
    "service/rdf.py",
    "streams/accuracy.py",
    "streams/policies.py",
    "streams/joining.py",
    "streams/growth.py",
    "matching/matching.py",
    "matching/optimum.py",
    "streams/keyed_joining.py",
    "matching/adaptive.py",
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
