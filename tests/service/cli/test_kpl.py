"""``dyknow kpl check`` and ``prove``: Example 5.5 and a flight log ([DyKnow10 §5.2])."""

import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from places import ROOT
from shared_data import DATA
from typer.testing import CliRunner

from dyknow.engine.processes.registry import PROCESSES
from dyknow.engine.units import policy
from dyknow.service.cli import app
from dyknow.streams.policies.select_adaptation import adapt
from dyknow.streams.synchronization.change_states import ChangeStates

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
LOG = DATA / "px4" / "sample.ulg"
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
    assert [proof["stream"] for proof in proofs] == [
        *("imu50", "ordered", "states"),
        *(f"{name}[uav1] with monotone order" for name in ("imu", "attitude", "position")),
        "state[uav1]",
    ]
    assert all(proof["holds"] and proof["sent"] > 600 for proof in proofs)


def test_the_texts_of_the_page_on_kpl_are_kpl(tmp_path):
    page = (ROOT / "docs" / "reference" / "kpl.md").read_text()
    texts = re.findall(r"^```kpl\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    assert len(texts) == 2
    for text in texts:
        file = tmp_path / "text.kpl"
        file.write_text(text)
        said = CliRunner().invoke(app, ["kpl", "check", str(file)])
        assert said.exit_code == 0, said.output


def test_run_prints_the_streams_and_gives_them_back(tmp_path):
    """Example 5.5 from a table in the paper's abstract time; sorted by available time."""
    (tmp_path / "app.kpl").write_text(
        "sort pos = float\nsource pos p\nstrmgen pos[car1] = p\n"
        "stream every200 = pos[car1] with sample every 200\nstream all = pos[car1]\n"
    )
    rows = [RECORDED[i] for i in (2, 0, 3, 1)]
    text = "".join(f"{a},{v},{x}\n" for a, v, x in rows)
    (tmp_path / "p.csv").write_text("available,valid,value\n" + text)
    arguments = ["kpl", "run", str(tmp_path / "app.kpl"), str(tmp_path / "p.csv")]
    said = CliRunner().invoke(app, [*arguments, "--json"])
    assert said.exit_code == 0, said.output
    made = [json.loads(line) for line in said.output.splitlines()]
    assert [(one["stream"], one["value"]) for one in made] == [
        *(("all", 1.0), ("every200", 1.0), ("all", 2.0), ("all", 3.0), ("every200", 3.0)),
        ("all", 4.0),
    ]
    assert made[1]["available"] == "1970-01-01T00:00:00.25Z"
    label = CliRunner().invoke(app, [*arguments, "--stream", "pos[car1]"])
    assert len(label.output.splitlines()) == 4
    unknown = CliRunner().invoke(app, [*arguments, "--stream", "nothing"])
    assert unknown.exit_code == 1


INNER = """
source float p
source float q
strmgen f = p
strmgen g = q
strmgen pair = join(f with monotone order, g)
strmgen timed = join(f, g; inner times)
strmgen state = sync(f, g; any change, max delay 20, use most recent)
"""


def prove(tmp_path, text, *files):
    (tmp_path / "inner.kpl").write_text(text)
    arguments = ["kpl", "prove", str(tmp_path / "inner.kpl"), *map(str, files), "--json"]
    return CliRunner().invoke(app, arguments)


def test_inner_terms_joins_and_synchronizations_are_proved(tmp_path, monkeypatch):
    """And refused, were they made otherwise."""
    files = [tmp_path / "p.csv", tmp_path / "q.csv"]
    rows = "110,100,1\n120,90,2\n310,300,3\n"
    files[0].write_text("available,valid,value\n" + rows)
    files[1].write_text("available,valid,value\n115,100,1\n340,300,2\n")
    said = prove(tmp_path, INNER, *files)
    assert said.exit_code == 0, said.output
    proofs = {one["stream"]: one for one in map(json.loads, said.stdout.splitlines())}
    assert list(proofs) == ["f with monotone order", "pair", "state", "timed"]
    assert proofs["f with monotone order"]["dropped"] == {"order": 1}
    assert proofs["pair"]["sent"] == 4
    assert proofs["state"]["sent"] == 2
    monkeypatch.setattr(ChangeStates, "_leave", lambda _, times, *__: ([], times[:0]))
    spoilt = prove(tmp_path, INNER, *files)
    assert spoilt.exit_code == 1
    proofs = {one["stream"]: one for one in map(json.loads, spoilt.stdout.splitlines())}
    assert not proofs["state"]["holds"]
    assert "there is no state for 100" in proofs["state"]["refutation"]["message"].replace(
        "000", ""
    )


def test_rows_out_of_order_are_sorted_on_demand(tmp_path):
    (tmp_path / "app.kpl").write_text(
        "sort pos = float\nsource pos p\nstrmgen pos[car1] = p\nstream all = pos[car1]\n"
    )
    (tmp_path / "p.csv").write_text("valid,value\n300,3\n100,1\n200,2\n")
    arguments = ["kpl", "run", str(tmp_path / "app.kpl"), str(tmp_path / "p.csv"), "--json"]

    def times(*options):
        said = CliRunner().invoke(app, [*arguments, *options])
        assert said.exit_code == 0, said.output
        made = [json.loads(line) for line in said.output.splitlines()]
        return [(one["available"][-5:], one["value"]) for one in made]

    # A row that steps back becomes available with the greatest time before it.
    assert times() == [("00.3Z", 3.0), ("00.3Z", 1.0), ("00.3Z", 2.0)]
    assert times("--sort") == [("00.1Z", 1.0), ("00.2Z", 2.0), ("00.3Z", 3.0)]


OBJECTS = """sort fix = (id string, spd float)
source fix radar
strmgen f = radar
stream each = f with sample every 100
"""
MEANING = "stream radar contains speed(UAV) = spd for every UAV = id"


def test_with_the_meaning_of_a_source_each_object_is_proved(tmp_path, monkeypatch):
    rows = [f"{t + 50 * k},{t + 50 * k},uav{k},1" for t in (100, 200, 300) for k in (0, 1)]
    (tmp_path / "radar.csv").write_text("\n".join(["available,valid,id,spd", *rows]))
    (tmp_path / "app.kpl").write_text(OBJECTS)

    def kpl(command, *options):
        arguments = ["kpl", command, str(tmp_path / "app.kpl"), str(tmp_path / "radar.csv")]
        return CliRunner().invoke(app, [*arguments, "--json", *options])

    whole = kpl("prove")
    assert json.loads(whole.stdout)["as_recorded"] is not None
    assert (whole.exit_code, json.loads(whole.stdout)["sent"]) == (0, 3)
    each = kpl("prove", "--ssl", MEANING)
    proof = json.loads(each.stdout)
    assert (each.exit_code, proof["sent"], proof["as_recorded"]) == (0, 6, None), each.output
    made = kpl("run", "--ssl", MEANING)
    ids = [json.loads(line)["id"] for line in made.stdout.splitlines()]
    assert ids == ["uav0", "uav1"] * 3
    # Were all of it made as one stream, the samples of uav1 would be missing.
    monkeypatch.setattr(policy, "adapt_each", lambda policy, _, *a, **b: adapt(policy, **b))
    spoilt = kpl("prove", "--ssl", MEANING)
    assert spoilt.exit_code == 1
    refuted = json.loads(spoilt.stdout)["refutation"]
    assert refuted["row"] == 2
    assert "of uav1: a sample valid at 150" in refuted["message"]


def test_a_meaning_that_does_not_fit(tmp_path):
    (tmp_path / "radar.csv").write_text("available,valid,id,spd\n100,100,uav1,1\n")
    (tmp_path / "app.kpl").write_text(OBJECTS)
    arguments = [str(tmp_path / "app.kpl"), str(tmp_path / "radar.csv"), "--ssl"]
    said = CliRunner().invoke(
        app, ["kpl", "prove", *arguments, MEANING.replace("= id", "= callsign")]
    )
    assert said.exit_code == 1
    assert "names objects by 'callsign', and the recording has no such field" in said.stderr
    other = CliRunner().invoke(app, ["kpl", "prove", *arguments, MEANING.replace("radar", "rader")])
    assert other.exit_code == 0
    assert "annotates stream 'rader', which is not declared" in other.stderr


def test_nothing_proved_is_no_proof(tmp_path):
    file = tmp_path / "p.csv"
    file.write_text("available,valid,value\n110,100,1\n")
    text = "source float p\nstrmgen f = p\n"
    said = prove(tmp_path, text, file)
    assert said.exit_code == 1
    assert "nothing was proved" in said.stderr
    text += "source float q\nstrmgen g = q\nstream s = g with any change\n"
    silent = prove(tmp_path, text, file)
    assert silent.exit_code == 1
    assert "no stream has a sample" in silent.stderr


def test_recorded_samples_of_one_available_time_are_an_instant(tmp_path):
    (tmp_path / "app.kpl").write_text("source float p\nstrmgen f = p\nstream s = f\n")
    (tmp_path / "p.csv").write_text("available,valid,value\n250,200,1\n250,300,2\n260,260,3\n")
    said = CliRunner().invoke(
        app, ["kpl", "prove", str(tmp_path / "app.kpl"), str(tmp_path / "p.csv")]
    )
    assert said.exit_code == 0, said.output


def test_prove_follows_objects_that_come_and_go(tmp_path):
    """The sources are mixed in time: what comes again begins anew, as in the running system."""
    (tmp_path / "app.kpl").write_text(
        "sort fix = (id string, pos float)\nsource fix cars\nsource object sight\n"
        "compunit float Speed(fix)\nstrmgen positions = cars\nstrmgen names = sight\n"
        "foreach car in names {\n strmgen pos[car] = selectObject(positions)\n"
        " strmgen speed[car] = Speed(pos[car])\n}\n"
        "strmgen speeds = aggregate(speed[car] foreach car in names)\n"
        "stream out = speeds with strict order\n"
    )
    (tmp_path / "units.py").write_text(
        "import dyknow\n\n@dyknow.computational_unit(output='float', inputs=['fix'])\n"
        "def Speed(time, samples, state):\n    now = samples[0]\n"
        "    return (None if state is None else now['pos'] - state), now['pos']\n"
    )
    moves = "".join(f"{t},{t},a,{t * t}\n" for t in range(1, 9))
    (tmp_path / "cars.csv").write_text("available,valid,id,pos\n" + moves)
    (tmp_path / "sight.csv").write_text("available,valid,value\n1,1,a\n4,4,\n6,6,a\n9,9,a\n")
    arguments = [str(tmp_path / name) for name in ("app.kpl", "cars.csv", "sight.csv")]
    modules = ["--processes", str(tmp_path / "units.py")]
    try:
        ran = CliRunner().invoke(app, ["kpl", "run", *arguments, *modules, "--json"])
        proved = CliRunner().invoke(app, ["kpl", "prove", *arguments, *modules])
    finally:
        PROCESSES.remove("Speed")
    assert ran.exit_code == proved.exit_code == 0, ran.output
    # Positions 1, 4, 9 in its first life, 36, 49, 64 in its second.
    assert [json.loads(line)["value"] for line in ran.output.splitlines()] == [3, 5, 13, 15]


@pytest.mark.parametrize(
    ("sort", "value", "words"),
    [
        ("float", "hello", "is float"),
        ("integer", "1.5", "is integer"),
        ("boolean", "7", "is boolean"),
    ],
)
def test_recorded_values_are_of_their_sort(tmp_path, sort, value, words):
    (tmp_path / "app.kpl").write_text(f"source {sort} p\nstrmgen f = p\nstream s = f\n")
    (tmp_path / "p.csv").write_text(f"available,valid,value\n250,200,{value}\n")
    said = CliRunner().invoke(
        app, ["kpl", "run", str(tmp_path / "app.kpl"), str(tmp_path / "p.csv")]
    )
    assert said.exit_code == 1, said.output
    assert words in said.output


def test_columns_in_another_order_and_values_that_lack(tmp_path):
    (tmp_path / "app.kpl").write_text(
        "sort two = (x float, y string)\nsource two p\nstrmgen f = p\nstream s = f\n"
    )
    (tmp_path / "p.csv").write_text("available,valid,y,x\n250,200,a,\n260,210,b,\n")
    arguments = ["kpl", "run", str(tmp_path / "app.kpl"), str(tmp_path / "p.csv"), "--json"]
    said = CliRunner().invoke(app, arguments)
    assert said.exit_code == 0, said.output
    made = [json.loads(line) for line in said.output.splitlines()]
    assert [(one["x"], one["y"]) for one in made] == [(None, "a"), (None, "b")]


def test_one_foreach_over_another_in_a_recording(tmp_path):
    """The sources come in time, whichever is declared first."""
    (tmp_path / "app.kpl").write_text(
        "sort fix = (id string, pos float)\nsource object focus\nsource fix cars\n"
        "source object sight\nstrmgen positions = cars\nstrmgen names = sight\n"
        "strmgen wanted = focus\n"
        "foreach car in names { strmgen pos[car] = selectObject(positions) }\n"
        "foreach x in wanted { strmgen even[x] = join(pos[x] with sample every 2) }\n"
        "strmgen all = aggregate(even[x] foreach x in wanted)\nstream out = all\n"
    )
    moves = "".join(f"{t},{t},a,{t}\n" for t in range(1, 13))
    (tmp_path / "cars.csv").write_text("available,valid,id,pos\n" + moves)
    (tmp_path / "sight.csv").write_text("available,valid,value\n0,0,a\n5,5,\n8,8,a\n")
    (tmp_path / "focus.csv").write_text("available,valid,value\n2,2,a\n11,11,\n")
    names = ("app.kpl", "cars.csv", "focus.csv", "sight.csv")
    arguments = [str(tmp_path / name) for name in names]
    said = CliRunner().invoke(app, ["kpl", "run", *arguments, "--json"])
    assert said.exit_code == 0, said.output
    made = [json.loads(line)["available"] for line in said.output.splitlines()]
    assert [float(text[18:-1]) for text in made] == [0.002, 0.004, 0.008, 0.01]


@pytest.mark.parametrize("b", ["\nvalid,value\n1,5\n", ",\n1,5\n"])
def test_a_table_without_a_header_is_not_taken_for_an_empty_one(tmp_path, b):
    (tmp_path / "s.kpl").write_text("source float s\nstrmgen a = s\nstream t = a")
    (tmp_path / "s.csv").write_text(b)
    done = CliRunner().invoke(app, ["kpl", "run", str(tmp_path / "s.kpl"), str(tmp_path)])
    assert done.exit_code == 1
    assert "the first line names the columns" in done.stderr


@pytest.mark.parametrize("b", [None, "", "valid,value\n"])
def test_a_source_without_recorded_samples_is_silent(tmp_path, b):
    text = "source float s\nsource float t\nstrmgen a = s\nstrmgen b = t\nstrmgen both = join(a, b)"
    (tmp_path / "both.kpl").write_text(text)
    (tmp_path / "s.csv").write_text("valid,value\n1,5\n")
    if b is not None:
        (tmp_path / "t.csv").write_text(b)
    words = ["kpl", "run", str(tmp_path / "both.kpl"), str(tmp_path), "--stream", "both", "--json"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0
    assert "nothing was recorded for source t, so it is silent" in done.stderr
    (line,) = done.stdout.splitlines()
    made = json.loads(line)
    assert (made["a"], made["b"]) == (5.0, None)
