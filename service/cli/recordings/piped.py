"""The differences of ``dyknow replay`` for a pipe, which can be read only once."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from ..output import err

if TYPE_CHECKING:
    from ....converters.recordings.piped import Piped, Readable
    from ....converters.recordings.time_order import TimeOrder

_ONCE = "a pipe is taken as it comes, once: write it to a file and replay that"


def is_pipe(file: Path) -> bool:
    """Whether rows come from standard input or a named pipe."""
    return file == Path("-") or file.is_fifo()


def existing(file: Path) -> Path:
    """Raise ``typer.BadParameter`` for a missing file, or a folder that is no bag. Typer treats
    ``-`` as a missing file."""
    if not is_pipe(file) and not file.exists():
        raise typer.BadParameter(f"file {str(file)!r} does not exist.")
    if file.is_dir():
        from ....converters.recordings.many_streams import is_log

        if not is_log(file):
            raise typer.BadParameter(
                f"{str(file)!r} is a folder, and no bag of ROS 2 with a metadata.yaml: name a file"
            )
    return file


@contextmanager
def reading(file: Path) -> Iterator[Readable]:
    """Open a pipe for reading bytes."""
    if file == Path("-"):
        yield typer.get_binary_stream("stdin")  # type: ignore[misc]
        return
    with file.open("rb") as pipe:
        yield pipe


def check_once(file: Path, *, sort: bool | None, loop: bool) -> None:
    """Raise ``typer.BadParameter`` for options that need all rows of a pipe before the first is
    sent, or a second time."""
    if not is_pipe(file):
        return
    if sort:
        raise typer.BadParameter(f"--sort needs all rows before the first is sent; {_ONCE}")
    if loop:
        raise typer.BadParameter(f"--loop plays a recording again; {_ONCE}")


def show_piped(name: str, piped: Piped) -> TimeOrder:
    """Report the rows that were out of order, after the last row."""
    from ....converters.recordings.time_order import TimeOrder

    if piped.note is not None:
        err().print(f"{name}: {piped.note}", markup=False, highlight=False)
    return TimeOrder(piped.recording, piped.out_of_order)
