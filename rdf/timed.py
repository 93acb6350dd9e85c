"""Timed triples in columns ([Events14 §III-V]: ⟨subj, pred, obj⟩ at τ, with a valid time).

Samples travel as *wide rows*: one subject at one time with an object for each of several
predicates. A row with k objects stands for k triples. A plain list of triples is the special case
of one predicate for each table.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Final, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray
from pyoxigraph import Literal, NamedNode

from ..streams.sample import Mask, Times
from .dictionary import Ids, Term, TermDictionary
from .namespaces import XSD


class Kind(IntEnum):
    """The kind of objects that a column holds.

    Numbers stay numbers: ``INTEGER`` is int64; ``DOUBLE``, ``FLOAT`` and ``DECIMAL`` are float64;
    ``BOOLEAN`` is bool. The text of a decimal is the shortest one that parses to the same float64.
    Everything else is ``TERM``: int32 ids of the dictionary. A column of mixed kinds is a ``TERM``
    column.
    """

    TERM = 0
    INTEGER = 1
    DECIMAL = 2
    FLOAT = 3
    DOUBLE = 4
    BOOLEAN = 5

    @property
    def is_number(self) -> bool:
        return 1 <= self <= 4  # INTEGER … DOUBLE

    @property
    def dtype(self) -> np.dtype[Any]:
        """The numpy type of the column's values."""
        return _DTYPES[self]


_DTYPES: dict[Kind, np.dtype[Any]] = {
    Kind.TERM: np.dtype(np.int32),
    Kind.INTEGER: np.dtype(np.int64),
    Kind.DECIMAL: np.dtype(np.float64),
    Kind.FLOAT: np.dtype(np.float64),
    Kind.DOUBLE: np.dtype(np.float64),
    Kind.BOOLEAN: np.dtype(np.bool_),
}

DATATYPES: dict[Kind, NamedNode] = {
    Kind.INTEGER: NamedNode(XSD + "integer"),
    Kind.DECIMAL: NamedNode(XSD + "decimal"),
    Kind.FLOAT: NamedNode(XSD + "float"),
    Kind.DOUBLE: NamedNode(XSD + "double"),
    Kind.BOOLEAN: NamedNode(XSD + "boolean"),
}


@dataclass(frozen=True, slots=True, eq=False)
class ObjectColumn:
    """Objects of one predicate: values of ``kind.dtype``, shape ``(n,)``.

    ``null`` marks the rows without such a triple; None means that every row has one.
    """

    kind: Kind
    values: NDArray[Any]
    null: Mask | None = None

    def __len__(self) -> int:
        return len(self.values)

    @property
    def present(self) -> Mask:
        """True where the row has the triple, shape ``(n,)``."""
        return np.ones(len(self.values), np.bool_) if self.null is None else ~self.null

    def take(self, rows: NDArray[Any] | slice) -> ObjectColumn:
        """Return the column at ``rows`` (a mask, indices or a slice)."""
        null = None if self.null is None else self.null[rows]
        return ObjectColumn(self.kind, self.values[rows], null)

    @property
    def held_ids(self) -> NDArray[Any]:
        """The ids of its terms, in any order, without null rows."""
        if self.kind is not Kind.TERM:
            return self.values[:0]
        return self.values if self.null is None else self.values[~self.null]

    def term_at(self, row: int, dictionary: TermDictionary) -> Term:
        """Return the object at ``row`` as an RDF term. The row must have one."""
        return make_term(self.kind, self.values[row], dictionary)


@dataclass(frozen=True, slots=True, eq=False)
class TripleRows:
    """Wide rows: ``time`` τ and ``valid`` in ns, ``subject`` ids, objects by predicate id.

    All have shape ``(n,)``. ``sort`` is the id of a sort that every subject belongs to by the
    annotation (``every UAV``), or None. Slicing makes views.
    """

    time: Times
    valid: Times
    subject: Ids
    objects: Mapping[int, ObjectColumn]
    sort: int | None = None

    def __len__(self) -> int:
        return len(self.time)

    @property
    def triples(self) -> int:
        """The number of triples that the rows stand for."""
        nulls = [column.null for column in self.objects.values()]
        absent = sum(int(np.count_nonzero(null)) for null in nulls if null is not None)
        return len(self) * len(nulls) - absent

    def held_ids(self) -> Iterator[NDArray[Any] | Sequence[int]]:
        """Return the ids of its terms (`dictionary.Holder`)."""
        yield self.subject
        yield list(self.objects) if self.sort is None else [*self.objects, self.sort]
        for column in self.objects.values():
            yield column.held_ids

    def take(self, rows: NDArray[Any] | slice) -> TripleRows:
        """Return the rows at ``rows`` (a mask, indices or a slice), in that order."""
        objects = {predicate: column.take(rows) for predicate, column in self.objects.items()}
        return TripleRows(self.time[rows], self.valid[rows], self.subject[rows], objects, self.sort)


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class TimedTriples:
    """A bag of timed triples: tables of wide rows over one dictionary.

    Rows of a table are in any order of τ, unless its maker documents one. The object holds its
    terms in the dictionary as long as it lives; bare tables do not.
    """

    dictionary: TermDictionary
    tables: tuple[TripleRows, ...]

    def __post_init__(self) -> None:
        self.dictionary.hold(self)

    def held_ids(self) -> Iterator[NDArray[Any] | Sequence[int]]:
        """See `dictionary.Holder`."""
        for table in self.tables:
            yield from table.held_ids()

    def __len__(self) -> int:
        """Return the number of triples."""
        return sum(table.triples for table in self.tables)

    def __iter__(self) -> Iterator[tuple[int, Term, NamedNode, Term]]:
        """Yield ``(τ, subject, predicate, object)`` one by one: for edges and tests."""
        for time, _, subject, predicate, object in self.with_valid():
            yield time, subject, predicate, object

    def with_valid(self) -> Iterator[tuple[int, int, Term, NamedNode, Term]]:
        """Yield ``(τ, valid, subject, predicate, object)`` one by one: for edges and tests."""
        for table in self.tables:
            for predicate, column in table.objects.items():
                predicate_term = self.dictionary.term(predicate)
                assert isinstance(predicate_term, NamedNode)
                for row in np.flatnonzero(column.present).tolist():
                    yield (
                        int(table.time[row]),
                        int(table.valid[row]),
                        self.dictionary.term(int(table.subject[row])),
                        predicate_term,
                        column.term_at(row, self.dictionary),
                    )


