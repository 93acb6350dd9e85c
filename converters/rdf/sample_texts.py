"""Timed triples of samples as N-Triples, column by column: a text for each sample.

Called by `engine/requests/sample_rdf`, for messages of event streams and for histories.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...rdf.dictionary import Ids, TermDictionary
from ...rdf.timed import DATATYPES, Kind, ObjectColumn, TimedTriples, column_texts
from ...streams.sample import Times


def sample_texts(triples: TimedTriples, count: int) -> list[str]:
    """The N-Triples of each of ``count`` samples, in lines; an empty text where there are none. τ
    is the number of the sample, from 0.

    Law (tests/laws/converters/test_sample_texts.py): those of the triples, written one by one.
    Cost: some 0.6 µs a triple, and 0.3 µs more where not each sample has one of each feature.
    """
    parts = list(_lines(triples))
    all_samples = np.arange(count)
    if parts and all(np.array_equal(samples, all_samples) for samples, _ in parts):
        return list(map("\n".join, zip(*(lines for _, lines in parts), strict=True)))
    found: list[list[str]] = [[] for _ in range(count)]
    for samples, lines in parts:
        for sample, line in zip(samples.tolist(), lines, strict=True):
            found[sample].append(line)
    return ["\n".join(each) for each in found]


def _lines(triples: TimedTriples) -> Iterator[tuple[Times, list[str]]]:
    """Of each table and predicate the numbers of the triples' samples, and the lines."""
    dictionary = triples.dictionary
    for table in triples.tables:
        subjects = _term_texts(table.subject, dictionary)
        for predicate, column in table.objects.items():
            named, samples = subjects, table.time
            if column.null is not None:
                present = np.flatnonzero(column.present)
                column, samples = column.take(present), samples[present]
                named = [subjects[row] for row in present.tolist()]
            form = _form(str(dictionary.term(predicate)), column.kind)
            pairs = zip(named, _object_texts(column, dictionary), strict=True)
            yield samples, list(map(form.__mod__, pairs))


def _form(predicate: str, kind: Kind) -> str:
    """The line of a triple, without its subject and the text of its object."""
    named = predicate.replace("%", "%%")
    return f"%s {named} %s ." if kind is Kind.TERM else f'%s {named} "%s"^^{DATATYPES[kind]} .'


def _object_texts(column: ObjectColumn, dictionary: TermDictionary) -> list[str]:
    if column.kind is Kind.TERM:
        return _term_texts(column.values, dictionary)
    return column_texts(column.kind, column.values)


def _term_texts(ids: Ids, dictionary: TermDictionary) -> list[str]:
    return list(map(str, map(dictionary.term, ids.tolist())))
