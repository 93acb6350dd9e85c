"""Timed triples of samples as N-Triples, column by column: a text for each sample.

Called by `engine/requests/sample_rdf`, for messages of event streams and for histories.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ...rdf.dictionary import TermDictionary
from ...rdf.timed import DATATYPES, Kind, ObjectColumn, TimedTriples, column_texts


def sample_texts(triples: TimedTriples, count: int) -> list[str]:
    """The N-Triples of each of ``count`` samples, in lines; an empty text where there are none. τ
    is the number of the sample, from 0.

    Law (tests/laws/converters/test_sample_texts.py): those of the triples, written one by one.
    Cost: about 0.3 µs a triple, and a text for each distinct term.
    """
    lines: list[list[str]] = [[] for _ in range(count)]
    terms = _TermTexts(triples.dictionary)
    for table in triples.tables:
        subjects, samples = terms.of(table.subject.tolist()), table.time.tolist()
        for predicate, column in table.objects.items():
            named, rows = subjects, samples
            if column.null is not None:
                present = np.flatnonzero(column.present)
                column, rows = column.take(present), table.time[present].tolist()
                named = [subjects[row] for row in present.tolist()]
            form = _form(terms[predicate], column)
            for row, pair in zip(
                rows, zip(named, _objects(column, terms), strict=True), strict=True
            ):
                lines[row].append(form % pair)
    return ["\n".join(each) for each in lines]


class _TermTexts(dict[int, str]):
    """N-Triples of terms by their ids, each written once."""

    def __init__(self, dictionary: TermDictionary) -> None:
        super().__init__()
        self._dictionary = dictionary

    def __missing__(self, id: int) -> str:
        text = self[id] = str(self._dictionary.term(id))
        return text

    def of(self, ids: Iterable[int]) -> list[str]:
        return list(map(self.__getitem__, ids))


def _form(predicate: str, column: ObjectColumn) -> str:
    """The line of a triple, without its subject and the text of its object."""
    named = predicate.replace("%", "%%")
    if column.kind is Kind.TERM:
        return f"%s {named} %s ."
    return f'%s {named} "%s"^^{DATATYPES[column.kind]} .'


def _objects(column: ObjectColumn, terms: _TermTexts) -> list[str]:
    if column.kind is Kind.TERM:
        return terms.of(column.values.tolist())
    return column_texts(column.kind, column.values)
