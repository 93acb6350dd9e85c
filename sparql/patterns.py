"""Graph patterns of SPARQL 1.1 ([52]-[106]): groups and their parts, triples."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from pyoxigraph import BlankNode, Literal, NamedNode, Variable

from ..rdf.namespaces import RDF
from .ast import (
    Bind,
    Element,
    Filter,
    Graph,
    Group,
    Minus,
    Optional,
    Path,
    Place,
    Query,
    SubSelect,
    Triple,
    Triples,
    Union,
    Values,
)
from .errors import LanguageError, Span
from .paths import PathReader
from .scope import visible_variables
from .tokens import UNLIMITED, Kind, Limits, Token

_FIRST: Final = NamedNode(RDF + "first")
_REST: Final = NamedNode(RDF + "rest")
_NIL: Final = NamedNode(RDF + "nil")
_PARTS: Final = ("OPTIONAL", "MINUS", "GRAPH", "SERVICE", "FILTER", "BIND", "VALUES")
_TERMS: Final = frozenset(
    {Kind.IRI, Kind.PREFIXED, Kind.VARIABLE, Kind.STRING, Kind.NUMBER, Kind.BLANK}
)


class PatternReader(PathReader):
    """Reads groups. `block` numbers basic graph patterns: a blank node label belongs to one of
    them."""

    def __init__(
        self, source: str, prefixes: Mapping[str, str], limits: Limits = UNLIMITED
    ) -> None:
        super().__init__(source, prefixes, limits)
        self.block = 0
        self.blocks = 0
        self.labels: dict[tuple[bool, str], int] = {}
        self.in_template = False
        self.triples: list[Triple] = []
        self.blanks = 0
        self._anonymous = ""

    # -- groups ----------------------------------------------------------------------------

    def sub_select(self) -> Query:
        """[8] SubSelect."""
        raise NotImplementedError

    def service(self) -> LanguageError:
        """Return the error for SERVICE, which would contact another server."""
        return self.error("SERVICE is refused", self.here)

    def extension_part(self) -> Element | None:
        """Read a part of a group that an extension adds to SPARQL; None if there is none here."""
        return None

    def group(self) -> Group:
        """[53] GroupGraphPattern."""
        opened = self.expect("{")
        block = self.block
        self._next_block()
        elements: list[Element] = []
        if self.is_word("SELECT"):
            elements.append(SubSelect(self.sub_select()))
        else:
            self._elements(elements)
        closed = self.expect("}")
        self.block = block
        return Group(tuple(elements), Span(opened.start, closed.end))

    def _elements(self, elements: list[Element]) -> None:
        """[54] GroupGraphPatternSub."""
        bound: dict[str, None] = {}
        while not self.is_mark("}"):
            element = self.extension_part() or self._part(bound)
            if element is None:
                element = Triples(self._triples_block())
            elif not isinstance(element, Filter):
                self._next_block()
            elements.append(element)
            bound.update(visible_variables(element))
            if not isinstance(element, Triples):
                self.accept_mark(".")

    def _part(self, bound: dict[str, None]) -> Element | None:
        """[56] GraphPatternNotTriples; ``bound``: the variables that the group binds before it."""
        here = self.here
        if here is None:
            raise self.unexpected()
        if here.is_mark("{"):
            return self._union()
        if not here.is_word(*_PARTS):
            return None
        match here.text.upper():
            case "OPTIONAL":
                self.take()
                return Optional(self.group())
            case "MINUS":
                self.take()
                return Minus(self.group())
            case "GRAPH":
                self.take()
                return Graph(self.graph_name(), self.group())
            case "FILTER":
                self.take()
                return Filter(self.constraint())
            case "BIND":
                return self._bind(bound)
            case "VALUES":
                self.take()
                return self.data_block()
        raise self.service()

    def _union(self) -> Element:
        """[67] GroupOrUnionGraphPattern."""
        groups = [self.group()]
        while self.accept_word("UNION"):
            groups.append(self.group())
        return Union(tuple(groups)) if len(groups) > 1 else groups[0]

    def graph_name(self) -> NamedNode | Variable:
        """[107] VarOrIri."""
        here = self.here
        if here is None or here.kind not in (Kind.VARIABLE, Kind.IRI, Kind.PREFIXED):
            raise self.unexpected()
        found = self.term()
        assert isinstance(found, NamedNode | Variable)
        return found

    def _bind(self, bound: dict[str, None]) -> Bind:
        """[60] Bind. The variable must be new in its group (SPARQL 1.1 §18.2.1)."""
        self.take()
        self.expect("(")
        expression = self.expression()
        if not self.accept_word("AS"):
            raise self.unexpected("write `BIND (expression AS ?name)`")
        token = self.here
        variable = self.named_variable()
        if variable.value in bound:
            assert token is not None
            raise self.error(
                f"`{token.text}` is bound earlier in its group",
                token,
                "give the computed value another name",
            )
        self.expect(")")
        return Bind(expression, variable)

    def data_block(self) -> Values:
        """[62] DataBlock."""
        one = not self.is_mark("(")
        names: list[Variable] = []
        if one:
            names.append(self.named_variable())
        else:
            self.take()
            while not self.is_mark(")"):
                names.append(self.named_variable())
            self.take()
        self.expect("{")
        rows: list[tuple[NamedNode | Literal | None, ...]] = []
        while not self.is_mark("}"):
            if one:
                rows.append((self._data_value(),))
                continue
            opened = self.expect("(")
            row: list[NamedNode | Literal | None] = []
            while not self.is_mark(")"):
                row.append(self._data_value())
            self.take()
            if len(row) != len(names):
                message = f"expected a row of {len(names)}, found a row of {len(row)}"
                raise self.error(message, opened, "write UNDEF where there is no value")
            rows.append(tuple(row))
        self.take()
        return Values(tuple(names), tuple(rows))

    def _data_value(self) -> NamedNode | Literal | None:
        """[65] DataBlockValue."""
        if self.accept_word("UNDEF"):
            return None
        here = self.here
        if here is None or here.kind in (Kind.VARIABLE, Kind.BLANK) or not self._is_term(here):
            raise self.unexpected()
        found = self.term()
        assert isinstance(found, NamedNode | Literal)
        return found

    # -- triples ---------------------------------------------------------------------------

    def _next_block(self) -> None:
        self.blocks += 1
        self.block = self.blocks

    def _triples_block(self) -> tuple[Triple, ...]:
        """[55] TriplesBlock, [52] TriplesTemplate."""
        before, self.triples = self.triples, []
        while True:
            self._same_subject()
            if not self.accept_mark("."):
                here = self.here
                if here is not None and not here.is_mark("}", "{") and not self.begins_part(here):
                    raise self.unexpected()
                break
            here = self.here
            if here is None or here.is_mark("}", "{") or self.begins_part(here):
                break
        found, self.triples = tuple(self.triples), before
        return found

    def begins_part(self, token: Token) -> bool:
        """Return whether a part of a group begins with this token."""
        return token.is_word(*_PARTS)

    def template(self) -> tuple[Triple, ...]:
        """[73] ConstructTemplate, with its braces; also the pattern of ``CONSTRUCT WHERE``."""
        self.expect("{")
        self._next_block()
        found: tuple[Triple, ...] = ()
        if not self.is_mark("}"):
            found = self._triples_block()
        self.expect("}")
        return found

    def _same_subject(self) -> None:
        """[75] TriplesSameSubject, [81] TriplesSameSubjectPath."""
        subject, has_triples = self._node()
        if self._begins_verb():
            self._properties(subject)
        elif not has_triples:
            raise self.unexpected()

    def _begins_verb(self) -> bool:
        here = self.here
        if here is None:
            return False
        if here.kind in (Kind.IRI, Kind.PREFIXED, Kind.VARIABLE):
            return True
        if here.kind is Kind.WORD:
            return here.text == "a"
        return not self.in_template and here.is_mark("^", "!", "(")

    def _properties(self, subject: Place) -> None:
        """[77] PropertyListNotEmpty, [83] PropertyListPathNotEmpty."""
        while True:
            start = len(self.source) if self.here is None else self.here.start
            verb = self._verb()
            self._object(subject, verb, start)
            while self.accept_mark(","):
                self._object(subject, verb, start)
            if not self.accept_mark(";"):
                return
            while self.accept_mark(";"):
                pass
            if not self._begins_verb():
                return

    def _verb(self) -> Path | Variable:
        """[78] Verb, [84] VerbPath, [85] VerbSimple."""
        here = self.here
        if here is None or not self._begins_verb():
            raise self.unexpected()
        if here.kind is Kind.VARIABLE:
            return Variable(self.take().text[1:])
        if self.in_template:
            return self.predicate()
        return self.path()

    def _object(self, subject: Place, verb: Path | Variable, start: int) -> None:
        here = self.here
        place = len(self.triples)
        object, _ = self._node()
        # Keep the order of the text: triples in the brackets of an object follow the object.
        span = Span(start, self.last_token.end)
        self.triples.insert(place, Triple(subject, verb, object, span))
        self.count_pattern(here)

    def _is_term(self, token: Token) -> bool:
        return token.kind in _TERMS or token.is_word("TRUE", "FALSE") or self.is_signed_number()

    def _node(self) -> tuple[Place, bool]:
        """[104] GraphNode, [105] GraphNodePath; True if it brought triples of its own."""
        here = self.here
        if here is None:
            raise self.unexpected()
        if here.is_mark("["):
            return self._blank_node_list()
        if here.is_mark("("):
            return self._collection()
        if not self._is_term(here):
            raise self.unexpected()
        if here.kind is Kind.BLANK:
            return self._blank_node(), False
        return self.term(), False

    def _blank_node_list(self) -> tuple[Place, bool]:
        """[99] BlankNodePropertyList, [163] ANON."""
        self.take()
        node = self._fresh()
        if self.accept_mark("]"):
            return node, False
        self._properties(node)
        self.expect("]")
        return node, True

    def _collection(self) -> tuple[Place, bool]:
        """[102] Collection, [161] NIL."""
        self.take()
        if self.accept_mark(")"):
            return _NIL, False
        head = node = self._fresh()
        while True:
            here = self.here
            place = len(self.triples)
            member, _ = self._node()
            is_last = self.is_mark(")")
            rest: Place = _NIL if is_last else self._fresh()
            own = [Triple(node, _FIRST, member), Triple(node, _REST, rest)]
            self.triples[place:place] = own
            for _ in own:
                self.count_pattern(here)
            if is_last:
                self.take()
                return head, True
            assert isinstance(rest, BlankNode)
            node = rest

    def _blank_node(self) -> BlankNode:
        token = self.take()
        key = (self.in_template, token.text)
        if self.labels.setdefault(key, self.block) != self.block:
            raise self.error(
                f"`{token.text}` occurs in two graph patterns",
                token,
                "a blank node label is local to one graph pattern: use a variable",
            )
        return BlankNode(token.text[2:])

    def _fresh(self) -> BlankNode:
        """Return a blank node with a label that the text does not contain."""
        if not self._anonymous:
            self._anonymous = "anon"
            while self._anonymous in self.source:
                self._anonymous += "_"
        self.blanks += 1
        return BlankNode(f"{self._anonymous}{self.blanks}")
