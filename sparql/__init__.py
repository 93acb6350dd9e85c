"""SPARQL 1.1 query texts: one tokenizer, one parser, the tree, its scopes, its printer.

`languages.csparql` extends the parser by the clauses of continuous queries; `query_guard` of
`ontology.texts` checks users' queries with it. The main process has no other parser for query
texts.
"""

from .errors import LanguageError, Span
from .parser import parse_sparql
from .printer import print_query

__all__ = ["LanguageError", "Span", "parse_sparql", "print_query"]
