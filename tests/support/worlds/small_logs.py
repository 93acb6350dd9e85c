"""Folders for logs whose files are small."""

import shutil
import tempfile
from contextlib import contextmanager
from pathlib import Path
from unittest.mock import patch


@contextmanager
def folder():
    """A new one; room is made by a few bytes, else most of what is drawn would be zeros."""
    path = Path(tempfile.mkdtemp(prefix="dyknow-journal-"))
    try:
        with patch("dyknow.journal.segment._ROOM", 300):
            yield path
    finally:
        shutil.rmtree(path)
