"""EP-SPARQL: SPARQL with operators of time between groups (Anicic et al., WWW 2011; SPEC §8)."""

from .ast import EpSparqlQuery
from .check import check_epsparql
from .checked import CheckedPattern
from .parser import is_epsparql, parse_epsparql
from .printer import format_epsparql

__all__ = [
    "CheckedPattern",
    "EpSparqlQuery",
    "check_epsparql",
    "format_epsparql",
    "is_epsparql",
    "parse_epsparql",
]