Intern: TypeAlias = Callable[[Term], int]
"""Returns the id of a term: `TermDictionary.id` or `TermDictionary.transient_id`."""


def split_term(term: Term, intern: Intern) -> tuple[Kind, Any]:
    """Return how a column holds ``term``: a kind and a value of its dtype.

    A literal becomes a number only if `make_literal` gives the equal literal back.
    """
    if isinstance(term, Literal):
        kind = _KIND_OF.get(term.datatype.value)
        if kind is not None:
            value = _parse(kind, term.value)
            if value is not None and make_literal(kind, value) == term:
                return kind, value
    return Kind.TERM, intern(term)


def make_term(kind: Kind, value: Any, dictionary: TermDictionary) -> Term:
    """Return the RDF term for a ``value`` of a column of ``kind``, numbers in canonical form."""
    return dictionary.term(int(value)) if kind is Kind.TERM else make_literal(kind, value)


def make_literal(kind: Kind, value: Any) -> Literal:
    """Return a number or boolean as a literal in canonical form."""
    if kind is Kind.INTEGER:
        return Literal(str(int(value)), datatype=DATATYPES[kind])
    if kind is Kind.BOOLEAN:
        return Literal("true" if value else "false", datatype=DATATYPES[kind])
    return Literal(number_text(kind, float(value)), datatype=DATATYPES[kind])


_KIND_OF = {datatype.value: kind for kind, datatype in DATATYPES.items()}


def _parse(kind: Kind, text: str) -> Any:
    if kind is Kind.BOOLEAN:
        return {"true": True, "false": False}.get(text)
    try:
        value = int(text) if kind is Kind.INTEGER else float(text)
    except ValueError:
        return None
    if kind is Kind.INTEGER and not -(2**63) <= value < 2**63:
        return None
    if kind is Kind.DECIMAL and not np.isfinite(value):
        return None
    return value


def number_text(kind: Kind, value: float) -> str:
    """Return the XSD text of a float64: the shortest digits that parse back to the same value."""
    if np.isnan(value):
        return "NaN"
    if np.isinf(value):
        return "INF" if value > 0 else "-INF"
    if kind is Kind.DECIMAL:
        # XSD decimals have no -0: adding 0.0 removes the sign.
        text = np.format_float_positional(value + 0.0, trim="-")
        return text.removesuffix(".")
    text = repr(value)
    if "e" in text:
        mantissa, exponent = text.split("e")
        return f"{mantissa}E{int(exponent)}"
    return text.removesuffix(".0")


_POSITIONAL: Final = 1e-4, 1e16
"""Python writes numbers from here, and less than here, without an exponent."""
_LONG: Final = 16
"""The fewest values for which operations on whole columns pay."""
_JSON: Final = msgspec.json.Encoder()


def column_texts(kind: Kind, values: NDArray[Any]) -> list[str]:
    """Return the XSD texts of a column of numbers or booleans.

    Law (tests/laws/converters): those of `make_literal`, one by one. Cost: 0.06 µs a value; 0.2 µs
    in short columns and in those with a number that is next to 0, large or not finite.
    """
    if kind is Kind.BOOLEAN:
        return ["true" if value else "false" for value in values.tolist()]
    if kind is Kind.INTEGER:
        return list(map(str, values.tolist()))
    least, most = _POSITIONAL
    if len(values) >= _LONG:
        size = np.abs(values)
        if bool(((size >= least) & (size < most)).all()):
            # msgspec writes the digits of `repr`, and a column at once.
            lines = _JSON.encode_lines(values.tolist()).decode()
            return lines.replace(".0\n", "\n").split("\n")[:-1]
    return [
        repr(value).removesuffix(".0") if least <= abs(value) < most else number_text(kind, value)
        for value in values.tolist()
    ]
