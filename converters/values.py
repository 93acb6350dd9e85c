"""Values of a field <-> objects of a predicate, column by column ([Events14 §V.A]).

`object_column` compiles a field's type and a feature's range to a function of columns;
`field_column` reads objects of any kind back into a field.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final, TypeAlias, assert_never

import numpy as np
from numpy.typing import NDArray
from pyoxigraph import Literal, NamedNode

from ..ontology.units import Conversion
from ..rdf.datatypes import range_type
from ..rdf.dictionary import Term, TermDictionary
from ..rdf.namespaces import OWL, RDF, RDFS, XSD
from ..rdf.timed import Kind, ObjectColumn, make_term
from ..streams.sample import Column, Field, FieldType, Mask
from ..streams.string_pool import StringPool
from ..streams.time import format_time, parse_time
from .errors import ConversionError
from .objects import ObjectTable, object_name
from .term_tables import PoolTable

ToObjects: TypeAlias = Callable[[Column], ObjectColumn]

_FLOAT_KINDS: Final = {
    XSD + "double": Kind.DOUBLE,
    XSD + "float": Kind.FLOAT,
    XSD + "decimal": Kind.DECIMAL,
}
_INTEGERS: Final[dict[str, tuple[int, int]]] = {
    "long": (-(2**63), 2**63 - 1),
    "int": (-(2**31), 2**31 - 1),
    "short": (-(2**15), 2**15 - 1),
    "byte": (-(2**7), 2**7 - 1),
    "nonNegativeInteger": (0, 2**63 - 1),
    "positiveInteger": (1, 2**63 - 1),
    "nonPositiveInteger": (-(2**63), 0),
    "negativeInteger": (-(2**63), -1),
    "unsignedLong": (0, 2**63 - 1),
    "unsignedInt": (0, 2**32 - 1),
    "unsignedShort": (0, 2**16 - 1),
    "unsignedByte": (0, 2**8 - 1),
}
"""Datatypes derived from xsd:integer with their bounds within 64 bits. Their literals are terms,
which keep the datatype."""
_EXACT = 2**53
_SHOWN: Final = 100
"""Characters of a term in a message."""


def field_type(range: str | None, kind: Kind | None = None) -> FieldType:
    """The type of a field for a predicate's objects: by the ``kind`` of their column if given, else
    by the feature's range, else text."""
    match kind:
        case Kind.INTEGER:
            return FieldType.INTEGER
        case Kind.BOOLEAN:
            return FieldType.BOOLEAN
        case Kind.DOUBLE | Kind.FLOAT | Kind.DECIMAL:
            return FieldType.FLOAT
        case Kind.TERM | None:
            pass
        case _:
            assert_never(kind)
    return range_type(range)


