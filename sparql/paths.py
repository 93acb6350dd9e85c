"""Property paths of SPARQL 1.1 ([88]-[96])."""

from __future__ import annotations

from pyoxigraph import NamedNode

from ..rdf.namespaces import RDF_TYPE
from .ast import Alternative, Inverse, NegatedSet, Path, Repetition, Sequence
from .expressions import ExpressionReader
from .tokens import Kind, Token


class PathReader(ExpressionReader):
    """Reads paths. `patterns` counts triple patterns, and steps and alternatives of paths."""

    patterns = 0

    def count_pattern(self, token: Token | None) -> None:
        """Count a triple pattern or a step of a path. Raises `LanguageError` above the limit."""
        self.patterns += 1
        if self.patterns > self.limits.patterns:
            message = f"the query has more than {self.limits.patterns} triple patterns"
            raise self.error(message, token, self.limits.hint)

    def path(self) -> Path:
        """[88] Path, [89] PathAlternative."""
        parts = [self._path_sequence()]
        while self.is_mark("|"):
            self.count_pattern(self.take())
            parts.append(self._path_sequence())
        return Alternative(tuple(parts)) if len(parts) > 1 else parts[0]

    def _path_sequence(self) -> Path:
        """[90] PathSequence."""
        parts = [self._path_element()]
        while self.is_mark("/"):
            self.count_pattern(self.take())
            parts.append(self._path_element())
        return Sequence(tuple(parts)) if len(parts) > 1 else parts[0]

    def _path_element(self) -> Path:
        """[91] PathElt, [92] PathEltOrInverse, [93] PathMod."""
        is_inverse = self.accept_mark("^")
        found = self._path_primary()
        if self.is_mark("*", "+", "?") and not self.is_signed_number():
            found = Repetition(found, self.take().text)
        return Inverse(found) if is_inverse else found

    def _path_primary(self) -> Path:
        """[94] PathPrimary."""
        if self.accept_mark("("):
            found = self.path()
            self.expect(")")
            return found
        if self.accept_mark("!"):
            return self._negated_set()
        return self.predicate()

    def _negated_set(self) -> NegatedSet:
        """[95] PathNegatedPropertySet, [96] PathOneInPropertySet."""
        forward: list[NamedNode] = []
        backward: list[NamedNode] = []

        def one() -> None:
            found = backward if self.accept_mark("^") else forward
            found.append(self.predicate())

        if not self.accept_mark("("):
            one()
        elif not self.accept_mark(")"):
            one()
            while self.is_mark("|"):
                self.count_pattern(self.take())
                one()
            self.expect(")")
        return NegatedSet(tuple(forward), tuple(backward))

    def predicate(self) -> NamedNode:
        """[136] iri, or ``a``."""
        here = self.here
        if here is None:
            raise self.unexpected()
        if here.kind is Kind.WORD and here.text == "a":
            self.take()
            return RDF_TYPE
        if here.kind not in (Kind.IRI, Kind.PREFIXED):
            raise self.unexpected()
        return NamedNode(self.iri_of(self.take()))
