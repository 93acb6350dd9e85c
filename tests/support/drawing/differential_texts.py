"""The texts of a query of the differential test.

`Product` writes the text that `dyknow.evaluate` gets, `Oracle` the SPARQL 1.1 that Oxigraph gets
for the content of one window.

A bag on Oxigraph, whose graphs are sets: the n-th copy of an element stands in an n-th named graph
of its window. A triple pattern is asked of each of them with a variable of its own, so it matches
once a copy. Types and repeated paths, which are sets of facts, are asked of the merged graph. A
path's sequences and alternatives become joins and unions first (SPARQL 1.1, 18.2.2.4).
"""

from dataclasses import dataclass, field, replace
from typing import assert_never

from differential_queries import (
    DEFAULT,
    TIMESTAMP,
    Aggregate,
    Ask,
    Bind,
    Call,
    Construct,
    Exists,
    Expression,
    Filter,
    Group,
    InWindow,
    Minus,
    Optional,
    Path,
    Pattern,
    Query,
    Select,
    Term,
    Triple,
    Union,
    Values,
    bind,
    substituted,
    variables_of,
)
from standard_values import ERROR, iri
from standard_values import Term as Node

# Oxigraph has these wrong for ordinary values, too.
ALWAYS_EXACT = ("<", ">", "<=", ">=", "/")
BOOLEAN = {
    "=", "!=", "<", ">", "<=", ">=", "&&", "||", "!", "BOUND", "IN", "NOT IN", "sameTerm",
    "isIRI", "isLiteral", "isNumeric", "CONTAINS", "REGEX", "LANGMATCHES",
}  # fmt: skip


class Product:
    """The text of a query as people write it."""

    def head_and_where(self, query: Query) -> tuple[str, str, str]:
        """The head, the group behind WHERE, and what stands behind that."""
        match query:
            case Select():
                return self.head(query), self.group(query.where), self.modifiers(query)
            case Construct():
                triples = " . ".join(
                    f"{t.subject} {t.predicate} {t.object}" for t in query.template
                )
                return f"CONSTRUCT {{ {triples} }}", self.group(query.where), ""
            case Ask():
                return "ASK", self.group(query.where), ""
        assert_never(query)

    def head(self, query: Select) -> str:
        if query.classic:
            items = " ".join(variable for variable, _ in query.items)
        else:
            items = " ".join(
                variable if given is None else f"({self.expression(given)} AS {variable})"
                for variable, given in query.items
            )
        return f"SELECT {'DISTINCT ' if query.distinct else ''}{items}"

    def modifiers(self, query: Select) -> str:
        if query.classic:
            return self.classic(query)
        keys = f" GROUP BY {' '.join(query.keys)}" if query.keys else ""
        having = "".join(f" ({self.truth(condition)})" for condition in query.having)
        return keys + (f" HAVING{having}" if having else "")

    def classic(self, query: Select) -> str:
        ((variable, given),) = [item for item in query.items if item[1] is not None]
        assert isinstance(given, Aggregate)
        assert given.argument is not None
        clause = f"({variable}, {given.name}, {{{self.expression(given.argument)}}})"
        conditions = "".join(f" FILTER ({self.truth(condition)})" for condition in query.having)
        return f" AGGREGATE {{{clause}{conditions}}}"

    def group(self, group: Group) -> str:
        return "{ " + " ".join(map(self.pattern, group.elements)) + " }"

    def pattern(self, pattern: Pattern) -> str:
        match pattern:
            case Triple():
                return self.triple(pattern)
            case Filter():
                return f"FILTER ({self.truth(pattern.condition)})"
            case Bind():
                return f"BIND ({self.expression(pattern.expression)} AS {pattern.variable})"
            case Values():
                rows = " ".join(f"({' '.join(row)})" for row in pattern.rows)
                return f"VALUES ({' '.join(pattern.variables)}) {{ {rows} }}"
            case Optional():
                return f"OPTIONAL {self.group(pattern.group)}"
            case Union():
                return " UNION ".join(map(self.group, pattern.sides))
            case Minus():
                return f"MINUS {self.group(pattern.group)}"
            case InWindow():
                return self.window(pattern)
            case Group():
                return self.group(pattern)
            case Select():
                head, where, rest = self.head_and_where(pattern)
                return f"{{ {head} WHERE {where}{rest} }}"
        assert_never(pattern)

    def triple(self, triple: Triple) -> str:
        return f"{triple.subject} {triple.predicate} {triple.object} ."

    def window(self, pattern: InWindow) -> str:
        return f"WINDOW {pattern.name} {self.group(pattern.group)}"

    def expression(self, given: Expression) -> str:
        match given:
            case Term():
                return given.text
            case Exists():
                return self.exists(given)
            case Aggregate():
                return self.aggregate(given)
            case Call():
                return self.call(given)
        assert_never(given)

    def exists(self, given: Exists) -> str:
        return f"{'NOT ' if given.negated else ''}EXISTS {self.group(given.group)}"

    def truth(self, given: Expression) -> str:
        """An expression where its effective boolean value is asked for."""
        return self.expression(given)

    def aggregate(self, given: Aggregate) -> str:
        argument = "*" if given.argument is None else self.expression(given.argument)
        separator = ' ; SEPARATOR=";"' if given.name == "GROUP_CONCAT" else ""
        return f"{given.name}({'DISTINCT ' if given.distinct else ''}{argument}{separator})"

    def call(self, given: Call) -> str:
        name = given.name
        if name in ("&&", "||", "!"):
            parts = [f"({self.truth(argument)})" for argument in given.arguments]
            return f"!{parts[0]}" if name == "!" else name.join(parts)
        if name == "IF":
            first, *others = given.arguments
            return f"IF({', '.join([self.truth(first), *map(self.expression, others)])})"
        parts = [self.expression(argument) for argument in given.arguments]
        if name == "neg":
            return f"(-({parts[0]}))"
        if name in ("IN", "NOT IN"):
            return f"({parts[0]} {name} ({', '.join(parts[1:])}))"
        if name[0] in "=!<>+-*/":
            return f"({parts[0]} {name} {parts[1]})"
        return f"{name}({', '.join(parts)})"


