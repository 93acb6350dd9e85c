"""Where the recordings and benchmarks of others are: beside the project, in no clone of it.

`shared/data` beside the checkout, or the folder that DYKNOW_TEST_DATA names (a worktree elsewhere).
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

DATA = Path(
    os.environ.get("DYKNOW_TEST_DATA") or Path(__file__).parents[3] / "shared" / "data"
).resolve()


def needs(path: Path) -> pytest.MarkDecorator:
    """Skips the tests of a module where ``path`` is absent: it may not be committed."""
    return pytest.mark.skipif(not path.exists(), reason=f"{path} is not here (see shared_data.py)")
