"""How long a recording takes to read: its first pass, the order of its rows, and the rows.

python bench/service/recordings.py RECORDING
"""

from __future__ import annotations

import sys
import time

from dyknow.converters.recordings.recording import open_recording
from dyknow.converters.recordings.time_order import in_time_order

RUNS = 3


def main() -> None:
    found = []
    for _ in range(RUNS):
        begun = time.process_time()
        recording = open_recording(sys.argv[1])
        opened = time.process_time()
        ordered = in_time_order(recording).recording
        known = time.process_time()
        rows = sum(len(each.batch) for each in ordered)
        ended = time.process_time()
        found.append((ended - begun, opened - begun, known - opened, ended - known, rows))
    whole, *parts, rows = min(found)
    told = ", ".join(
        f"{name} {each / rows * 1e6:.1f}"
        for name, each in zip(("first pass", "order", "rows"), parts, strict=True)
    )
    print(f"{rows:,} rows, {whole / rows * 1e6:.1f} µs a row: {told}")


if __name__ == "__main__":
    main()