@dataclass
class Oracle(Product):
    """The text for Oxigraph over one window's store.

    ``copies``: of each graph ("" for the default one), the graphs of the n-th copies, or nothing
    under set semantics. ``exact``: numbers and comparisons go through `standard_values`.
    ``timed``: each element has a graph of its own whose name has its time.
    """

    copies: dict[str, tuple[str, ...]]
    windows: tuple[str, ...]
    exact: bool
    scope: str = ""
    fresh: int = 0
    timed: bool = False
    matched: list[tuple[Triple, str]] = field(default_factory=list)
    seen: tuple[str, ...] = ()
    inner: list[tuple[Group, str, tuple[str, ...]]] = field(default_factory=list)

    def new_variable(self) -> str:
        self.fresh += 1
        return f"?oracle{self.fresh}"

    def group(self, group: Group) -> str:
        before, self.seen = self.seen, tuple(variables_of(group))
        text = super().group(group)
        self.seen = before
        return text

    def exists(self, given: Exists) -> str:
        """A call of a function of the variables in scope, by the definition of EXISTS (18.6)."""
        name = f"exists {len(self.inner)}"
        self.inner.append((given.group, self.scope, self.seen))
        values = ", ".join(f"COALESCE({variable}, {ERROR})" for variable in self.seen)
        return f"{'!' if given.negated else ''}<{iri(name).value}>({values})"

    def asked(self, place: int, values: tuple[Node, ...]) -> str:
        """The query that the `place`-th EXISTS stands for with these values of its variables."""
        group, scope, variables = self.inner[place]
        bound = {v: str(term) for v, term in zip(variables, values, strict=True) if term != ERROR}
        pattern = InWindow(scope, bind(group, bound)) if scope else bind(group, bound)
        return f"ASK {{ {self.pattern(pattern)} }}"

    def window(self, pattern: InWindow) -> str:
        before, self.scope = self.scope, pattern.name
        group = self.group(pattern.group)
        self.scope = before
        if self.copies:
            return group
        names = self.names_of(pattern.name)
        return f"{{ {names} GRAPH {pattern.name} {group} }}"

    def names_of(self, name: str) -> str:
        """A variable of a window ranges over the windows, not over the graphs of copies."""
        return f"VALUES {name} {{ {' '.join(self.windows)} }}" if name.startswith("?") else ""

    def triple(self, triple: Triple) -> str:
        if self.timed:
            graph = self.new_variable()
            self.matched.append((triple, graph))
            found = f"GRAPH {graph} {{ {super().triple(triple)} }}"
            names = f"urn:time:{self.scope or DEFAULT}:"
            return f'{{ {found} FILTER (STRSTARTS(STR({graph}), "{names}")) }}'
        return self.copied(triple.subject, triple.predicate, triple.object)

    def copied(self, subject: str, path: Path, target: str) -> str:
        match path.operator:
            case "/":
                first, *others = path.parts
                if not others:
                    return self.copied(subject, first, target)
                between = self.new_variable()
                rest = Path("/", tuple(others))
                return (
                    f"{self.copied(subject, first, between)} {self.copied(between, rest, target)}"
                )
            case "|":
                sides = (f"{{ {self.copied(subject, part, target)} }}" for part in path.parts)
                return " UNION ".join(sides)
            case "^":
                return self.copied(target, path.parts[0], subject)
            case "+" | "*" | "?" | "a":
                return self.merged(subject, path, target)
            case "!":
                predicate = self.new_variable()
                excluded = ", ".join("rdf:type" if p == Path("a") else str(p) for p in path.parts)
                found = self.each_copy(subject, predicate, target)
                return f"{{ {found} FILTER ({predicate} NOT IN ({excluded})) }}"
        return self.each_copy(subject, path.operator, target)

    def merged(self, subject: str, path: Path, target: str) -> str:
        if not path.nullable or subject.startswith("?") == target.startswith("?"):
            return "" if self.trivial(subject, path, target) else self.plain(subject, path, target)
        # A path of no steps leads from a term to itself, of the graph or not (18.4).
        free, term = (target, subject) if target.startswith("?") else (subject, target)
        found = self.plain(subject, path, target)
        window = self.scope if self.scope.startswith("?") and self.copies else ""
        itself = f"BIND ({term} AS {free}) {self.names_of(window)}"
        return f"{{ SELECT DISTINCT {free} {window} {{ {{ {itself} }} UNION {{ {found} }} }} }}"

    def trivial(self, subject: str, path: Path, target: str) -> bool:
        return path.nullable and subject == target and not subject.startswith("?")

    def plain(self, subject: str, path: Path, target: str) -> str:
        pattern = f"{subject} {path} {target} ."
        if not self.scope or not self.copies:
            return pattern
        return f"{self.names_of(self.scope)} GRAPH {self.scope} {{ {pattern} }}"

    def each_copy(self, subject: str, predicate: str, target: str) -> str:
        if not self.copies:
            return f"{subject} {predicate} {target} ."
        graph = self.new_variable()
        found = f"GRAPH {graph} {{ {subject} {predicate} {target} }}"
        if self.scope.startswith("?"):
            rows = " ".join(f"({c} {name})" for name in self.windows for c in self.copies[name])
            return f"VALUES ({graph} {self.scope}) {{ {rows} }} {found}"
        return f"VALUES {graph} {{ {' '.join(self.copies[self.scope])} }} {found}"

    def truth(self, given: Expression) -> str:
        text = self.expression(given)
        if isinstance(given, Exists) or (isinstance(given, Call) and given.name in BOOLEAN):
            return text
        return f"<{iri('ebv').value}>({text})"

    def head(self, query: Select) -> str:
        return super().head(replace(query, classic=False))

    def classic(self, query: Select) -> str:
        """GROUP BY the other variables of the head; no row without solutions."""
        given = dict(query.items)
        having = tuple(substituted(condition, given) for condition in query.having)
        some = Call(">", (Aggregate("COUNT", False, None), Term("0")))
        return self.modifiers(replace(query, classic=False, having=(*having, some)))

    def aggregate(self, given: Aggregate) -> str:
        if given.argument is None or given.name in ("GROUP_CONCAT", "SAMPLE"):
            return super().aggregate(given)
        if not self.exact and given.name != "COUNT":
            return super().aggregate(given)
        argument = f"COALESCE({self.expression(given.argument)}, {ERROR})"
        return f"<{iri(given.name + (' DISTINCT' if given.distinct else '')).value}>({argument})"

    def timestamp(self, given: Call) -> str:
        """Of the graphs that the patterns matched in, which have their elements' times."""
        terms = tuple(argument.text for argument in given.arguments if isinstance(argument, Term))
        graphs = (
            graph
            for triple, graph in self.matched
            for whole in [(triple.subject, str(triple.predicate), triple.object)]
            if whole == terms or (len(terms) == 1 and terms[0] in whole)
        )
        return f"<{iri('latest').value}>({', '.join(graphs)})"

    def call(self, given: Call) -> str:
        if given.name == TIMESTAMP:
            return self.timestamp(given)
        parts = given.arguments
        if given.name in ("IN", "NOT IN") and self.exact:
            first, *others = parts
            some: Expression = Call("=", (first, others[0]))
            for other in others[1:]:
                some = Call("||", (some, Call("=", (first, other))))
            return self.expression(some if given.name == "IN" else Call("!", (some,)))
        numeric = given.name in ("ABS", "CEIL", "FLOOR", "ROUND", "neg")
        operator = given.name[0] in "=<>+-*/" or given.name == "!="
        if given.name in ALWAYS_EXACT or (self.exact and (numeric or operator)):
            return f"<{iri(given.name).value}>({', '.join(map(self.expression, parts))})"
        return super().call(given)