def object_column(
    field: Field,
    range: str | None,
    conversion: Conversion,
    names: ObjectTable,
    dictionary: TermDictionary,
) -> ToObjects:
    """Compile the conversion of values of ``field`` to objects of a feature's ``rdfs:range``.

    ``range`` is the IRI of a datatype or of a class (objects are named like subjects), or None (the
    field's type decides). ``conversion`` applies to numbers. Raises `ConversionError` if the field
    cannot hold such objects; the returned function raises it with the row of a bad value.
    """
    if range is None or range == RDFS + "Literal":
        range = _natural_range(field.type)
    numeric = field.type in (FieldType.FLOAT, FieldType.INTEGER)
    if range in _FLOAT_KINDS and numeric:
        return _to_floats(field, _FLOAT_KINDS[range], conversion)
    if not conversion.is_identity:
        raise ConversionError(
            f"field {field.name!r} cannot change its unit: its feature's range is {_short(range)}",
            field=field.name,
            hint="give the feature the range xsd:double, or ask for it in the stream's own unit",
        )
    local = range.removeprefix(XSD) if range.startswith(XSD) else None
    if local == "integer" and numeric:
        return _to_integers(field)
    if local in _INTEGERS and numeric:
        return _to_literals(_to_integers(field), range, _INTEGERS[local], dictionary, field)
    if local == "boolean" and field.type is FieldType.BOOLEAN:
        return lambda column: ObjectColumn(Kind.BOOLEAN, column.values, column.null)
    if local == "dateTime" and field.type is FieldType.INTEGER:
        return _distinct(
            field, lambda time: Literal(format_time(time), datatype=_DATE_TIME), dictionary
        )
    if local is not None and local not in _NOT_TEXT and field.type is FieldType.STRING:
        datatype = NamedNode(range)
        intern = dictionary.transient_id
        table = PoolTable(lambda text: intern(Literal(text, datatype=datatype)), dictionary)
        return lambda column: ObjectColumn(
            Kind.TERM, table.of_codes(_filled(column), _pool(column)), column.null
        )
    if local == "string" and field.type is FieldType.INTEGER:
        return _distinct(field, lambda value: Literal(str(value)), dictionary)
    if local is None and not range.startswith(RDF) and field.type in _NAMING:
        # A class: the values are names of objects.
        return lambda column: ObjectColumn(Kind.TERM, names.ids(column)[0], column.null)
    fitting = "double" if field.type is FieldType.FLOAT else field.type
    raise ConversionError(
        f"field {field.name!r} holds {field.type} values, the feature's are {_short(range)}",
        field=field.name,
        hint="declare the field with a fitting type, or correct the feature's rdfs:range: "
        f"dyknow ontology add-feature NAME --range xsd:{fitting}",
    )


def field_column(
    field: Field,
    objects: ObjectColumn,
    dictionary: TermDictionary,
    pool: StringPool | None,
    namespace: str,
    lost: list[ConversionError] | None = None,
) -> Column:
    """Convert objects to a field, shape ``(n,)``: the inverse of `object_column`.

    Text fields take any term: names of IRIs (`object_name`), texts of literals. Number fields take
    numbers of any datatype; INF and NaN become no_value, as samples hold neither. Raises
    `ConversionError` with the row of an object that the field cannot hold. With ``lost``, the first
    such error is appended there, and each such object becomes no_value.
    """
    kind, null = objects.kind, objects.null
    match field.type:
        case FieldType.STRING:
            assert pool is not None
            return _text(objects, dictionary, pool, namespace)
        case FieldType.FLOAT if kind.is_number:
            values = objects.values.astype(np.float64)
            finite = np.isfinite(values)
            if np.count_nonzero(finite) < len(finite):
                infinite = ~finite
                null = infinite if null is None else infinite | null
            return Column(field.type, values, null)
        case FieldType.INTEGER if kind is Kind.INTEGER:
            return Column(field.type, objects.values, null)
        case FieldType.INTEGER if kind.is_number and (lost is None or _is_integral(objects)):
            return Column(field.type, _integral(field.name, objects.values, null), null)
        case FieldType.BOOLEAN if kind is Kind.BOOLEAN:
            return Column(field.type, objects.values, null)
        case FieldType.FLOAT | FieldType.INTEGER | FieldType.BOOLEAN:
            return _parsed(field, objects, dictionary, namespace, lost)
        case _:
            assert_never(field.type)


def _to_floats(field: Field, kind: Kind, conversion: Conversion) -> ToObjects:
    def convert(column: Column) -> ObjectColumn:
        values = column.values
        if column.type is FieldType.INTEGER:
            values = _filled(column)
            floats = values.astype(np.float64)
            large = (values > _EXACT) | (values < -_EXACT)
            # Above 2^53 a float64 may be a neighbour: compare as integers where both exist.
            inexact = large & ((floats >= 2.0**63) | (_as_integers(floats) != values))
            _refuse(
                inexact, column.null, field.name, "has more digits than a float64 holds", values
            )
            values = floats
        if not conversion.is_identity:
            with np.errstate(over="ignore", invalid="ignore"):
                values = conversion.apply(values)
            _refuse(~np.isfinite(values), column.null, field.name, "overflows in its new unit")
        if kind is Kind.DECIMAL:
            # A decimal has no -0.
            values = values + 0.0
        return ObjectColumn(kind, values, column.null)

    return convert


