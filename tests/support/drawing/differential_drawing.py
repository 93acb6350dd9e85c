"""Random cases of the differential test: a query, its windows, its options, and all triples.

Drawn from a seed by a generator of its own, not by Hypothesis: a case has some thousand choices,
and to record them would take longer than the case. `differential_shrinking` makes a failing case
small: it takes parts of the query's tree and of the data away, not choices. Over 400 lines: one
method for each rule of the grammar.
"""

from dataclasses import replace
from random import Random

from differential_cases import (
    BASE,
    BOOLEANS,
    DECIMALS,
    DOUBLES,
    FLOATING,
    FLOATS,
    HUGE,
    INSTANTS,
    INTEGERS,
    SECOND,
    SPECIAL,
    STRINGS,
    TAGGED,
    Case,
    Element,
    WindowOf,
)
from differential_queries import (
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
    parts_of,
    variables_of,
)  # fmt: skip
from pyoxigraph import NamedNode
from standard_values import Term as RdfTerm
from standard_values import number

NODES = ("a", "b", "c")
CLASSES = ("K", "L")
TYPE = NamedNode("http://www.w3.org/1999/02/22-rdf-syntax-ns#type")
NODE_VARIABLES = ("?a", "?b", "?c")
VALUE_VARIABLES = ("?v", "?w", "?x")
VALUE_PREDICATES = (":p", ":q")
NODE_PREDICATES = (":r", ":s")

# What a column holds where Oxigraph's own operators are right (`Case.exact` is false).
PLAIN = (
    INTEGERS, [*INTEGERS, *DECIMALS], [*INTEGERS, *DECIMALS, *DOUBLES], DOUBLES, STRINGS, INSTANTS,
)  # fmt: skip
EXACT = (
    [*INTEGERS, *HUGE], [*INTEGERS, *DECIMALS, *DOUBLES, *FLOATS, *SPECIAL], [*INTEGERS, *BOOLEANS],
    [*INTEGERS, *STRINGS], [*BOOLEANS, *STRINGS, *TAGGED], [*INSTANTS, *FLOATING, *INTEGERS],
    [*INTEGERS, *DECIMALS, *DOUBLES, *FLOATS, *SPECIAL, *HUGE, *BOOLEANS, *STRINGS, *TAGGED,
     *INSTANTS],
)  # fmt: skip

NUMERIC = ("+", "-", "*", "/", "neg", "ABS", "CEIL", "FLOOR", "ROUND")
NOT_NUMERIC = ("IF", "COALESCE", "STR", "LANG", "DATATYPE", "STRLEN", "truth")


def draw(seed: int) -> Case:
    return Drawing(Random(seed)).case()


