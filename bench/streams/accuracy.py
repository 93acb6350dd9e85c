"""How well speeds derived from coordinates agree with the speeds that aircraft report.

    python bench/streams/accuracy.py [RECORDING]

RECORDING is an ADS-B table with the columns of examples/adsb.csv.gz, which is the default.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dyknow.converters.recordings.recording import open_recording
from dyknow.engine.processes.geodesy import SpeedFromCoordinates
from dyknow.streams.time import SECOND

SLICE = Path(__file__).parents[2] / "examples" / "adsb.csv.gz"
KNOT = 1852 / 3600
BASELINES = (0, 3, 6, 10)
MAX_GAP = 30 * SECOND


@dataclass(frozen=True, slots=True)
class Agreement:
    """Absolute differences in kt over ``speeds`` derived speeds."""

    speeds: int
    median: float
    percentile_95: float


def agreement(path: Path, unit: SpeedFromCoordinates) -> Agreement:
    """Derive speeds from the recording's positions and compare them with its ground speeds."""
    differences = []
    for incoming in open_recording(path):
        columns = incoming.batch.columns
        id_, latitude = columns["icao24"], columns["latitude"]
        longitude, reported = columns["longitude"], columns["groundspeed"]
        known = id_.present & latitude.present & longitude.present
        speeds, there = unit(
            id_.values[known].astype(np.int64),
            incoming.batch.valid[known],
            latitude.values[known],
            longitude.values[known],
        )
        there &= reported.present[known]
        differences.append(np.abs(speeds[there] / KNOT - reported.values[known][there]))
    together = np.concatenate(differences)
    return Agreement(len(together), float(np.median(together)), float(np.percentile(together, 95)))


def main(path: Path = SLICE) -> None:
    """Print the table of docs/explanation/design/0008-measurements.md."""
    default = SpeedFromCoordinates().baseline
    print(f"speeds from coordinates against reported ground speeds: {path.name}")
    print(f"{'baseline':>10} {'speeds':>9} {'median':>9} {'95th pct':>9}")
    for seconds in BASELINES:
        found = agreement(path, SpeedFromCoordinates(seconds * SECOND, MAX_GAP))
        mark = "  (default)" if seconds * SECOND == default else ""
        print(
            f"{seconds:>8} s {found.speeds:>9} {found.median:>6.1f} kt "
            f"{found.percentile_95:>6.1f} kt{mark}"
        )


if __name__ == "__main__":
    main(*(Path(argument) for argument in sys.argv[1:2]))
