"""Queries of the differential test: an abstract syntax.

Trees are frozen and hold only tuples, texts and trees, so that `differential_shrinking` can take
any part away. `differential_texts` prints them.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, assert_never

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
