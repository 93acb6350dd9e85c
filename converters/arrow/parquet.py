"""Parquet files as Arrow tables, for recordings. Read by pyarrow."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..errors import WireError
from .stream import failures, pyarrow_module


def read_parquet(path: Path) -> Any:
    """The table of a Parquet file. Raises `WireError` for a file that is none or is damaged.

    Memory: the whole table.
    """
    pa = pyarrow_module()
    import pyarrow.parquet

    try:
        with path.open("rb") as file:
            table = pyarrow.parquet.ParquetFile(file).read()
        table.validate(full=True)
    except failures(pa) as error:
        raise WireError(None, f"{path.name}: this is no Parquet file: {error}") from None
    return table
