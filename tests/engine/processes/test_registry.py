"""The registry of user-written processes, how it is filled, and docs/how-to/write-a-process.md."""

import re
import sys
from importlib.metadata import EntryPoint

import pytest
from places import ROOT
from process_running import content, offer, stream, unit

import dyknow
from dyknow.engine.model.errors import AlreadyExists, BadArguments, UnknownFeature
from dyknow.engine.processes.loading import load_processes
from dyknow.engine.processes.registry import PROCESSES, Processes
from dyknow.streams.single_sample import Sample


def f(time, samples, state):
    return None, state


def test_decorators_register_and_change_nothing():
    registry = Processes()
    decorated = registry.computational_unit("speed", ["pos"], deadline="5s", restarts=1)(f)
    assert decorated is f
    found = registry.unit("f")
    assert (found.output, found.inputs, found.make()) == ("speed", ("pos",), f)
    assert (found.rule.deadline, found.rule.restarts) == (5_000_000_000, 1)
    registry.sampled("temperature", "100ms", name="thermo")(f)
    assert registry.source("thermo").period == 100_000_000
    registry.consumer(["speed"], name="log")(f)
    assert registry.sink("log").inputs == ("speed",)
    assert [p.name for p in registry.all()] == ["f", "thermo", "log"]
    assert [list(registry.units), list(registry.sources), list(registry.sinks)] == [
        ["f"],
        ["thermo"],
        ["log"],
    ]


def test_a_name_is_registered_once():
    registry = Processes()
    registry.computational_unit("speed", ["pos"])(f)
    registry.computational_unit("speed", ["pos"])(f)
    with pytest.raises(AlreadyExists, match="a process called 'f' already, a computational unit"):
        registry.computational_unit("speed", ["pos"], name="f")(lambda t, s, i: (None, None))
    with pytest.raises(AlreadyExists):
        registry.consumer(["pos"])(f)
    assert len(registry.all()) == 1


@pytest.mark.parametrize(
    ("make", "problem"),
    [
        (lambda r: r.computational_unit("speed", "pos")(f), "inputs must be a list"),
        (lambda r: r.computational_unit("speed", [])(f), "inputs must be a list"),
        (lambda r: r.computational_unit("sp eed", ["pos"])(f), "a value sort must be a name"),
        (lambda r: r.computational_unit("speed", ["1"])(f), "a value sort must be a name"),
        (lambda r: r.computational_unit("s", ["p"])(lambda t, s, i: None), "name of a process"),
        (lambda r: r.computational_unit("s", ["p"])(5), "a function or a class"),
        (lambda r: r.computational_unit("s", ["p"])(type("No", (), {})), "cannot be called"),
        (
            lambda r: r.computational_unit("s", ["p"], on_error="retry")(f),
            "on_error must be one of restart",
        ),
        (lambda r: r.computational_unit("s", ["p"], restarts=-1)(f), "restarts"),
        (lambda r: r.computational_unit("s", ["p"], deadline="soon")(f), "deadline: "),
        (lambda r: r.sampled("s", "0s")(f), "period must be more than 0"),
        (lambda r: r.sampled("s", 100)(f), "period: "),
    ],
)
def test_declarations_are_checked(make, problem):
    registry = Processes()
    with pytest.raises(BadArguments, match=re.escape(problem)):
        make(registry)
    assert registry.all() == ()


def test_asynchronous_functions_are_refused():
    async def soon(time, samples, state):
        return None, None

    with pytest.raises(BadArguments, match="asynchronous"):
        Processes().computational_unit("s", ["p"])(soon)


def test_look_ups_say_what_there_is():
    registry = Processes()
    registry.consumer(["pos"], name="log")(f)
    with pytest.raises(UnknownFeature, match=r"no process called 'SpeedEst'.*there are: log"):
        registry.unit("SpeedEst")
    with pytest.raises(UnknownFeature, match="'log' is not a source"):
        registry.source("log")


def test_the_package_has_the_decorators():
    assert dyknow.computational_unit == PROCESSES.computational_unit
    assert dyknow.Sample is Sample
    assert dyknow.source == PROCESSES.sampled
    assert dyknow.sink == PROCESSES.consumer


@pytest.fixture
def modules(tmp_path, monkeypatch):
    """A folder to write modules to; what they register is forgotten again."""
    before = {known.name for known in PROCESSES.all()}
    names = set(sys.modules)
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path
    for known in PROCESSES.all():
        if known.name not in before:
            PROCESSES.remove(known.name)
    for name in set(sys.modules) - names:
        del sys.modules[name]


UNIT = """\
import dyknow
@dyknow.computational_unit(output="speed", inputs=["pos"])
def {name}(time, samples, state):
    return None, state
"""


def test_modules_files_and_entry_points_are_loaded(modules):
    (modules / "proc_a.py").write_text(UNIT.format(name="UnitA"))
    (modules / "proc_b.py").write_text(UNIT.format(name="UnitB"))
    (modules / "proc_c.py").write_text(UNIT.format(name="UnitC"))
    points = [
        EntryPoint("a", "proc_a", "dyknow.processes"),
        EntryPoint("gone", "proc_gone:Unit", "dyknow.processes"),
    ]
    reports = load_processes(["proc_b", str(modules / "proc_c.py"), "proc_b"], points=points)
    assert [report.added for report in reports] == [("UnitA",), (), ("UnitB",), ("UnitC",), ()]
    assert [report.error is None for report in reports] == [True, False, True, True, True]
    assert reports[1].origin == "entry point gone = proc_gone:Unit"
    assert "ModuleNotFoundError: No module named 'proc_gone'" in reports[1].error


def test_a_module_that_fails_leaves_nothing_behind(modules):
    (modules / "proc_d.py").write_text(UNIT.format(name="UnitD"))
    path = modules / "proc_e.py"
    path.write_text("import proc_d\n" + UNIT.format(name="UnitE") + "1 / 0\n")
    for module in ("proc_e", str(path)):
        (report,) = load_processes([module], points=[])
        assert "ZeroDivisionError: division by zero (proc_e.py:6)" in report.error
        assert "UnitE" not in PROCESSES
    assert "UnitD" in PROCESSES
    path.write_text(UNIT.format(name="UnitE") + "# now it works\n")
    (report,) = load_processes([str(path)], points=[])
    assert report.added == ("UnitE",)


def test_installed_entry_points_are_looked_up():
    assert all(report.error is None for report in load_processes())


# -- the page ----------------------------------------------------------------------------------


def test_the_examples_of_the_page_run(modules):
    """docs/how-to/write-a-process.md: each Python block runs, in order, in one namespace."""
    page = (ROOT / "docs" / "how-to" / "write-a-process.md").read_text()
    blocks = re.findall(r"^```python\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    assert len(blocks) >= 6
    namespace = {"__name__": "processes_page"}
    for block in blocks:
        exec(compile(block, "docs/how-to/write-a-process.md", "exec"), namespace)
    pieces = ((1, 2), (3,), (4, 5, 6))
    results = []
    for name in ("SpeedEst", "SpeedEstOfBatches"):
        known = PROCESSES.unit(name)
        pos = stream(pos="float")
        made = unit(known.code, [pos], batch=known.batch)
        for piece in pieces:
            offer(pos, *[(t, 2 * t, float(t * t)) for t in piece])
        results.append(content(made.output))
    assert results[0] == results[1]
    assert len(results[0]) == 5
