"""Prints a tree as SPARQL 1.1 text, for Oxigraph and for people.

It puts brackets and spaces around every operator, so the text does not depend on precedence. Law:
``parse_sparql(print_query(q))`` is ``q`` up to the labels of blank nodes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import assert_never

from pyoxigraph import BlankNode, Literal, NamedNode, Variable

from ..rdf.namespaces import RDF_TYPE
from .ast import (
    Aggregate,
    Alternative,
    Arithmetic,
    Bind,
    Call,
    Comparison,
    Element,
    Exists,
    Expression,
    Filter,
    Form,
    FunctionCall,
    Graph,
    Group,
    In,
    Inverse,
    Key,
    Logical,
    Minus,
    NegatedSet,
    Optional,
    Order,
    Path,
    Place,
    Query,
    Repetition,
    SelectItem,
    Sequence,
    SubSelect,
    Triple,
    Triples,
    Unary,
    Union,
    Values,
)
from .terms import short_text

_STEP = "  "


def print_query(query: Query, prefixes: Mapping[str, str] | None = None) -> str:
    """Return the text of a query, a line for each part. It declares the prefixes that it uses."""
    printer = Printer(prefixes or {})
    lines = list(printer.query(query, ""))
    declared = [
        f"PREFIX {p}: <{printer.prefixes[p]}>" for p in printer.prefixes if p in printer.used
    ]
    base = [f"BASE <{query.base}>"] if query.base else []
    return "\n".join([*base, *declared, *lines]) + "\n"


class Printer:
    """Prints parts of a query; ``used`` collects the prefixes that it needs."""

    def __init__(self, prefixes: Mapping[str, str]) -> None:
        self.prefixes = prefixes
        self.used: set[str] = set()

    # -- queries and groups ----------------------------------------------------------------

    def query(self, query: Query, margin: str) -> Iterator[str]:
        words = [query.form.value]
        if query.modifier:
            words.append(query.modifier)
        match query.form:
            case Form.SELECT if query.projection is None:
                words.append("*")
            case Form.SELECT:
                words += map(self.select_item, query.projection or ())
            case Form.DESCRIBE:
                words += map(self.place, query.described) if query.described else ["*"]
            case Form.CONSTRUCT if not query.is_short:
                words.append("{ " + self.triples(query.template or ()) + " }")
            case _:
                pass
        yield margin + " ".join(words)
        if query.where is not None:
            yield from self.group("WHERE ", query.where, margin)
        if query.keys:
            yield margin + "GROUP BY " + " ".join(map(self.key, query.keys))
        if query.having:
            yield margin + "HAVING " + " ".join(map(self.in_brackets, query.having))
        if query.order:
            yield margin + "ORDER BY " + " ".join(map(self.order, query.order))
        if query.limit is not None:
            yield f"{margin}LIMIT {query.limit}"
        if query.offset is not None:
            yield f"{margin}OFFSET {query.offset}"
        if query.values is not None:
            yield margin + self.values(query.values)

    def group(self, before: str, group: Group, margin: str) -> Iterator[str]:
        if not group.elements:
            yield f"{margin}{before}{{}}"
            return
        yield f"{margin}{before}{{"
        for element in group.elements:
            yield from self.element(element, margin + _STEP)
        yield f"{margin}}}"

    def element(self, element: Element, margin: str) -> Iterator[str]:
        match element:
            case Triples(triples):
                yield from (f"{margin}{self.triple(triple)} ." for triple in triples)
            case Group():
                yield from self.group("", element, margin)
            case Filter(condition):
                yield f"{margin}FILTER {self.in_brackets(condition)}"
            case Optional(group):
                yield from self.group("OPTIONAL ", group, margin)
            case Minus(group):
                yield from self.group("MINUS ", group, margin)
            case Graph(name, group):
                yield from self.group(f"GRAPH {self.place(name)} ", group, margin)
            case Union(groups):
                for number, group in enumerate(groups):
                    yield from self.group("UNION " if number else "", group, margin)
            case Bind(expression, variable):
                yield f"{margin}BIND ({self.expression(expression)} AS {variable})"
            case Values():
                yield margin + self.values(element)
            case SubSelect(query):
                yield from self.query(query, margin)
            case _:
                assert_never(element)

    def values(self, values: Values) -> str:
        head = " ".join(map(str, values.variables))
        rows = " ".join(
            "(" + " ".join("UNDEF" if t is None else self.place(t) for t in row) + ")"
            for row in values.rows
        )
        return f"VALUES ({head}) {{ {rows} }}"

    def select_item(self, one: SelectItem) -> str:
        if one.expression is None:
            return str(one.variable)
        return f"({self.expression(one.expression)} AS {one.variable})"

    def key(self, key: Key) -> str:
        if key.alias is None:
            is_plain = isinstance(key.expression, Variable)
            return str(key.expression) if is_plain else self.in_brackets(key.expression)
        expression = self.expression(key.expression)
        if isinstance(key.expression, Variable):
            # Oxigraph's parser rejects `(?x AS ?key)` as a key.
            expression = f"COALESCE({expression})"
        return f"({expression} AS {key.alias})"

    def order(self, order: Order) -> str:
        return ("DESC " if order.descending else "ASC ") + self.in_brackets(order.expression)

    # -- triples and paths -----------------------------------------------------------------

    def triples(self, triples: tuple[Triple, ...]) -> str:
        return " ".join(f"{self.triple(triple)} ." for triple in triples)

    def triple(self, triple: Triple) -> str:
        verb = triple.predicate
        if verb == RDF_TYPE:
            predicate = "a"
        else:
            predicate = str(verb) if isinstance(verb, Variable) else self.path(verb)
        return f"{self.place(triple.subject)} {predicate} {self.place(triple.object)}"

    def place(self, term: Place) -> str:
        match term:
            case Variable():
                return str(term)
            case BlankNode():
                return f"_:{term.value}"
            case NamedNode() | Literal():
                text = short_text(term, self.prefixes)
                if text[0] not in "<\"'":
                    self.used.add(text.partition(":")[0])
                return text
            case _:
                assert_never(term)

    def path(self, path: Path) -> str:
        match path:
            case NamedNode():
                return self.place(path)
            case Inverse(inner):
                return f"(^{self.path(inner)})"
            case Sequence(parts):
                return "(" + " / ".join(map(self.path, parts)) + ")"
            case Alternative(parts):
                return "(" + " | ".join(map(self.path, parts)) + ")"
            case Repetition(inner, sign):
                return f"({self.path(inner)}{sign} )"
            case NegatedSet(forward, backward):
                found = [self.place(iri) for iri in forward]
                found += [f"^{self.place(iri)}" for iri in backward]
                return "!(" + " | ".join(found) + ")"
            case _:
                assert_never(path)

    # -- expressions -----------------------------------------------------------------------

    def in_brackets(self, expression: Expression) -> str:
        text = self.expression(expression)
        in_brackets = isinstance(expression, Logical | Comparison | In | Arithmetic | Unary)
        return text if in_brackets else f"({text})"

    def expression(self, expression: Expression) -> str:
        match expression:
            case Variable() | NamedNode() | Literal():
                return self.place(expression)
            case Logical(operator, operands):
                return "(" + f" {operator} ".join(map(self.expression, operands)) + ")"
            case Comparison(operator, left, right):
                return f"({self.expression(left)} {operator} {self.expression(right)})"
            case In(operand, options, negated):
                word = "NOT IN" if negated else "IN"
                return f"({self.expression(operand)} {word} {self.argument_list(options)})"
            case Arithmetic(first, rest):
                steps = (f"{operator} {self.expression(one)}" for operator, one in rest)
                return "(" + " ".join([self.expression(first), *steps]) + ")"
            case Unary(operator, operand):
                return f"({operator} {self.in_brackets(operand)})"
            case Call(name, arguments):
                return name + self.argument_list(arguments)
            case FunctionCall(iri, arguments):
                return self.place(iri) + self.argument_list(arguments)
            case Exists(group, negated):
                inside = " ".join(line.strip() for line in self.group("", group, ""))
                return f"{'NOT ' if negated else ''}EXISTS {inside}"
            case Aggregate():
                return self.aggregate(expression)
            case _:
                assert_never(expression)

    def argument_list(self, expressions: tuple[Expression, ...]) -> str:
        return "(" + ", ".join(map(self.expression, expressions)) + ")"

    def aggregate(self, one: Aggregate) -> str:
        argument = "*" if one.argument is None else self.expression(one.argument)
        distinct = "DISTINCT " if one.distinct else ""
        separator = ""
        if one.separator is not None:
            separator = f" ; SEPARATOR = {short_text(Literal(one.separator), {})}"
        return f"{one.function}({distinct}{argument}{separator})"
