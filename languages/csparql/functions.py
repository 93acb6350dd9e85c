"""Functions called by their IRI: the accessors of time, and casts (SPEC §5).

``f:timestamp`` is the C-SPARQL engine's: τ, when a triple became known; ``dyknow-o:validTime`` is
DyKnow's. With one variable they return the time of the triple that binds it, with three terms that
of the triple ``(s, p, o)``. They are not in SPARQL 1.1, so no engine checks their calls: this
module does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from pyoxigraph import Literal, NamedNode, Variable

from ...rdf.namespaces import PREFIXES, STREAM_SPACE, XSD
from ...sparql.ast import Expression, FunctionCall
from ..errors import LanguageError
from ..hints import did_you_mean

TIMESTAMP: Final = "http://larkc.eu/csparql/sparql/jena/ext#timestamp"
VALID_TIME: Final = STREAM_SPACE + "validTime"
ACCESSORS: Final = (TIMESTAMP, VALID_TIME)
UNCALLED: Final[dict[NamedNode, Callable[..., Any]]] = {
    NamedNode(iri): lambda *_: None for iri in ACCESSORS
}
"""The accessors as functions for Oxigraph, which must parse their calls but never makes one."""

QUERY_PREFIXES: Final[Mapping[str, str]] = {
    **PREFIXES,
    "f": TIMESTAMP.removesuffix("timestamp"),
}
"""Prefixes that need no declaration in a query text: the shared ones and the C-SPARQL engine's."""

# SPARQL 1.1 §17.1, then the additional ones of Oxigraph.
_CASTS: Final = (
    *("boolean", "dateTime", "decimal", "double", "float", "integer", "string"),
    *("date", "time", "duration", "dayTimeDuration", "yearMonthDuration"),
    *("gDay", "gMonth", "gMonthDay", "gYear", "gYearMonth"),
)
_KNOWN: Final = ("f:timestamp", "dyknow-o:validTime", *(f"xsd:{name}" for name in _CASTS))
_IRIS: Final = frozenset({*ACCESSORS, *(XSD + name for name in _CASTS)})
# Oxigraph checks its GeoSPARQL functions itself.
_GEOSPARQL: Final = "http://www.opengis.net/def/function/geosparql/"


def check_call(call: FunctionCall, source: str) -> None:
    """Raise `LanguageError` for an unknown function, or for an accessor's wrong arguments."""
    iri = call.iri.value
    name = source[call.span.start : call.span.end]
    if iri in ACCESSORS:
        message = _wrong_arguments(call.arguments)
        if message:
            hint = f"write `{name}(?x)` or `{name}(?s, ?p, ?o)`"
            raise LanguageError(f"`{name}` {message}", source, call.span, hint)
    elif iri not in _IRIS and not iri.startswith(_GEOSPARQL):
        hint = did_you_mean(name, _KNOWN) or (
            "known are f:timestamp, dyknow-o:validTime and casts like xsd:integer"
        )
        raise LanguageError(f"the function `{name}` is not known", source, call.span, hint)


def _wrong_arguments(arguments: Sequence[Expression]) -> str:
    """Return the error in the arguments of an accessor; "" if there is none."""
    if len(arguments) not in (1, 3):
        return f"takes 1 or 3 arguments, not {len(arguments)}"
    if not all(isinstance(one, Variable | NamedNode | Literal) for one in arguments):
        return "takes variables and terms, not expressions"
    if not any(isinstance(one, Variable) for one in arguments):
        return "takes a variable" if len(arguments) == 1 else "takes at least one variable"
    return ""
