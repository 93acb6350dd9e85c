"""Results as tables: of SPARQL in a notebook, of samples in pandas."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
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
        rows = self["results"]["bindings"]
        texts = [{name: term["value"] for name, term in row.items()} for row in rows[:MOST_ROWS]]
        return _html_table(self["head"]["vars"], texts, len(rows))


class History(list[dict[str, Any]]):
    """Samples of a stream's history, which Jupyter shows as a table."""

    def _repr_html_(self) -> str:
        shown = self[:MOST_ROWS]
        return _html_table(
            list(dict.fromkeys(name for row in shown for name in row)), shown, len(self)
        )

    def to_pandas(self) -> DataFrame:
        """Return them as a DataFrame; ``valid`` and ``available`` are in UTC. Needs
        dyknow[pandas]."""
        return _frame(self)


def _html_table(names: Sequence[str], rows: Sequence[Mapping[str, Any]], count: int) -> str:
    """The first ``rows`` of ``count``."""
    head = "".join(f"<th>{escape(name)}</th>" for name in names)
    body = "".join(f"<tr>{''.join(_cell(row.get(name)) for name in names)}</tr>" for row in rows)
    more = count - len(rows)
    foot = f"<p>and {more} more rows</p>" if more > 0 else ""
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{foot}"


def _cell(value: object) -> str:
    """An unbound variable and a missing value have an empty cell."""
    return f"<td>{'' if value is None else escape(str(value))}</td>"


def samples_frame(samples: Sequence[Mapping[str, Any]], *, with_stream: bool) -> DataFrame:
    """Return the data of sample messages as a DataFrame: ``stream``, times in UTC, fields."""
    return _frame(_rows(samples, with_stream))


def _frame(rows: Iterable[Mapping[str, Any]]) -> DataFrame:
    pandas = import_pandas()
    frame = pandas.DataFrame(list(rows))
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
