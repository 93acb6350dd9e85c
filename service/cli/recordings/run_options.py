"""The options of ``dyknow run``, and the files that they name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import typer

from ....converters.recordings.many_streams import is_log
from ....converters.recordings.table_options import TableOptions
from ..output import fail
from ..parameters import BoundsWord, ReportWord, SemanticsWord


@dataclass(frozen=True, slots=True)
class RunOptions:
    """The text of a query or monitor, and the options of the command, unparsed."""

    text: str
    stream: list[str]
    static: list[str] | None
    ssl: str | None
    ontology: list[Path] | None
    semantics: SemanticsWord | None
    bounds: BoundsWord
    origin: str
    report: ReportWord
    lateness: str | None
    late: Path | None
    sort: bool | None
    tables: TableOptions
    explain: bool
    as_json: bool


def files_of(pairs: Sequence[str]) -> dict[str, Path]:
    """Return the files of ``--stream NAME=FILE`` by name."""
    files: dict[str, Path] = {}
    for pair in pairs:
        iri, equals, name = pair.rpartition("=")
        if not equals or not iri:
            raise typer.BadParameter(
                f"{pair!r}: write --stream IRI=FILE, or NAME=FILE for a monitor"
            )
        add_file(files, "--stream", iri, Path(name))
    return files


def add_file(files: dict[str, Path], option: str, iri: str, path: Path) -> None:
    """Add a file under its IRI, which no other file may have."""
    iri = iri.strip("<>")
    if iri in files:
        raise typer.BadParameter(f"{option}: <{iri}> is {files[iri]} already")
    is_bag = path.is_dir() and is_log(path)
    files[iri] = path if is_bag else existing_file(path)


def existing_file(path: Path) -> Path:
    """Return ``path``, if it is that of a file."""
    if not path.is_file():
        raise fail(f"there is no file {path}")
    return path
