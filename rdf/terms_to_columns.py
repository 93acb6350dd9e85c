"""Many terms to columns at once: the kinds and values that `timed.split_term` gives one by one.

Python runs a few calls a term here, each a loop in C (`map`): to read a literal's datatype costs
most. msgspec parses the numbers of a batch, and spells them again; a number whose shortest digits
are its own text is canonical. Everything else is decided term by term (`split_term`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from operator import attrgetter, itemgetter
from typing import Any, Final, TypeAlias

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray
from pyoxigraph import BlankNode, Literal, NamedNode

from ..streams.sample import Times
from .dictionary import Term, TermDictionary
from .timed import DATATYPES, Kind, ObjectColumn, TimedTriples, TripleRows, split_term

_SMALL, _LARGE = 1e-4, 1e15
"""Between them the shortest digits of a float64 are written without an exponent."""


class _Kinds(dict[NamedNode, int]):
    """The kind of the literals of a datatype; `TERM` for all that are no numbers or booleans."""

    def __missing__(self, datatype: NamedNode) -> int:
        return Kind.TERM


_KINDS: Final = _Kinds({datatype: int(kind) for kind, datatype in DATATYPES.items()})
_FLOATS: Final = (Kind.DECIMAL, Kind.FLOAT, Kind.DOUBLE)
_PLACES: Final[tuple[Callable[[Any], Any], ...]] = tuple(map(itemgetter, range(4)))
_datatype: Final[Callable[[Any], NamedNode]] = attrgetter("datatype")
_text: Final[Callable[[Any], str]] = attrgetter("value")


TermColumns: TypeAlias = tuple[Sequence[int], Sequence[Term], Sequence[NamedNode], Sequence[Term]]
"""Times, subjects, predicates and objects of triples; all have one length."""


def from_terms(
    triples: Iterable[tuple[int, Term, NamedNode, Term]],
    dictionary: TermDictionary,
    valid: Sequence[int] | None = None,
) -> TimedTriples:
    """Make columns from ``(τ, subject, predicate, object)``; valid time is τ unless given.

    There is a table for each pair of predicate and kind of object, in the order given. Numeric and
    boolean literals in canonical form become numbers. Other literals stay terms, so that iterating
    yields equal triples.
    """
    columns = columns_of(tuple(triples))
    if not columns[0]:
        return TimedTriples(dictionary, ())
    return from_term_columns(columns, dictionary, valid)


def columns_of(triples: Sequence[tuple[int, Term, NamedNode, Term]]) -> TermColumns:
    """Turn rows into columns."""
    # `zip` makes an object for the collector of each row: ten times the cost.
    times, subjects, predicates, objects = (list(map(get, triples)) for get in _PLACES)
    return times, subjects, predicates, objects


def from_term_columns(
    triples: TermColumns, dictionary: TermDictionary, valid: Sequence[int] | None = None
) -> TimedTriples:
    """Make columns from columns of terms, of one triple at least; see `from_terms`."""
    times, subjects, predicates, objects = triples
    time = np.array(times, np.int64)
    valid_time = time if valid is None else np.array(valid, np.int64)
    kinds, bits = split_terms(objects, dictionary)
    predicate = dictionary.transient_ids(predicates)
    subject = dictionary.transient_ids(subjects)
    keys = predicate.astype(np.int64) * len(Kind) + kinds
    tables = []
    for key, rows in _groups(keys):
        id, kind = divmod(key, len(Kind))
        column = ObjectColumn(Kind(kind), _values(Kind(kind), bits[rows]))
        tables.append(TripleRows(time[rows], valid_time[rows], subject[rows], {id: column}))
    return TimedTriples(dictionary, tuple(tables))


def split_terms(
    terms: Sequence[Term], dictionary: TermDictionary
) -> tuple[NDArray[np.int8], NDArray[np.int64]]:
    """Return the kind of each term and its value in 64 bits: a float64, or an integer (of a
    `TERM` its transient id). Both have shape ``(n,)``. Law: `split_term` of each term.
    """
    kinds = np.zeros(len(terms), np.int8)
    bits = np.empty(len(terms), np.int64)
    types = set(map(type, terms))
    if types == {Literal}:
        kinds[:] = np.fromiter(map(_KINDS.__getitem__, map(_datatype, terms)), np.int8, len(terms))
    elif not types <= {NamedNode, BlankNode}:
        for row, term in enumerate(terms):
            if isinstance(term, Literal):
                kinds[row] = _KINDS[term.datatype]
    for kind in map(Kind, np.unique(kinds[kinds > 0]).tolist()):
        rows = np.flatnonzero(kinds == kind)
        values, are_canonical = _parse(kind, list(map(_text, _at(terms, rows))))
        bits[rows] = values
        for row in rows[~are_canonical].tolist():
            kinds[row], value = split_term(terms[row], dictionary.transient_id)
            bits[row] = _bits(Kind(kinds[row]), value)
    rest = np.flatnonzero(kinds == Kind.TERM)
    bits[rest] = dictionary.transient_ids(_at(terms, rest))
    return kinds, bits


def _groups(keys: NDArray[np.int64]) -> list[tuple[int, NDArray[Any] | slice]]:
    """The distinct keys in the order in which they come, each with its rows."""
    if np.all(keys == keys[0]):
        return [(int(keys[0]), slice(None))]
    distinct, first = np.unique(keys, return_index=True)
    return [(int(key), np.flatnonzero(keys == key)) for key in distinct[np.argsort(first)]]


def _at(terms: Sequence[Term], rows: NDArray[Any]) -> Sequence[Term]:
    return terms if len(rows) == len(terms) else [terms[row] for row in rows.tolist()]


def _values(kind: Kind, bits: NDArray[np.int64]) -> NDArray[Any]:
    return bits.view(np.float64) if kind in _FLOATS else bits.astype(kind.dtype)


def _bits(kind: Kind, value: Any) -> int:
    return int(np.float64(value).view(np.int64)) if kind in _FLOATS else int(value)


def _parse(kind: Kind, texts: list[str]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return values in 64 bits, and where they are sure to be those of a canonical text; elsewhere
    they mean nothing."""
    unknown = np.zeros(len(texts), np.int64), np.zeros(len(texts), np.bool_)
    if kind is Kind.BOOLEAN:
        truths = np.array([{"false": 0, "true": 1}.get(text, -1) for text in texts], np.int64)
        return truths, truths >= 0
    joined = f"[{','.join(texts)}]".encode()
    kind_of_list = list[float] if kind in _FLOATS else list[int]
    try:
        numbers: list[Any] = msgspec.json.decode(joined, type=kind_of_list)
    except msgspec.MsgspecError:
        return unknown
    if len(numbers) != len(texts):
        return unknown
    spelled = msgspec.json.encode(numbers)[1:-1].decode().split(",")
    if kind is Kind.INTEGER:
        same = np.array([a == b for a, b in zip(spelled, texts, strict=True)], np.bool_)
        in_range = [-(2**63) <= number < 2**63 for number in numbers]
        same &= np.array(in_range, np.bool_)
        return np.array([n if s else 0 for n, s in zip(numbers, same, strict=True)], np.int64), same
    values = np.array(numbers, np.float64)
    whole = values == np.trunc(values)
    same = np.array([a == b for a, b in zip(spelled, texts, strict=True)], np.bool_)
    for row in np.flatnonzero(whole).tolist():
        # XSD's canonical text of a whole number has no fraction; that of JSON has ".0".
        same[row] = spelled[row] == texts[row] + ".0"
    size = np.abs(values)
    return values.view(np.int64), same & (size >= _SMALL) & (size < _LARGE)


