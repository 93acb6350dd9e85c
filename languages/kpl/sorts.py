"""Resolves value sorts of KPL to fields, and decides compatibility ([DyKnow10 Def. 5.13, 5.27]).

A name is, in this order: a predefined sort, a declared one, a feature of the ontology, or else
*open*: only its name is known, as for the paper's ``pos``.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from ...ontology.vocabulary import Vocabulary
from ...rdf.datatypes import VALUE_DATATYPES, range_type
from ...rdf.namespaces import DYKNOW, PREFIXES, XSD
from ...streams.sample import Field, FieldType, Schema
from ...streams.tuples import flat_names, flat_schema
from ..hints import did_you_mean, suggest_name
from . import ast
from .declarations import OBJECT_FIELD, VALUE, SortDeclaration, ValueSort
from .scope import Scope, check_prefix, without_prefix
from .symbols import SORT

BUILT_IN: Final = {
    "float": FieldType.FLOAT,
    "double": FieldType.FLOAT,
    "decimal": FieldType.FLOAT,
    "integer": FieldType.INTEGER,
    "int": FieldType.INTEGER,
    "long": FieldType.INTEGER,
    "boolean": FieldType.BOOLEAN,
    "string": FieldType.STRING,
    # Def. 5.13 requires these two: a time is ns since 1970, an object is its name.
    "time": FieldType.INTEGER,
    "object": FieldType.STRING,
}
_OWN_KIND: Final = ("time", "object")


def read_sort(name: ast.Name, scope: Scope) -> ValueSort:
    """Resolve the name of a sort; from now on no other symbol may have it.

    Raises `LanguageError` for an unknown prefix, datatype or term of the ontology.
    """
    sort = _resolve(name, scope)
    scope.check_symbol(sort.name, SORT, name.span)
    scope.symbols.use_sort(sort.name)
    return sort


def _resolve(name: ast.Name, scope: Scope) -> ValueSort:
    text = name.text
    if text in BUILT_IN:
        return _simple(text, BUILT_IN[text])
    declared = scope.by_key.get(f"sort {text}")
    if isinstance(declared, SortDeclaration):
        return declared.sort
    prefix, colon, local = text.partition(":")
    if not colon:
        return _of_ontology(text, DYKNOW + text, scope.vocabulary)
    check_prefix(name, scope.source)
    if prefix == "xsd":
        if XSD + local not in VALUE_DATATYPES:
            datatypes = [iri.removeprefix(XSD) for iri in VALUE_DATATYPES]
            raise scope.error(f"XSD has no `{local}`", name.span, suggest_name(local, datatypes))
        return _simple(text, range_type(XSD + local))
    iri = PREFIXES[prefix] + local
    if scope.vocabulary is not None:
        _check_known(name, iri, scope, scope.vocabulary)
    # The short name of a domain term is canonical, unless another sort has it.
    is_hidden = local in BUILT_IN or f"sort {local}" in scope.by_key
    return _of_ontology(text if is_hidden else without_prefix(text), iri, scope.vocabulary)


def _check_known(name: ast.Name, iri: str, scope: Scope, vocabulary: Vocabulary) -> None:
    if not vocabulary.is_feature(iri) and not vocabulary.is_sort(iri):
        prefix, _, local = name.text.partition(":")
        found = vocabulary.suggest(local, "feature")
        raise scope.error(
            f"the ontology knows no `{name.text}`",
            name.span,
            f"did you mean {found[0] if found[0].startswith('<') else f'{prefix}:{found[0]}'}?"
            if found
            else f"without its prefix `{local}` is a new sort",
        )


def _of_ontology(name: str, iri: str, vocabulary: Vocabulary | None) -> ValueSort:
    info = None if vocabulary is None else vocabulary.feature(iri)
    if info is None:
        return ValueSort(name, None)
    if info.range is None:
        return ValueSort(name, None, iri)
    return _simple(name, range_type(info.range), iri)


def _simple(name: str, type: FieldType, feature: str | None = None) -> ValueSort:
    return ValueSort(name, (Field(VALUE, type),), feature)


# -- declared sorts -----------------------------------------------------------------------------


def declared_sort(declaration: ast.Sort, scope: Scope) -> SortDeclaration:
    """Return the sort that ``sort NAME = …`` declares. Raises `LanguageError`."""
    name = declaration.name
    if name.text in BUILT_IN:
        raise scope.error(
            f"`{name.text}` is a sort of the language", name.span, "choose another name"
        )
    scope.check_symbol(name.text, SORT, name.span)
    if f"sort {name.text}" not in scope.by_key and scope.symbols.is_used_sort(name.text):
        raise scope.error(
            f"sort `{name.text}` is declared after it was used",
            name.span,
            "declare it before every source and compunit of that sort",
        )
    if isinstance(declaration.value, ast.Name):
        return SortDeclaration(ValueSort(name.text, _fields_of(declaration.value, scope)))
    fields: dict[str, Field] = {}
    for field, written in declaration.value:
        if field.text in fields:
            raise scope.error(
                f"field `{field.text}` occurs twice", field.span, "name each field once"
            )
        parts = _fields_of(written, scope)
        if [each.name for each in parts] != [VALUE]:
            raise scope.error(
                f"a field holds one value, and `{written.text}` has ({format_fields(parts)})",
                written.span,
                "write its fields one by one",
            )
        fields[field.text] = Field(field.text, parts[0].type)
    return SortDeclaration(ValueSort(name.text, tuple(fields.values())))


def _fields_of(name: ast.Name, scope: Scope) -> tuple[Field, ...]:
    sort = read_sort(name, scope)
    if sort.fields is None:
        raise scope.error(
            f"the values of `{name.text}` are unknown",
            name.span,
            suggest_name(name.text, known_sorts(scope)),
        )
    return sort.fields


def known_sorts(scope: Scope) -> list[str]:
    """Return the names of predefined and declared sorts."""
    declared = [key.removeprefix("sort ") for key in scope.keys_of(SortDeclaration)]
    return [*BUILT_IN, *declared]


# -- sorts of processes --------------------------------------------------------------------------


def tuple_sort(
    name: str, identifiers: Iterable[str], sorts: Iterable[ValueSort], *, times: bool = False
) -> ValueSort:
    """Return the sort of tuples of streams (Def. 5.2), with the times of their samples if
    ``times``. It is open if one of the sorts is."""
    schemas: list[Schema] = []
    for sort in sorts:
        if sort.fields is None:
            return ValueSort(name, None)
        schemas.append(Schema(sort.fields))
    names = flat_names(list(identifiers), schemas, times)
    return ValueSort(name, flat_schema(names, schemas, times).fields)


def of_many_objects(sort: ValueSort) -> ValueSort:
    """Return the sort of an aggregate, whose samples name their object."""
    if sort.fields is None or any(field.name == OBJECT_FIELD for field in sort.fields):
        return sort
    return ValueSort(sort.name, (Field(OBJECT_FIELD, FieldType.STRING), *sort.fields), sort.feature)


def fits(sort: ValueSort, input: ValueSort, vocabulary: Vocabulary | None) -> bool:
    """Return whether a stream of ``sort`` can be an input of sort ``input``.

    Sorts are equal by name. The stream may have more fields: those of an aggregate add the name of
    the object. Synonyms are one sort, and the values of a sub-feature are values of its feature.
    """
    if sort.name == input.name:
        return _has(sort, input)
    if sort.feature is not None and input.feature is not None and vocabulary is not None:
        return input.feature in vocabulary.superfeatures(sort.feature) and _has(sort, input)
    both = {sort.name, input.name}
    plain = all(name in BUILT_IN or name.startswith("xsd:") for name in both)
    return plain and both.isdisjoint(_OWN_KIND) and _has(sort, input)


def _has(sort: ValueSort, input: ValueSort) -> bool:
    if sort.fields is None or input.fields is None:
        return True
    return set(input.fields) <= set(sort.fields)


def misfit(sort: ValueSort, input: ValueSort) -> str:
    """Return the mismatch: "of sort `float`, and this one is of sort `pos`"."""
    if sort.name == input.name:
        return (
            f"with ({format_fields(input.fields)}), and this one has ({format_fields(sort.fields)})"
        )
    return f"of sort `{input.name}`, and this one is of sort `{sort.name}`"


def misfit_hint(sort: ValueSort, input: ValueSort, scope: Scope) -> str:
    """Return a hint at the intended sort if one of the two is open; else empty."""
    for one in (input, sort):
        if one.is_open:
            hint = did_you_mean(one.name, known_sorts(scope))
            if hint:
                return f"the sort `{one.name}` is not declared: {hint}"
    return ""


def format_fields(fields: Iterable[Field] | None) -> str:
    """Return ``x float, y float``."""
    return ", ".join(f"{field.name} {field.type}" for field in fields or ())
