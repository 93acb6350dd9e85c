"""Parses text to a specification ([Introspection15 §3.2, Listing 1], SPEC §6).

The stages: characters (`decoding`), tags and their places (`markup`), elements (`document`), the
rules of the schema (`schema_rules` in plain words, then `specification.xsd` itself), values
(`ast`). The engine resolves the names.
"""

from __future__ import annotations

from functools import cache
from importlib import resources
from typing import Any, TypeAlias

from lxml import etree

from ..errors import LanguageError
from .ast import (
    Input,
    Parameter,
    Removal,
    Specification,
    StreamReference,
    UnitSpecification,
)
from .decoding import decode
from .document import Document, Element, read_document
from .markup import BLANKS, scan
from .schema_rules import first_violation


def parse_specification(text: str | bytes) -> Specification:
    """Parse a specification. Cost and memory: linear in the text.

    Bytes are UTF-8 or UTF-16. Raises `LanguageError` for more than 2 MiB, more than 100 levels of
    elements, a DOCTYPE, malformed XML, and a text that the schema refuses.
    """
    document = read_document(scan(decode(text)))
    _check(document)
    return _specification(document)


@cache
def _schema() -> Any:
    text = resources.files(__package__).joinpath("specification.xsd").read_bytes()
    return etree.XMLSchema(etree.fromstring(text))


def _check(document: Document) -> None:
    """Raise `LanguageError` unless the schema accepts the document."""
    if error := first_violation(document):
        raise error
    schema = _schema()
    if not schema.validate(document.tree):
        violation = schema.error_log.last_error
        raise LanguageError(
            f"the schema refuses the text: {violation.message}",
            document.source,
            document.elements[0].tag.name_span,
            f"it is about line {violation.line}; the schema is specification.xsd",
        )


_Part: TypeAlias = Input | Parameter | Removal


def _specification(document: Document) -> Specification:
    """Build the values of a valid document. It visits children first, so it does not recurse."""
    elements = document.elements
    children: list[list[_Part]] = [[] for _ in elements]
    insertions: tuple[UnitSpecification, ...] = ()
    removals: tuple[Removal, ...] = ()
    for place, element in reversed([*enumerate(elements)]):
        # The loop visited the children in reverse.
        parts = children[place][::-1]
        match element.name:
            case "specification":
                pass
            case "insertions":
                insertions = tuple(part for part in parts if isinstance(part, UnitSpecification))
            case "removals":
                removals = tuple(part for part in parts if isinstance(part, Removal))
            case _:
                assert element.parent is not None
                removed = elements[element.parent].name == "removals"
                part = _removal(element) if removed else _part(element, parts)
                children[element.parent].append(part)
    return Specification(insertions, removals, document.source)


def _part(element: Element, parts: list[_Part]) -> Input | Parameter:
    match element.name:
        case "parameter":
            value = element.attributes["value"].text
            return Parameter(_required_name(element, "name"), value, element.tag.span)
        case "stream":
            return StreamReference(_required_name(element, "name"), element.tag.span)
        case _:
            return UnitSpecification(
                _required_name(element, "type"),
                _name(element, "name"),
                tuple(part for part in parts if isinstance(part, Parameter)),
                tuple(part for part in parts if isinstance(part, Input)),
                element.tag.span,
            )


def _removal(element: Element) -> Removal:
    return Removal(_name(element, "name"), _name(element, "type"), element.tag.span)


def _required_name(element: Element, attribute: str) -> str:
    name = _name(element, attribute)
    assert name is not None
    return name


def _name(element: Element, attribute: str) -> str | None:
    """Return a name without surrounding white space, as the schema reads it; None if it
    is absent."""
    value = element.attributes.get(attribute)
    return None if value is None else value.text.strip(BLANKS)