def timed_triples(
    time: ArrayLike,
    subject: Sequence[Term | str],
    objects: Mapping[str | NamedNode, Any],
    *,
    terms_of: TimedTriples | None = None,
) -> TimedTriples:
    """Make triples from a table, for `dyknow.evaluate`: each row is a subject at a time, each
    column of ``objects`` has the objects of one predicate. All have shape ``(n,)``.

    ``time``: integers in ns since 1970, or datetime64. ``subject``: terms, or IRIs as texts.
    ``objects``: by predicate (an IRI) an array of floats (xsd:double), integers or booleans, or a
    sequence of terms and texts (literals). None, and what is masked in a masked array, is no
    triple. ``terms_of`` shares the terms of another batch: the streams of one query should, or one
    of them is converted term by term.

    Raises ``ValueError`` for columns of different lengths, ``TypeError`` for other values.
    """
    dictionary = TermDictionary() if terms_of is None else terms_of.dictionary
    times = _times(time)
    lengths = {"time": len(times), "subject": len(subject)}
    lengths |= {str(predicate): len(column) for predicate, column in objects.items()}
    if len(set(lengths.values())) > 1:
        raise ValueError(f"columns of different lengths: {lengths}")
    ids = {each: dictionary.transient_id(_node(each)) for each in dict.fromkeys(subject)}
    subjects = np.fromiter(map(ids.__getitem__, subject), np.int32, len(subject))
    tables = []
    for name, column in objects.items():
        predicate = dictionary.transient_id(NamedNode(name) if isinstance(name, str) else name)
        for rows, made in _object_columns(column, dictionary):
            tables.append(TripleRows(times[rows], times[rows], subjects[rows], {predicate: made}))
    return TimedTriples(dictionary, tuple(tables))


