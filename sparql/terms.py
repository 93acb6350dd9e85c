"""Converts tokens to RDF terms and back (SPARQL 1.1 §4.1, §19.7).

A printed term is escaped such that its text cannot be read as syntax. Binding an argument is
therefore safe, whatever the argument contains.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final
from urllib.parse import urljoin

from pyoxigraph import BlankNode, Literal, NamedNode

from ..rdf.dictionary import Term
from ..rdf.namespaces import PREFIXES, XSD
from .errors import LanguageError, Span
from .tokens import Kind, Token

_STRING_ESCAPES: Final = {
    "t": "\t",
    "b": "\b",
    "n": "\n",
    "r": "\r",
    "f": "\f",
    '"': '"',
    "'": "'",
    "\\": "\\",
}
_STRING_ESCAPE: Final = re.compile(r"\\(u[0-9A-Fa-f]{4}|U[0-9A-Fa-f]{8}|.)", re.DOTALL)
_IRI_ESCAPE: Final = re.compile(r"\\(?:u([0-9A-Fa-f]{4})|U([0-9A-Fa-f]{8}))")
_ABSOLUTE: Final = re.compile(r"[A-Za-z][A-Za-z0-9+.\-]*:")
_PLAIN_INTEGER: Final = re.compile(r"0|[1-9][0-9]*")
_PLAIN_LOCAL: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_\-]*")


def suggest_prefix(source: str, token: Token, prefix: str) -> LanguageError:
    """Return the error for an undeclared prefix."""
    return LanguageError(
        f"the prefix `{prefix}:` is not declared",
        source,
        Span(token.start, token.start + len(prefix) + 1),
        f"write the whole IRI, `<…>`, or in a query `PREFIX {prefix}: <…>`; declared are "
        + ", ".join(f"{name}:" for name in PREFIXES),
    )


def iri_text(token: Token, source: str, prefixes: Mapping[str, str], base: str = "") -> str:
    """Return the IRI of an IRI or prefixed-name token."""
    if token.kind is Kind.IRI:
        raw = _IRI_ESCAPE.sub(lambda m: _character(m[1] or m[2], token, source), token.text[1:-1])
        # An absolute IRI skips `urljoin`, which drops a trailing `?` or `#`.
        text = raw if not base or _ABSOLUTE.match(raw) else urljoin(base, raw)
    else:
        prefix, _, local = token.text.partition(":")
        if prefix not in prefixes:
            raise suggest_prefix(source, token, prefix)
        text = prefixes[prefix] + re.sub(r"\\(.)", r"\1", local)
    try:
        return NamedNode(text).value
    except ValueError as error:
        hint = "an IRI is absolute: `<http://…>`" if ":" not in text else ""
        raise LanguageError(f"`{text}` is not an IRI: {error}", source, token.span, hint) from None


def string_text(token: Token, source: str) -> str:
    """Return the characters of a string token, with escapes resolved."""
    quotes = 3 if token.text[:3] in ('"""', "'''") and len(token.text) >= 6 else 1

    def resolve(match: re.Match[str]) -> str:
        code = match[1]
        if len(code) > 1:
            return _character(code[1:], token, source)
        if code not in _STRING_ESCAPES:
            start = token.start + quotes + match.start()
            raise LanguageError(
                f"`\\{code}` is not an escape",
                source,
                Span(start, start + 2),
                r"write `\\` for a \ ",
            )
        return _STRING_ESCAPES[code]

    return _STRING_ESCAPE.sub(resolve, token.text[quotes:-quotes])


def _character(digits: str, token: Token, source: str) -> str:
    code = int(digits, 16)
    if code > 0x10FFFF or 0xD800 <= code <= 0xDFFF:
        raise LanguageError(
            f"U+{digits} is not a character",
            source,
            token.span,
            "write the escape of another character",
        )
    return chr(code)


def number(text: str) -> Literal:
    """Return a number: xsd:double with an exponent, xsd:decimal with a point, else xsd:integer."""
    name = "double" if "e" in text.lower() else "decimal" if "." in text else "integer"
    return Literal(text, datatype=NamedNode(XSD + name))


def term_text(term: Term) -> str:
    """Return the term as SPARQL text, without prefixes. Raises `ValueError` for a blank node.

    Some parsers resolve ``\\uXXXX`` before they look for strings (SPARQL 1.1 §19.2). They read the
    text back unchanged too, since no escaped backslash is followed by a bare ``u``.
    """
    match term:
        case NamedNode():
            return f"<{term.value}>"
        case Literal():
            quoted = f'"{_escape(term.value)}"'
            if term.language is not None:
                return f"{quoted}@{term.language}"
            if term.datatype.value == XSD + "string":
                return quoted
            return f"{quoted}^^<{term.datatype.value}>"
        case BlankNode():
            raise ValueError("a blank node cannot be given as an argument")


def _escape(text: str) -> str:
    text = text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
    text = text.replace("\r", "\\r").replace("\t", "\\t").replace("\b", "\\b").replace("\f", "\\f")
    return re.sub(r"(?<=\\)([uU])", lambda m: f"\\U{ord(m[1]):08X}", text)


def short_text(term: Term, prefixes: Mapping[str, str]) -> str:
    """Return a short form of the term: a prefixed name or a bare number where it means the same."""
    if isinstance(term, NamedNode):
        for prefix, namespace in prefixes.items():
            local = term.value.removeprefix(namespace)
            if namespace and local != term.value and _PLAIN_LOCAL.fullmatch(local):
                return f"{prefix}:{local}"
    elif isinstance(term, Literal):
        is_integer = term.datatype.value == XSD + "integer"
        if is_integer and _PLAIN_INTEGER.fullmatch(term.value):
            return term.value
        # A bare `true` is "true"^^xsd:boolean, but "1"^^xsd:boolean is another term.
        if term.datatype.value == XSD + "boolean" and term.value in ("true", "false"):
            return term.value
    return term_text(term)