def _to_integers(field: Field) -> ToObjects:
    def convert(column: Column) -> ObjectColumn:
        values = column.values
        if column.type is FieldType.FLOAT:
            values = _integral(field.name, values, column.null)
        return ObjectColumn(Kind.INTEGER, values, column.null)

    return convert


def _to_literals(
    integers: ToObjects,
    range: str,
    bounds: tuple[int, int],
    dictionary: TermDictionary,
    field: Field,
) -> ToObjects:
    datatype = NamedNode(range)
    low, high = bounds
    literals = _distinct(field, lambda value: Literal(str(value), datatype=datatype), dictionary)

    def convert(column: Column) -> ObjectColumn:
        objects = integers(column)
        values = objects.values
        _refuse(
            (values < low) | (values > high),
            column.null,
            field.name,
            f"is no {_short(range)}",
            values,
        )
        return literals(Column(FieldType.INTEGER, values, column.null))

    return convert


def _distinct(field: Field, term: Callable[[int], Term], dictionary: TermDictionary) -> ToObjects:
    """Compile the conversion of integers to terms, one per distinct value."""

    def convert(column: Column) -> ObjectColumn:
        distinct, inverse = np.unique(_filled(column), return_inverse=True)
        ids = dictionary.transient_ids(term(value) for value in distinct.tolist())
        return ObjectColumn(Kind.TERM, ids[inverse], column.null)

    return convert


def _text(
    objects: ObjectColumn, dictionary: TermDictionary, pool: StringPool, namespace: str
) -> Column:
    present = objects.present
    codes = np.zeros(len(objects), np.int32)
    distinct, inverse = np.unique(objects.values[present], return_inverse=True)
    terms = (make_term(objects.kind, value, dictionary) for value in distinct)
    texts = [term_text(term, namespace) for term in terms]
    codes[present] = pool.encode(texts)[inverse]
    return Column(FieldType.STRING, codes, objects.null, pool)


def term_text(term: Term, namespace: str) -> str:
    """The text of any term in a text field: the name of an IRI, the text of a literal."""
    if isinstance(term, NamedNode):
        return object_name(term.value, namespace)
    return term.value if isinstance(term, Literal) else str(term)


def _parsed(
    field: Field,
    objects: ObjectColumn,
    dictionary: TermDictionary,
    namespace: str,
    lost: list[ConversionError] | None,
) -> Column:
    """Convert terms to numbers or booleans, each distinct one once."""
    present = np.flatnonzero(objects.present)
    distinct, first, inverse = np.unique(
        objects.values[present], return_index=True, return_inverse=True
    )
    read: list[Any] = []
    error = None
    unread = np.zeros(len(distinct), np.bool_)
    for place, (value, row) in enumerate(zip(distinct, first.tolist(), strict=True)):
        term = make_term(objects.kind, value, dictionary)
        parsed = _term_value(field.type, term, namespace)
        if parsed is None:
            unread[place] = True
            error = error or ConversionError(
                f"{_shortened(term)} is no {field.type} value",
                row=int(present[row]),
                field=field.name,
            )
        read.append(parsed or 0)
    if error is not None:
        if lost is None:
            raise error
        lost.append(error)
    values = np.zeros(len(objects), field.type.dtype)
    gone = np.zeros(len(objects), np.bool_)
    if read:
        values[present] = np.array(read, field.type.dtype)[inverse]
        gone[present] = unread[inverse]
    gone |= ~np.isfinite(values)
    null = objects.null
    if gone.any():
        null = gone if null is None else gone | null
    return Column(field.type, values, null)


def _shortened(term: Term) -> str:
    text = str(term)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}…"