class Drawing:
    def __init__(self, random: Random) -> None:
        self.random = random
        self.exact = random.random() < 0.5
        self.palette = random.choice(EXACT if self.exact else PLAIN)
        self.numbers = sum(number(given) is not None for given in self.palette) * 2 > len(
            self.palette
        )
        self.fresh = 0
        self.windows: tuple[WindowOf, ...] = ()
        self.bag = False

    def chance(self, share: float) -> bool:
        return self.random.random() < share

    def new_variable(self) -> str:
        self.fresh += 1
        return f"?n{self.fresh}"

    # The case around the query.

    def case(self) -> Case:
        random = self.random
        self.windows = self.some_windows()
        case = Case(
            query=Ask(Group(())),
            windows=self.windows,
            elements=(),
            operator=random.choice(("RSTREAM",) * 6 + ("ISTREAM", "DSTREAM")),
            semantics=random.choice(("", "", "bag", "set")),
            bounds=random.choice(("(]", "(]", "[)")),
            origin=random.choice((0, 0, SECOND // 2)),
            lateness=random.choice((None, 0, SECOND, 3 * SECOND)),
            report=random.choice(("non-empty",) * 6 + ("change", "close")),
            exact=self.exact,
        )
        self.bag = case.bag
        least = min(window.step for window in self.windows)
        if case.origin == 0 and self.chance(0.2):
            case = replace(case, every=least * random.choice((1, 2)))
        static = tuple(sorted({self.triple_of(0.6) for _ in range(random.randrange(12))}, key=str))
        query = self.query()
        if any(
            isinstance(part, Aggregate) and part.name == "GROUP_CONCAT" for part in parts_of(query)
        ):
            # Its order is free, so that it may differ from the one before at any window.
            case = replace(case, operator="RSTREAM", semantics="bag" if case.bag else "set")
        return replace(case, query=query, elements=self.elements(), static=static)

    def some_windows(self) -> tuple[WindowOf, ...]:
        shape = self.random.choice(("one", "one", "one", "two", "named", "named pair", "mixed"))
        lengths = ((4, 1), (5, 1), (6, 1), (8, 1), (3, 1), (2, 1), (6, 2), (2, 3))

        def window(name: str, stream: int) -> WindowOf:
            length, step = self.random.choice(lengths)
            return WindowOf(name, stream, length * SECOND, step * SECOND)

        match shape:
            case "one":
                return (window("", 0),)
            case "two":
                return window("", 0), window("", 1)
            case "named":
                return (window(":w0", 0),)
            case "named pair":
                return window(":w0", 0), window(":w1", self.random.randrange(2))
        return window("", 0), window(":w1", 1)

    def elements(self) -> tuple[Element, ...]:
        streams = sorted({window.stream for window in self.windows})
        length = self.random.choice((60, 100, 200))
        times = [
            self.random.randrange(2, length) * SECOND // 2
            for _ in range(length * self.random.choice((2, 3, 4)) // 2)
        ]
        times.sort()
        for _ in range(self.random.choice((0, 3, 12))):
            place = self.random.randrange(len(times) - 1)
            times[place], times[place + 1] = times[place + 1], times[place]
            times.insert(self.random.randrange(len(times)), self.random.choice(times))
        return tuple(
            Element(self.random.choice(streams), time, *self.triple_of(0.0 if self.bag else 0.15))
            for time in times
        )

    def triple_of(self, types: float) -> tuple[RdfTerm, RdfTerm, RdfTerm]:
        random = self.random
        subject = NamedNode(BASE + random.choice(NODES))
        if self.chance(types):
            return subject, TYPE, NamedNode(BASE + random.choice(CLASSES))
        if self.chance(0.4):
            predicate = random.choice(NODE_PREDICATES)
            return subject, NamedNode(BASE + predicate[1:]), NamedNode(BASE + random.choice(NODES))
        predicate = random.choice(VALUE_PREDICATES)
        return subject, NamedNode(BASE + predicate[1:]), random.choice(self.palette)

    # The query.

    def query(self) -> Query:
        if self.chance(0.08):
            return self.timed()
        where = self.where()
        seen = variables_of(where)
        if self.chance(0.1):
            return Ask(where)
        if self.chance(0.15):
            return Construct(
                tuple(self.head_triple(seen) for _ in range(self.random.choice((1, 2)))), where
            )
        if self.chance(0.4):
            return self.aggregated(where, seen, classic=self.chance(0.2))
        return self.selected(where, seen)

    def timed(self) -> Query:
        """A query of the times of what its patterns match, all in one group."""
        random = self.random
        objects = random.sample(("?v", "?w", "?b"), random.choice((1, 2, 2, 3)))
        predicates = [
            random.choice(NODE_PREDICATES if o == "?b" else VALUE_PREDICATES) for o in objects
        ]
        triples = [Triple("?a", Path(p), o) for p, o in zip(predicates, objects, strict=True)]

        def time() -> Expression:
            if self.chance(0.3):
                triple = random.choice(triples)
                whole = (triple.subject, str(triple.predicate), triple.object)
                return Call(TIMESTAMP, tuple(map(Term, whole)))
            return Call(TIMESTAMP, (Term(random.choice(("?a", *objects))),))

        elements: list[Pattern] = [*triples]
        if self.chance(0.5):
            bound = (
                time() if self.chance(0.6) else Term(str(random.randrange(2, 200) * SECOND // 2))
            )
            elements.append(Filter(Call(random.choice("<>="), (time(), bound))))
        elements.append(Bind(time(), "?n0"))
        group = Group(tuple(elements))
        window = random.choice(self.windows)
        where = Group((InWindow(window.name, group),)) if window.name else group
        if self.chance(0.3):
            name = random.choice(("MIN", "MAX", "COUNT", "SUM"))
            items = (("?a", None), ("?n1", Aggregate(name, False, Term("?n0"))))
            return Select(False, items, where, ("?a",))
        return Select(self.chance(0.3), tuple((v, None) for v in ("?a", *objects, "?n0")), where)

    def head_triple(self, seen: list[str]) -> Triple:
        nodes = [v for v in seen if v in NODE_VARIABLES] or [":a"]
        return Triple(
            self.random.choice(nodes),
            Path(self.random.choice((":out", ":p"))),
            self.random.choice(seen or [":a"]),
        )

    def where(self) -> Group:
        """A group with at least one pattern over each kind of graph that has a window."""
        named = [window.name for window in self.windows if window.name]
        if not named:
            return self.group(self.random.choice((0, 0, 1, 2)))
        elements: list[Pattern] = []
        for name in named if self.chance(0.7) else named[:1]:
            asked = "?win" if self.chance(0.1) else name
            inner = self.group(self.random.choice((0, 1)), minus=asked != "?win")
            elements.append(InWindow(asked, inner))
        if self.chance(0.15) or len(named) < len(self.windows):
            elements.append(self.basic())
        self.add_filters(elements, 1)
        if self.chance(0.3):
            elements.append(Optional(Group((InWindow(self.random.choice(named), self.group(0)),))))
        if self.chance(0.2):
            inside = Group((InWindow(self.random.choice(named), self.group(0)),))
            elements.append(
                Minus(inside) if self.chance(0.5) else Filter(Exists(self.chance(0.5), inside))
            )
        return Group(tuple(elements))

    def group(self, depth: int, minus: bool = True) -> Group:
        """Without ``minus`` for a window of a variable: a bag's oracle cannot say what is in it."""
        random = self.random
        elements: list[Pattern] = [
            self.basic()
            for _ in range(random.choice((1, 1, 1, 2, 2, 3) if depth == 2 else (1, 1, 2)))
        ]
        for _ in range(random.choice((0, 1, 1, 2)) if depth else 0):
            kind = random.choice(
                ("optional", "optional", "union", "minus", "values", "bind", "sub")
            )
            if kind == "optional":
                elements.append(Optional(self.group(depth - 1, minus)))
            elif kind == "union":
                elements.append(Union((self.group(depth - 1, minus), self.group(depth - 1, minus))))
            elif kind == "minus" and minus:
                elements.append(Minus(self.group(depth - 1)))
            elif kind == "values":
                elements.append(self.values())
            elif kind == "bind":
                seen = variables_of(Group(tuple(elements)))
                elements.append(Bind(self.value(seen, 2), self.new_variable()))
            elif kind == "sub" and minus:
                elements.append(self.subselect(depth, minus))
        self.add_filters(elements, depth if minus else 0)
        return Group(tuple(elements))

    def add_filters(self, elements: list[Pattern], depth: int) -> None:
        seen = variables_of(Group(tuple(elements)))
        count = self.random.choice((0, 0, 0, 1, 1, 2) if depth else (0, 0, 1))
        elements += [Filter(self.condition(seen, 2, exists=depth > 0)) for _ in range(count)]

    def basic(self) -> Pattern:
        random = self.random
        subject = random.choice(("?a",) * 6 + ("?b", "?b", "?c", ":a"))
        share = random.random()
        if share < 0.5:
            predicate = random.choice(VALUE_PREDICATES)
            usual = "?v" if predicate == ":p" else "?w"
            given = random.choice((usual,) * 8 + VALUE_VARIABLES + (self.constant(),))
            return Triple(subject, Path(predicate), given)
        if share < 0.75:
            others = [name for name in NODE_VARIABLES if name != subject]
            given = random.choice((*others * 4, *NODE_VARIABLES, ":b"))
            return Triple(subject, Path(random.choice(NODE_PREDICATES)), given)
        if share < 0.80:
            return Triple(subject, Path("a"), random.choice((":K", ":L")))
        if share < 0.86:
            return Triple(subject, Path("?predicate"), random.choice(("?b", "?v", ":b")))
        return Triple(subject, self.path(2), random.choice(("?a", "?b", "?b", "?c", "?v")))

    def path(self, depth: int) -> Path:
        random = self.random
        kind = random.choice("/|^+*?!p") if depth else "p"
        if kind in "/|":
            return Path(kind, (self.path(depth - 1), self.path(depth - 1)))
        if kind in "^+*?":
            return Path(kind, (self.path(depth - 1),))
        if kind == "!":
            return Path(
                "!", (Path("a"), Path(random.choice((*NODE_PREDICATES, *VALUE_PREDICATES))))
            )
        return Path(random.choice((*NODE_PREDICATES, *NODE_PREDICATES, *VALUE_PREDICATES)))

    def values(self) -> Values:
        if self.chance(0.5):
            rows = [
                (self.random.choice((":a", ":b", "UNDEF")),)
                for _ in range(self.random.choice((1, 2, 2)))
            ]
            return Values((self.random.choice(NODE_VARIABLES),), tuple(rows))
        pairs = [
            (
                self.random.choice((":a", ":b", ":c", "UNDEF")),
                self.random.choice((self.constant(), "UNDEF")),
            )
            for _ in range(self.random.choice((1, 2, 3)))
        ]
        return Values(("?a", self.random.choice(VALUE_VARIABLES)), tuple(pairs))

    def subselect(self, depth: int, minus: bool) -> Select:
        where = self.group(depth - 1, minus)
        seen = variables_of(where)
        if self.chance(0.5):
            return self.aggregated(where, seen, classic=False)
        return self.selected(where, seen)

    def selected(self, where: Group, seen: list[str]) -> Select:
        names = self.some_of(seen)
        items: list[tuple[str, Expression | None]] = [(name, None) for name in names]
        if self.chance(0.3) or not items:
            items.append((self.new_variable(), self.value(seen, 2)))
        return Select(self.chance(0.3), tuple(items), where)

    def some_of(self, names: list[str]) -> list[str]:
        return [name for name in names if self.chance(0.7)]

    def aggregated(self, where: Group, seen: list[str], classic: bool) -> Select:
        random = self.random
        keys = tuple(name for name in seen if self.chance(0.35))
        items: list[tuple[str, Expression | None]] = [(key, None) for key in keys]
        if classic:
            name, given = self.new_variable(), random.choice(seen or ["?v"])
            function = random.choice(("SUM", "AVG", "MIN", "MAX", "COUNT"))
            items.append((name, Aggregate(function, False, Term(given))))
            having = (
                (Call(random.choice("<>"), (Term(name), Term("1"))),) if self.chance(0.5) else ()
            )
            return Select(False, tuple(items), where, keys, having, classic=True)
        for _ in range(random.choice((1, 1, 2))):
            given = self.aggregate(seen)
            if self.chance(0.15) and given.name != "GROUP_CONCAT":
                items.append((self.new_variable(), Call("+", (given, Term("1")))))
            else:
                items.append((self.new_variable(), given))
        conditions = []
        if self.chance(0.35):
            name = random.choice(("SUM", "AVG", "MIN", "MAX", "COUNT"))
            given = Aggregate(name, self.chance(0.2), self.value(seen, 1))
            operator = random.choice(("<", ">", "=", ">=", "!="))
            conditions.append(Call(operator, (given, Term(self.constant()))))
        return Select(self.chance(0.1), tuple(items), where, keys, tuple(conditions))

    def aggregate(self, seen: list[str]) -> Aggregate:
        name = self.random.choice(
            ("COUNT", "SUM", "AVG", "MIN", "MAX", "SUM", "MAX", "GROUP_CONCAT")
        )
        distinct = self.chance(0.25)
        if name == "GROUP_CONCAT":
            return Aggregate(name, distinct, Call("STR", (self.variable(seen),)))
        if name == "COUNT" and self.chance(0.4):
            return Aggregate(name, False, None)
        return Aggregate(name, distinct, self.value(seen, 1))

    # Expressions.

    def variable(self, seen: list[str]) -> Term:
        if not seen or self.chance(0.03):
            return Term("?v")
        values = [name for name in seen if name not in NODE_VARIABLES]
        return Term(self.random.choice(values if values and self.chance(0.9) else seen))

    def constant(self) -> str:
        return str(self.random.choice(self.palette if self.chance(0.85) else INTEGERS))

    def condition(self, seen: list[str], depth: int, exists: bool = False) -> Expression:
        random = self.random
        if depth == 0:
            return (
                self.variable(seen) if self.exact and self.chance(0.2) else self.comparison(seen, 0)
            )
        kind = random.choice(
            ("compare",) * 6
            + (
                "&&",
                "||",
                "||",
                "!",
                "bound",
                "in",
                "test",
                "same",
                "exists",
                "exists",
                "ebv",
                "text",
            )
        )
        if kind == "exists" and exists:
            return Exists(self.chance(0.5), self.existing())
        if kind in ("&&", "||"):
            return Call(
                kind, (self.condition(seen, depth - 1, exists), self.condition(seen, depth - 1))
            )
        if kind == "!":
            return Call("!", (self.condition(seen, depth - 1, exists),))
        if kind == "bound":
            return Call("BOUND", (self.variable(seen),))
        if kind == "in":
            options = tuple(self.value(seen, 0) for _ in range(random.choice((1, 2, 3))))
            return Call(random.choice(("IN", "NOT IN")), (self.value(seen, 1), *options))
        if kind == "test":
            return Call(random.choice(("isIRI", "isLiteral", "isNumeric")), (self.variable(seen),))
        if kind == "same":
            return Call("sameTerm", (self.variable(seen), self.value(seen, 0)))
        if kind == "ebv" and self.exact:
            return self.value(seen, 1)
        if kind == "text":
            return Call(
                random.choice(("CONTAINS", "REGEX")),
                (Call("STR", (self.variable(seen),)), Term('"1"')),
            )
        return self.comparison(seen, depth - 1)

    def comparison(self, seen: list[str], depth: int) -> Expression:
        operator = self.random.choice(("=", "!=", "<", ">", "<=", ">="))
        return Call(operator, (self.value(seen, depth), self.value(seen, depth)))

    def existing(self) -> Group:
        elements: list[Pattern] = [self.basic() for _ in range(self.random.choice((1, 1, 2)))]
        seen = list(dict.fromkeys([*variables_of(Group(tuple(elements))), *VALUE_VARIABLES]))
        if self.chance(0.4):
            elements.append(Filter(self.condition(seen, 1)))
        if self.chance(0.15):
            elements.append(Optional(Group((self.basic(),))))
        if self.chance(0.1):
            elements.append(Minus(Group((self.basic(),))))
        return Group(tuple(elements))

    def value(self, seen: list[str], depth: int) -> Expression:
        random = self.random
        if depth == 0 or self.chance(0.45):
            return self.variable(seen) if self.chance(0.7) else Term(self.constant())
        kind = random.choice(NUMERIC * (2 if self.numbers else 0) + NOT_NUMERIC)
        if kind in "+-*/":
            return Call(kind, (self.value(seen, depth - 1), self.value(seen, depth - 1)))
        if kind == "IF":
            return Call(
                kind,
                (
                    self.condition(seen, depth - 1),
                    self.value(seen, depth - 1),
                    self.value(seen, depth - 1),
                ),
            )
        if kind == "COALESCE":
            return Call(kind, (self.value(seen, depth - 1), self.value(seen, depth - 1)))
        if kind == "STRLEN":
            return Call(kind, (Call("STR", (self.variable(seen),)),))
        if kind in ("STR", "LANG", "DATATYPE"):
            return Call(kind, (self.variable(seen),))
        if kind == "truth":
            return self.condition(seen, depth - 1)
        return Call(kind, (self.value(seen, depth - 1),))
