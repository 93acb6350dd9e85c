"""Timed triples of samples as N-Triples, column by column: a text for each sample.

Called by `engine/requests/sample_rdf`, for messages of event streams and for histories.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ...rdf.timed import DATATYPES, Kind, TimedTriples, column_texts
from ...streams.sample import Times
from ..term_tables import TermTexts


def sample_texts(triples: TimedTriples, count: int, texts: TermTexts) -> list[str]:
    """The N-Triples of each of ``count`` samples, in lines; an empty text where there are none. τ
    is the number of the sample, from 0. ``texts``: those of the triples' dictionary.

    Law (tests/laws/converters/test_sample_texts.py): those of the triples, written one by one.
    Cost: some 0.3 µs a triple, and 0.4 µs more where not each sample has one of each feature.
    """
    lines = list(_lines(triples, texts))
    samples = np.arange(count)
    if lines and all(np.array_equal(each.samples, samples) for each in lines):
        # Each sample has each line: its text is made at once.
        form = "\n".join(each.form for each in lines)
        cells = [column for each in lines for column in (each.subjects, each.objects)]
        return list(map(form.__mod__, zip(*cells, strict=True)))
    found: list[list[str]] = [[] for _ in range(count)]
    for each in lines:
        pairs = zip(each.subjects, each.objects, strict=True)
        for sample, line in zip(each.samples.tolist(), map(each.form.__mod__, pairs), strict=True):
            found[sample].append(line)
    return ["\n".join(each) for each in found]


class _Lines(NamedTuple):
    """Triples of one predicate: of each the number of its sample, and the texts of its subject and
    object, which ``form`` makes a line of."""

    samples: Times
    form: str
    subjects: Sequence[str]
    objects: Sequence[str]


def _lines(triples: TimedTriples, texts: TermTexts) -> Iterator[_Lines]:
    for table in triples.tables:
        subjects = texts.of_ids(table.subject)
        for predicate, column in table.objects.items():
            named, samples = subjects, table.time
            if column.null is not None:
                present = np.flatnonzero(column.present)
                column, samples = column.take(present), samples[present]
                named = [subjects[row] for row in present.tolist()]
            objects = (
                texts.of_ids(column.values)
                if column.kind is Kind.TERM
                else column_texts(column.kind, column.values)
            )
            form = _form(str(triples.dictionary.term(predicate)), column.kind)
            yield _Lines(samples, form, named, objects)


def _form(predicate: str, kind: Kind) -> str:
    """The line of a triple, without its subject and the text of its object."""
    named = predicate.replace("%", "%%")
    return f"%s {named} %s ." if kind is Kind.TERM else f'%s {named} "%s"^^{DATATYPES[kind]} .'