def _term_value(type: FieldType, term: Term, namespace: str) -> float | int | bool | None:
    """The value of a term for a field of this type, or None."""
    if isinstance(term, NamedNode) and type is FieldType.INTEGER:  # an object named by a number
        name = object_name(term.value, namespace)
        term = Literal(name, datatype=NamedNode(XSD + "integer"))
    if not isinstance(term, Literal) or not term.datatype.value.startswith(XSD):
        return None
    datatype, text = term.datatype.value.removeprefix(XSD), term.value
    try:
        match type:
            case FieldType.BOOLEAN:
                known = {"true": True, "1": True, "false": False, "0": False}
                return known.get(text.strip()) if datatype == "boolean" else None
            case FieldType.FLOAT:
                return float(text) if datatype in _NUMERIC else None
            case FieldType.INTEGER if datatype == "dateTime":
                # A query may compute times finer than a nanosecond.
                return parse_time(text, cut=True)
            case FieldType.INTEGER:
                if datatype not in (*_NUMERIC, "string"):
                    return None
                number = float(text) if datatype in _FLOATING else int(text)
                return int(number) if number % 1 == 0 and -(2**63) <= number < 2**63 else None
            case FieldType.STRING:
                return None
            case _:
                assert_never(type)
    except ValueError:
        return None


def _integral(name: str, values: NDArray[Any], null: Mask | None) -> NDArray[np.int64]:
    """Floats as integers; raises `ConversionError` unless all are integral and within 64 bits."""
    _refuse(~_whole(values), null, name, "is no integer", values)
    return _as_integers(values if null is None else np.where(null, 0.0, values))


def _whole(values: NDArray[Any]) -> Mask:
    with np.errstate(invalid="ignore"):
        whole: Mask = (values == np.floor(values)) & (values >= -(2.0**63)) & (values < 2.0**63)
    return whole


def _is_integral(objects: ObjectColumn) -> bool:
    """Whether all floats of a column are integral and within 64 bits."""
    return bool(_whole(objects.values)[objects.present].all())


def _as_integers(values: NDArray[Any]) -> NDArray[np.int64]:
    """Floats cut to int64; a float outside becomes the smallest integer, without a warning."""
    with np.errstate(invalid="ignore"):
        return values.astype(np.int64)


def _refuse(
    bad: Mask, null: Mask | None, name: str, problem: str, values: NDArray[Any] | None = None
) -> None:
    """Raise `ConversionError` for the first row that is bad and present."""
    if null is not None:
        bad = bad & ~null
    if not bad.any():
        return
    row = int(np.argmax(bad))
    shown = "" if values is None else f": {values[row].item()!r}"
    raise ConversionError(f"field {name!r} {problem}{shown}", row=row, field=name)


def _filled(column: Column) -> NDArray[Any]:
    """The values, 0 under null bits (where any value may stand)."""
    if column.null is None:
        return column.values
    return np.where(column.null, column.values.dtype.type(0), column.values)


def _pool(column: Column) -> StringPool:
    assert column.pool is not None
    return column.pool


def _natural_range(type: FieldType) -> str:
    match type:
        case FieldType.FLOAT:
            return XSD + "double"
        case FieldType.INTEGER:
            return XSD + "integer"
        case FieldType.BOOLEAN:
            return XSD + "boolean"
        case FieldType.STRING:
            return XSD + "string"
        case _:
            assert_never(type)


def _short(range: str) -> str:
    for prefix, namespace in (("xsd", XSD), ("rdf", RDF), ("rdfs", RDFS), ("owl", OWL)):
        if range.startswith(namespace):
            return f"{prefix}:{range.removeprefix(namespace)}"
    return f"objects of <{range}>"


_DATE_TIME: Final = NamedNode(XSD + "dateTime")
_FLOATING: Final[Sequence[str]] = ("double", "float", "decimal")
_NUMERIC: Final[Sequence[str]] = (*_FLOATING, "integer", *_INTEGERS)
_NAMING: Final = (FieldType.STRING, FieldType.INTEGER)
_NOT_TEXT: Final = frozenset((*_NUMERIC, "boolean"))
"""Datatypes whose literals text cannot be trusted to be: an annotation must not guess."""
