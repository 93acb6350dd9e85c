"""SPARQL 1.1 query texts: one tokenizer, one parser, the tree, its scopes, its printer.

`languages.csparql` adds the clauses of continuous queries to the parser; `ontology.query_guard`
checks users' texts with it. No other parser reads a text in the main process.
"""

from .errors import LanguageError, Span
from .parser import parse_sparql
from .printer import print_query

__all__ = ["LanguageError", "Span", "parse_sparql", "print_query"]
