"""Results as tables: of SPARQL in a notebook, of samples in pandas."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from html import escape
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pandas import DataFrame

MOST_ROWS = 200
"""Rows that a notebook shows; the result has all of them."""
TIMES = ("valid", "available")


class SparqlResult(dict[str, Any]):
    """The SPARQL JSON of a SELECT or ASK, which Jupyter shows as a table."""

    def _repr_html_(self) -> str:
        if "boolean" in self:
            return f"<p>{str(self['boolean']).lower()}</p>"
        names = self["head"]["vars"]
        rows = self["results"]["bindings"]
        head = "".join(f"<th>{escape(name)}</th>" for name in names)
        body = "".join(_html_row(row, names) for row in rows[:MOST_ROWS])
        more = len(rows) - MOST_ROWS
        foot = f"<p>and {more} more rows</p>" if more > 0 else ""
        return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{foot}"


def _html_row(row: Mapping[str, Mapping[str, str]], names: Sequence[str]) -> str:
    # An unbound variable has an empty cell.
    texts = (row[name]["value"] if name in row else "" for name in names)
    return f"<tr>{''.join(f'<td>{escape(text)}</td>' for text in texts)}</tr>"


def samples_frame(samples: Sequence[Mapping[str, Any]], *, with_stream: bool) -> DataFrame:
    """Return the data of sample messages as a DataFrame: ``stream``, times in UTC, fields."""
    pandas = import_pandas()
    frame = pandas.DataFrame(list(_rows(samples, with_stream)))
    for name in TIMES:
        if name in frame:
            frame[name] = pandas.to_datetime(frame[name], utc=True, format="ISO8601")
    return frame


def _rows(samples: Sequence[Mapping[str, Any]], with_stream: bool) -> Iterator[dict[str, Any]]:
    for sample in samples:
        stream = {"stream": sample["stream"]} if with_stream else {}
        yield stream | {name: sample[name] for name in TIMES} | sample["values"]


def import_pandas() -> ModuleType:
    """Import pandas. Raises ``ModuleNotFoundError`` with the command that installs it."""
    try:
        import pandas
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "pandas is not installed: pip install 'dyknow[pandas]'", name="pandas"
        ) from error
    found: ModuleType = pandas
    return found
