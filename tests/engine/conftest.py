"""An engine in memory and the template that everybody uses."""

import pytest
from places import ROOT

from dyknow.engine.engine import Engine

LIBRARY = ROOT / "templates" / "library"


@pytest.fixture
def engine():
    return Engine(epoch="test")


@pytest.fixture
def high_speed():
    """Listing 4 of [Events14]."""
    return (LIBRARY / "high_speed.rq").read_text()
