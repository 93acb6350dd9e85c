"""``--sweeps=WAY``: terms are forgotten at every chance, in all tests that run (`sweeping`).

``make test`` runs some laws once more so, with a share of their examples (``--share``); ``make
soak-patterns`` draws a multiple of them.
"""

import gc
from collections.abc import Iterator

import pytest
from hypothesis import settings
from sweeping import WAYS, at_every_chance

from dyknow.streams import jit

# Tests are of compiled loops, however little they have to do; no test sees the notice of compiling.
jit.PATIENCE = 0.0
jit.NOTICEABLE = 86_400.0


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--sweeps", choices=WAYS, help="forget terms at every chance")
    parser.addoption("--recorded", action="store_true", help="services with a data directory")
    parser.addoption("--share", type=float, default=1.0, help="how much of all examples to draw")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: item.get_closest_marker("long") is None)
    share = config.getoption("--share")
    for item in items:
        law = getattr(item, "obj", None)
        known = getattr(law, "_hypothesis_internal_use_settings", None)
        if share != 1 and known is not None:
            count = max(1, round(share * known.max_examples))
            law._hypothesis_internal_use_settings = settings(known, max_examples=count)


def pytest_collection_finish() -> None:
    # Modules and tests are no garbage: full collections need not walk them, nor so often.
    gc.collect()
    gc.freeze()
    gc.set_threshold(10_000, 20, 20)


@pytest.fixture(scope="session", autouse=True)
def sweeps(request: pytest.FixtureRequest) -> Iterator[None]:
    way = request.config.getoption("--sweeps")
    if way is None:
        yield
        return
    with at_every_chance(way):
        yield


@pytest.fixture
def interpreted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Loops run in plain Python, as those do that are not compiled yet (`Kernel.run`)."""
    monkeypatch.setattr(jit, "JIT", False)
