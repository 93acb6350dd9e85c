"""Speeds derived from coordinates agree with the speeds that aircraft reported themselves."""

import runpy

from places import ROOT

from dyknow.engine.processes.geodesy import SpeedFromCoordinates

BENCH = ROOT / "bench" / "streams" / "accuracy.py"


def test_median_difference_over_the_slice_is_within_ten_knots():
    accuracy = runpy.run_path(str(BENCH))
    found = accuracy["agreement"](accuracy["SLICE"], SpeedFromCoordinates())
    assert found.speeds > 5_000
    assert found.median < 10.0
