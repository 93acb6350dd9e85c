"""Parses text to elements by libxml2, which resolves namespaces and references and checks
well-formedness.

It fetches nothing: no DTD, no entity, no schema that the text names, no XInclude.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from lxml import etree

from .markup import BLANKS, XSI, Attribute, Markup, Tag
from .xml_errors import malformed_error

_LOCATIONS: Final = (f"{{{XSI}}}schemaLocation", f"{{{XSI}}}noNamespaceSchemaLocation")


@dataclass(frozen=True, slots=True)
class Value:
    """The value of an attribute, and the place of the attribute."""

    text: str
    place: Attribute


@dataclass(frozen=True, slots=True)
class Element:
    """An element. ``attributes`` are those without a namespace, by name; ``foreign`` are the others
    without schema locations, which are ignored. ``text`` is the offset of text directly in the
    element, None if there is only white space. ``parent`` is an index into the document, None for
    the root."""

    namespace: str
    name: str
    tag: Tag
    attributes: dict[str, Value]
    foreign: tuple[Attribute, ...]
    text: int | None
    parent: int | None


@dataclass(frozen=True, slots=True)
class Document:
    """The elements in the order of the text; ``tree`` is lxml's, without schema locations."""

    source: str
    elements: tuple[Element, ...]
    tree: Any


def read_document(markup: Markup) -> Document:
    """Parse a text after its scan. Raises `LanguageError` if it is not well-formed."""
    root = _root(markup)
    nodes = list(root.iter())
    places = {node: place for place, node in enumerate(nodes)}
    elements = []
    for place, (node, tag) in enumerate(zip(nodes, markup.tags, strict=True)):
        elements.append(_element(node, tag, markup, place, places.get(node.getparent())))
        for location in _LOCATIONS:
            node.attrib.pop(location, None)
    return Document(markup.source, tuple(elements), root)


def _element(node: Any, tag: Tag, markup: Markup, place: int, parent: int | None) -> Element:
    name = etree.QName(node)
    attributes: dict[str, Value] = {}
    foreign = []
    written = [one for one in markup.attributes(tag) if not one.declares_namespace]
    for (key, text), attribute in zip(node.items(), written, strict=True):
        if not key.startswith("{"):
            attributes[key] = Value(text, attribute)
        elif key not in _LOCATIONS:
            foreign.append(attribute)
    has_text = any(
        piece.strip(BLANKS) for piece in [node.text or "", *(c.tail or "" for c in node)]
    )
    text = markup.texts.get(place) if has_text else None
    return Element(
        name.namespace or "", name.localname, tag, attributes, tuple(foreign), text, parent
    )


def _root(markup: Markup) -> Any:
    parser = etree.XMLParser(
        encoding="utf-8",
        resolve_entities=False,
        load_dtd=False,
        dtd_validation=False,
        attribute_defaults=False,
        no_network=True,
        huge_tree=False,
        remove_comments=True,
        remove_pis=True,
    )
    try:
        return etree.fromstring(markup.source.encode(), parser)
    except etree.XMLSyntaxError:
        # The exception has the last error; the parser's log has the first.
        first = parser.error_log.filter_from_errors()[0]
        raise malformed_error(markup, first.type, first.message, first.line, first.column) from None
