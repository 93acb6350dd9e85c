"""A command imports what it needs: help is quick, and so is what only talks to a service."""

import subprocess
import sys

import pytest

import dyknow
from dyknow.service.cli.main import COMMANDS, command

COMPUTING = ("numba", "numpy", "pandas", "rdflib", "pyoxigraph", "fastapi", "dyknow.engine.engine")
"""What takes long to import, and is for who computes."""


def imported(code: str, *names: str) -> list[str]:
    """Which of ``names`` a new process has imported after ``code``."""
    told = f"import sys\n{code}\nprint(*[name for name in {names!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", told], capture_output=True, text=True, check=True)
    return done.stdout.splitlines()[-1].split()


def called(*arguments: str) -> str:
    """Code that runs a command."""
    return (
        "from dyknow.service.cli import app\n"
        f"try:\n    app({list(arguments)!r})\nexcept SystemExit:\n    pass"
    )


@pytest.mark.parametrize("name", COMMANDS)
def test_the_list_of_commands_says_what_a_command_says(name: str) -> None:
    told = COMMANDS[name][1]
    assert " ".join(command(name).help.split()).startswith(told)


@pytest.mark.parametrize("name", [None, *COMMANDS])
def test_help_computes_nothing(name: str | None) -> None:
    asked = ("--help",) if name is None else (name, "--help")
    assert imported(called(*asked), *COMPUTING) == []


@pytest.mark.parametrize("code", ["import dyknow", "import dyknow; dyknow.Client()"])
def test_a_client_computes_nothing(code: str) -> None:
    assert imported(code, *COMPUTING) == []


def test_rows_are_published_without_what_computes() -> None:
    code = """
import httpx, dyknow
answer = httpx.MockTransport(lambda request: httpx.Response(202, json={"accepted": 1}))
assert dyknow.Client(transport=answer).publish("s", [{"available": 1, "speed": 2.0}]) == 1"""
    assert imported(code, *COMPUTING) == []


def test_the_package_tells_what_it_has() -> None:
    assert set(dyknow.__all__) <= set(dir(dyknow))
    for name in dyknow.__all__:
        assert getattr(dyknow, name) is not None
