"""The notebook of the first hour runs headless, beside a service, and shows what is in the file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import nbformat
import pytest
from nbclient import NotebookClient
from places import ROOT
from serving import Serving

NOTEBOOK = ROOT / "examples" / "first_hour.ipynb"


def shown(notebook: Any) -> list[list[str]]:
    """What each cell prints and shows, as text."""
    return [
        [output.get("text") or output["data"]["text/plain"] for output in cell.outputs]
        for cell in notebook.cells
        if cell.cell_type == "code"
    ]


def test_the_notebook_runs_and_shows_what_the_file_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written = nbformat.read(NOTEBOOK, as_version=4)
    again = nbformat.read(NOTEBOOK, as_version=4)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    service = Serving(None, "--flights")
    try:
        monkeypatch.setenv("DYKNOW_URL", service.url)
        service.until(lambda: service.http.get("/templates/HighSpeedEvent").is_success)
        NotebookClient(
            again, timeout=600, resources={"metadata": {"path": str(tmp_path)}}
        ).execute()
    finally:
        service.stop()
    assert shown(again) == shown(written)
    assert len(shown(written)) > 5