def _node(subject: Term | str) -> NamedNode | BlankNode:
    if isinstance(subject, str):
        return NamedNode(subject)
    if isinstance(subject, NamedNode | BlankNode):
        return subject
    kind = type(subject).__name__
    raise TypeError(f"a subject is a NamedNode, a BlankNode or an IRI, not {kind}")


def _times(time: ArrayLike) -> Times:
    times = np.asarray(time)
    if times.dtype.kind == "M":
        return times.astype("datetime64[ns]").astype(np.int64)
    if times.dtype.kind not in "iu" and len(times):
        raise TypeError(f"a time is an integer in ns or a datetime64, not {times.dtype}")
    return times.astype(np.int64)


def _object_columns(
    column: Any, dictionary: TermDictionary
) -> Iterator[tuple[NDArray[Any], ObjectColumn]]:
    """Each kind of object in a column: its rows, and their objects."""
    values = _array(column)
    is_masked = isinstance(values, np.ma.MaskedArray)
    present = ~np.ma.getmaskarray(values) if is_masked else np.ones(len(values), np.bool_)
    kind = {"f": Kind.DOUBLE, "i": Kind.INTEGER, "b": Kind.BOOLEAN}.get(values.dtype.kind)
    if kind is not None:
        rows = np.flatnonzero(present)
        yield rows, ObjectColumn(kind, np.asarray(values)[rows].astype(kind.dtype))
        return
    listed = values.tolist()
    rows = np.array([row for row in np.flatnonzero(present) if listed[row] is not None], np.int64)
    terms = [_object(listed[row]) for row in rows.tolist()]
    if terms:
        kinds, bits = split_terms(terms, dictionary)
        for key, places in _groups(kinds.astype(np.int64)):
            yield rows[places], ObjectColumn(Kind(key), _values(Kind(key), bits[places]))


def _array(column: Any) -> NDArray[Any]:
    """The column as an array; a sequence of several types as one of objects."""
    if hasattr(column, "__array__") or len(set(map(type, column))) == 1:
        return column if isinstance(column, np.ndarray) else np.asarray(column)
    found = np.empty(len(column), object)
    found[:] = column
    return found


def _object(value: Any) -> Term:
    if isinstance(value, NamedNode | BlankNode | Literal):
        return value
    if isinstance(value, str | bool | int | float):
        return Literal(value)
    raise TypeError(f"an object is a term, a text, a number or a boolean, not {value!r}")
