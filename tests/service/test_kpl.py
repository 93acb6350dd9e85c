"""``dyknow kpl check`` and ``prove``: Example 5.5 and a flight log ([DyKnow10 §5.2])."""

import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from dyknow.engine.processes import PROCESSES
from dyknow.service.cli import app

EXAMPLE = """source pos pos_car1
strmgen pos[car1]=pos_car1
compunit speed SpeedEst(pos)
strmgen speed[car1]=SpeedEst(pos[car1] with sample every 200)
stream every200 = pos[car1] with sample every 200
stream grid = pos[car1] with sample every 50, from 200 to 600, max delay 30, use most recent
stream speed_car1=speed[car1] with from 300 to 400
"""
RECORDED = [(250, 200, 1.0), (325, 300, 2.0), (430, 400, 3.0), (505, 500, 4.0)]
UNIT = """
import dyknow

@dyknow.computational_unit(output="speed", inputs=["pos"], name="SpeedEst")
def speed_est(time, samples, state):
    (sample,) = samples
    if state is None:
        return None, sample.value
    return dyknow.Sample(sample.valid, {"value": sample.value - state}), sample.value
"""
LOG = Path(__file__).parents[3] / "shared" / "data" / "px4" / "sample.ulg"
PX4 = """source imu sensor_combined
source attitude vehicle_attitude
source position vehicle_local_position
strmgen imu[uav1] = sensor_combined
strmgen attitude[uav1] = vehicle_attitude
strmgen position[uav1] = vehicle_local_position
stream imu50 = imu[uav1] with sample every 20ms, from 112s to 180s, max delay 10ms, use most recent
stream ordered = attitude[uav1] with strict order, max delay 50ms
strmgen state[uav1] = sync(imu[uav1] with monotone order, attitude[uav1] with monotone order,
  position[uav1] with monotone order;
  sample every 100ms, from 112s to 180s, max delay 200ms, use most recent)
stream states = state[uav1] with strict order
"""


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    (tmp_path / "example.kpl").write_text(EXAMPLE)
    lines = [json.dumps({"available": a, "valid": v, "value": x}) for a, v, x in RECORDED]
    (tmp_path / "pos_car1.ndjson").write_text("\n".join(lines))
    (tmp_path / "units_of_the_example.py").write_text(UNIT)
    yield tmp_path
    # The decorator filled the registry of the whole process.
    if "SpeedEst" in PROCESSES:
        PROCESSES.remove("SpeedEst")


def test_check_prints_the_declarations(folder: Path) -> None:
    done = CliRunner().invoke(app, ["kpl", "check", str(folder / "example.kpl")])
    assert done.exit_code == 0
    assert "strmgen speed[car1] = SpeedEst(pos[car1] with sample every 200)" in done.output


def test_check_says_where_the_mistake_is(folder: Path) -> None:
    (folder / "wrong.kpl").write_text("source pos pos_car1\nstrmgen pos[car1] = pos_car2\n")
    done = CliRunner().invoke(app, ["kpl", "check", str(folder / "wrong.kpl")])
    assert done.exit_code == 1
    assert "line 2, column 21" in done.stderr


def test_prove_example_5_5_with_the_papers_numbers(folder: Path) -> None:
    words = ["kpl", "prove", "example.kpl", "pos_car1.ndjson", "--time-unit", "ms", "--json"]
    words[2], words[3] = str(folder / words[2]), str(folder / words[3])
    unit = ["--processes", str(folder / "units_of_the_example.py")]
    done = CliRunner().invoke(app, [*words, *unit])
    assert done.exit_code == 0, done.stderr
    proofs = {proof["stream"]: proof for proof in map(json.loads, done.stdout.splitlines())}
    assert all(proof["holds"] for proof in proofs.values())
    assert proofs["every200"]["sent"] == 2
    assert proofs["every200"]["as_recorded"]["row"] == 2
    assert proofs["grid"]["sent"] == 8  # 250 to 600: at 230 nothing was known yet
    assert proofs["speed_car1"]["sent"] == 1


def test_a_unit_without_implementation_is_named(folder: Path) -> None:
    text = EXAMPLE.replace("SpeedEst", "NobodyWroteIt")
    (folder / "example.kpl").write_text(text)
    files = [str(folder / "example.kpl"), str(folder / "pos_car1.ndjson")]
    done = CliRunner().invoke(app, ["kpl", "prove", *files])
    assert done.exit_code == 1
    assert "NobodyWroteIt" in done.stderr


@pytest.mark.skipif(not LOG.exists(), reason="the PX4 log is not part of the project")
def test_prove_a_flight_log(tmp_path: Path) -> None:
    (tmp_path / "px4.kpl").write_text(PX4)
    done = CliRunner().invoke(app, ["kpl", "prove", str(tmp_path / "px4.kpl"), str(LOG), "--json"])
    assert done.exit_code == 0, done.stderr
    proofs = [json.loads(line) for line in done.stdout.splitlines()]
    assert [proof["stream"] for proof in proofs] == ["imu50", "ordered", "states"]
    assert all(proof["holds"] and proof["sent"] > 600 for proof in proofs)


def test_the_texts_of_the_page_on_kpl_are_kpl(tmp_path):
    page = (Path(__file__).parents[2] / "docs" / "kpl.md").read_text()
    texts = re.findall(r"^```\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    assert len(texts) == 2
    for text in texts:
        file = tmp_path / "text.kpl"
        file.write_text(text)
        said = CliRunner().invoke(app, ["kpl", "check", str(file)])
        assert said.exit_code == 0, said.output
