"""Queries of the differential test: an abstract syntax, and its two printers.

`Product` writes the text that `dyknow.evaluate` gets, `Oracle` the SPARQL 1.1 that Oxigraph gets
for the content of one window. Trees are frozen and hold only tuples, texts and trees, so that
`differential_shrinking` can take any part away.

A bag on Oxigraph, whose graphs are sets: the n-th copy of an element stands in an n-th named graph
of its window. A triple pattern is asked of each of them with a variable of its own, so it matches
once a copy.
Types and repeated paths, which are sets of facts, are asked of the merged graph. A path's
sequences and alternatives become joins and unions first (SPARQL 1.1, 18.2.2.4).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any, assert_never

from standard_values import ERROR, iri
from standard_values import Term as Node

TIMESTAMP = "f:timestamp"
DEFAULT = "default"


@dataclass(frozen=True)
class Path:
    """``operator``: an IRI itself, or one of ``/ | ^ + * ? !`` over ``parts``."""

    operator: str
    parts: tuple["Path", ...] = ()

    @property
    def nullable(self) -> bool:
        """If it may have no steps."""
        match self.operator:
            case "*" | "?":
                return True
            case "/":
                return all(part.nullable for part in self.parts)
            case "|" | "+" | "^":
                return any(part.nullable for part in self.parts)
        return False

    def __str__(self) -> str:
        match self.operator:
            case "/" | "|":
                return f"({self.operator.join(map(str, self.parts))})"
            case "^":
                return f"(^{self.parts[0]})"
            case "+" | "*" | "?":
                return f"({self.parts[0]}{self.operator})"
            case "!":
                return f"!({'|'.join(map(str, self.parts))})"
        return self.operator


# Expressions.


@dataclass(frozen=True)
class Term:
    """A variable or a constant, as SPARQL writes it."""

    text: str


@dataclass(frozen=True)
class Call:
    """An operator or function: ``= < + IN BOUND IF …``."""

    name: str
    arguments: tuple["Expression", ...]


@dataclass(frozen=True)
class Exists:
    negated: bool
    group: "Group"


@dataclass(frozen=True)
class Aggregate:
    """COUNT of nothing is COUNT(*)."""

    name: str
    distinct: bool
    argument: "Expression | None"


Expression = Term | Call | Exists | Aggregate
BOOLEAN = {
    "=", "!=", "<", ">", "<=", ">=", "&&", "||", "!", "BOUND", "IN", "NOT IN", "sameTerm",
    "isIRI", "isLiteral", "isNumeric", "CONTAINS", "REGEX", "LANGMATCHES",
}  # fmt: skip


# Patterns.


@dataclass(frozen=True)
class Triple:
    subject: str
    predicate: Path
    object: str


@dataclass(frozen=True)
class Filter:
    condition: Expression


@dataclass(frozen=True)
class Bind:
    expression: Expression
    variable: str


@dataclass(frozen=True)
class Values:
    variables: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Optional:
    group: "Group"


@dataclass(frozen=True)
class Union:
    sides: tuple["Group", ...]


@dataclass(frozen=True)
class Minus:
    group: "Group"


@dataclass(frozen=True)
class InWindow:
    """``WINDOW name {…}``; the name may be a variable."""

    name: str
    group: "Group"


@dataclass(frozen=True)
class Group:
    elements: tuple["Pattern", ...]


@dataclass(frozen=True)
class Select:
    """``items``: (variable, its expression or none); ``classic`` is C-SPARQL's AGGREGATE clause."""

    distinct: bool
    items: tuple[tuple[str, Expression | None], ...]
    where: Group
    keys: tuple[str, ...] = ()
    having: tuple[Expression, ...] = ()
    classic: bool = False


@dataclass(frozen=True)
class Construct:
    template: tuple[Triple, ...]
    where: Group


@dataclass(frozen=True)
class Ask:
    where: Group


Pattern = Triple | Filter | Bind | Values | Optional | Union | Minus | InWindow | Group | Select
Query = Select | Construct | Ask


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
        if given.name in ("<", ">", "<=", ">=") or (self.exact and (numeric or operator)):
            return f"<{iri(given.name).value}>({', '.join(map(self.expression, parts))})"
        return super().call(given)


def substituted(given: Expression, meanings: dict[str, Expression | None]) -> Expression:
    """An expression with the aggregates that its variables name."""
    match given:
        case Term():
            return meanings.get(given.text) or given
        case Call():
            return Call(given.name, tuple(substituted(part, meanings) for part in given.arguments))
        case Exists() | Aggregate():
            return given
    assert_never(given)


def bind(tree: Any, values: Mapping[str, str]) -> Any:
    """SPARQL's substitute (18.6): a tree with terms in the place of variables.

    A triple with a literal as its predicate has no solution.
    """
    match tree:
        case str():
            return values.get(tree, tree)
        case tuple():
            return tuple(bind(part, values) for part in tree)
        case Call("BOUND", (Term(name),)) if name in values:
            return Term("true")
        case Triple():
            subject, target = bind(tree.subject, values), bind(tree.object, values)
            predicate = bind(tree.predicate, values)
            if predicate.operator.startswith('"'):
                return Filter(Term("false"))
            return Triple(subject, predicate, target)
    if not is_dataclass(tree):
        return tree
    parts = {given.name: bind(getattr(tree, given.name), values) for given in fields(tree)}
    return type(tree)(**parts)


def parts_of(tree: Any) -> Iterator[Any]:
    """A tree and all trees in it."""
    yield tree
    if isinstance(tree, tuple):
        for part in tree:
            yield from parts_of(part)
    elif is_dataclass(tree):
        for given in fields(tree):
            yield from parts_of(getattr(tree, given.name))


def variables_of(group: Group) -> list[str]:
    """The variables in scope behind a group, in order."""
    found: dict[str, None] = {}
    for element in group.elements:
        match element:
            case Triple():
                for part in (element.subject, element.predicate.operator, element.object):
                    if part.startswith("?") and len(part) > 1:
                        found[part] = None
            case Bind():
                found[element.variable] = None
            case Values():
                found.update(dict.fromkeys(element.variables))
            case Optional() | InWindow():
                found.update(dict.fromkeys(variables_of(element.group)))
                if isinstance(element, InWindow) and element.name.startswith("?"):
                    found[element.name] = None
            case Group():
                found.update(dict.fromkeys(variables_of(element)))
            case Union():
                for side in element.sides:
                    found.update(dict.fromkeys(variables_of(side)))
            case Select():
                found.update(dict.fromkeys(name for name, _ in element.items))
            case Filter() | Minus():
                pass
    return list(found)
