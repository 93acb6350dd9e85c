"""The parser of SPARQL 1.1 expressions ([107]-[128]), by precedence.

Contract: nesting is bounded. The tokenizer bounds brackets (`tokens.Lexer`); this module bounds
runs of ``!`` and the height of the tree. Each operator of a chain adds one to the height, since
later passes turn chains into binary operators.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from pyoxigraph import Literal, NamedNode, Variable

from .ast import (
    Aggregate,
    Arithmetic,
    Call,
    Comparison,
    Exists,
    Expression,
    FunctionCall,
    Group,
    In,
    Logical,
    Unary,
)
from .cursor import Cursor
from .errors import Span
from .terms import string_text
from .tokens import Kind, Token

COMPARISONS: Final = ("=", "!=", "<", ">", "<=", ">=")
AGGREGATES: Final = ("COUNT", "SUM", "MIN", "MAX", "AVG", "SAMPLE", "GROUP_CONCAT")
MOST_IN_A_ROW: Final = 64
"""Up to this length each ``||`` or ``&&`` of a chain adds one to the height; longer chains are
halved."""
MOST_NEGATIONS: Final = 64
_MANY: Final = 1 << 20
# [121] BuiltInCall: name -> least and greatest number of arguments.
FUNCTIONS: Final = {
    **dict.fromkeys(("RAND", "NOW", "UUID", "STRUUID"), (0, 0)),
    "BNODE": (0, 1),
    **dict.fromkeys(
        (
            *("STR", "LANG", "DATATYPE", "IRI", "URI", "ABS", "CEIL", "FLOOR", "ROUND", "STRLEN"),
            *("UCASE", "LCASE", "ENCODE_FOR_URI", "YEAR", "MONTH", "DAY", "HOURS", "MINUTES"),
            *("SECONDS", "TIMEZONE", "TZ", "MD5", "SHA1", "SHA256", "SHA384", "SHA512", "BOUND"),
            *("ISIRI", "ISURI", "ISBLANK", "ISLITERAL", "ISNUMERIC"),
        ),
        (1, 1),
    ),
    **dict.fromkeys(
        (
            *("LANGMATCHES", "CONTAINS", "STRSTARTS", "STRENDS", "STRBEFORE", "STRAFTER"),
            *("STRLANG", "STRDT", "SAMETERM"),
        ),
        (2, 2),
    ),
    "IF": (3, 3),
    "REGEX": (2, 3),
    "SUBSTR": (2, 3),
    "REPLACE": (3, 4),
    "CONCAT": (0, _MANY),
    "COALESCE": (0, _MANY),
}


class ExpressionReader(Cursor):
    """Reads expressions. `height` is the height of the expression read last."""

    height = 0
    aggregates = False
    """Whether an aggregate is allowed at this point."""

    def group(self) -> Group:
        """[53] GroupGraphPattern."""
        raise NotImplementedError

    def check_call(self, call: FunctionCall) -> None:
        """Raise `LanguageError` for an unknown function IRI. The base class accepts all."""

    def expression(self) -> Expression:
        """[110] Expression."""
        return self._logical("||")

    def _logical(self, operator: str) -> Expression:
        """[111] ConditionalOrExpression, [112] ConditionalAndExpression."""
        operands = [self._logical("&&") if operator == "||" else self._relational()]
        height = self.height
        while self._is_operator(operator):
            self.take()
            operands.append(self._logical("&&") if operator == "||" else self._relational())
            height = max(height, self.height)
        if len(operands) == 1:
            return operands[0]
        steps = len(operands) - 1
        self._rise(height + min(steps, MOST_IN_A_ROW + steps.bit_length()))
        return Logical(operator, tuple(operands))

    def _relational(self) -> Expression:
        """[114] RelationalExpression."""
        left = self._additive()
        operator = self.operator()
        if operator is None:
            return left
        height = self.height
        if operator.is_mark(*COMPARISONS):
            self.take()
            right = self._additive()
            self.height = max(height, self.height)
            return Comparison(operator.text, left, right)
        negated = operator.is_word("NOT")
        if not negated and not operator.is_word("IN"):
            return left
        self.take()
        if negated and not self.accept_word("IN"):
            raise self.unexpected("write `?x NOT IN (…)`")
        options = self._expression_list()
        self.height = max(height, self.height)
        return In(left, options, negated)

    def _additive(self) -> Expression:
        """[116] AdditiveExpression."""
        return self._chain(self._multiplicative, "+", "-")

    def _multiplicative(self) -> Expression:
        """[117] MultiplicativeExpression."""
        return self._chain(self._unary, "*", "/")

    def _chain(self, operand: Callable[[], Expression], *operators: str) -> Expression:
        first = operand()
        rest: list[tuple[str, Expression]] = []
        height = self.height
        while self._is_operator(*operators):
            sign = self.take().text
            rest.append((sign, operand()))
            height = max(height, self.height) + 1
            self._rise(height)
        return Arithmetic(first, tuple(rest)) if rest else first

    def _is_operator(self, *marks: str) -> bool:
        here = self.operator()
        return here is not None and here.kind is Kind.MARK and here.text in marks

    def _rise(self, height: int) -> None:
        """Set the height of the tree. Raises `LanguageError` above the limit."""
        self.height = height
        if height > self.limits.operators:
            raise self.error(
                f"more than {self.limits.operators} operators are nested",
                self.last_token,
                "ask with several queries, one after the other",
            )

    def _unary(self) -> Expression:
        """[118] UnaryExpression, with any number of ``!`` as in SPARQL 1.2."""
        if self.is_signed_number():
            # The sign is part of the number ([131], [132]).
            self.height = 0
            return _constant(self.term())
        if self.is_mark("+", "-"):
            sign = self.take()
            operand = self._primary()
            self._rise(self.height + 1)
            return Unary(sign.text, operand)
        signs = 0
        while self.is_mark("!"):
            token = self.take()
            signs += 1
            if signs > MOST_NEGATIONS:
                message = f"more than {MOST_NEGATIONS} negations in a row"
                raise self.error(message, token)
        found = self._primary()
        for _ in range(signs):
            found = Unary("!", found)
        if signs:
            self._rise(self.height + signs)
        return found

    def _primary(self) -> Expression:
        """[119] PrimaryExpression."""
        here = self.here
        self.height = 0
        if here is None:
            raise self.unexpected()
        if here.is_mark("("):
            self.take()
            found = self._logical("||")
            self.expect(")")
            return found
        match here.kind:
            case Kind.IRI | Kind.PREFIXED:
                return self._iri_or_function()
            case Kind.WORD if not here.is_word("TRUE", "FALSE"):
                return self.built_in()
            case Kind.VARIABLE | Kind.STRING | Kind.NUMBER | Kind.WORD:
                return _constant(self.term())
            case _:
                raise self.unexpected()

    def bracketted(self) -> Expression:
        """[120] BrackettedExpression."""
        self.expect("(")
        found = self.expression()
        self.expect(")")
        return found

    def expect(self, mark: str) -> Token:
        """Take ``mark``, the only token allowed here."""
        if not self.is_mark(mark):
            raise self.unexpected()
        return self.take()

    def _iri_or_function(self) -> Expression:
        """[128] iriOrFunction."""
        token = self.take()
        iri = NamedNode(self.iri_of(token))
        if not self.is_mark("("):
            return iri
        found = FunctionCall(iri, self._expression_list(), token.span)
        self.check_call(found)
        return found

    def function_call(self) -> FunctionCall:
        """[70] FunctionCall."""
        found = self._iri_or_function()
        if not isinstance(found, FunctionCall):
            raise self.unexpected("a function is called with its arguments in brackets")
        return found

    def _expression_list(self) -> tuple[Expression, ...]:
        """[72] ExpressionList, [71] ArgList."""
        self.expect("(")
        found: list[Expression] = []
        height = 0
        while not self.is_mark(")"):
            found.append(self._logical("||"))
            height = max(height, self.height)
            if self.is_mark(")"):
                break
            self.expect(",")
            if self.is_mark(")"):
                raise self.unexpected()
        self.take()
        self.height = height
        return tuple(found)

    def built_in(self) -> Expression:
        """[121] BuiltInCall."""
        here = self.here
        name = "" if here is None or here.kind is not Kind.WORD else here.text.upper()
        if here is None or not (
            name in FUNCTIONS or name in AGGREGATES or name in ("EXISTS", "NOT")
        ):
            raise self.unexpected()
        if name in ("EXISTS", "NOT"):
            self.take()
            if name == "NOT" and not self.accept_word("EXISTS"):
                raise self.unexpected("write `NOT EXISTS {…}`, or `!` before a condition")
            before, self.aggregates = self.aggregates, False
            found = Exists(self.group(), name == "NOT")
            self.aggregates = before
            self.height = 0
            return found
        if name in AGGREGATES:
            if not self.aggregates:
                raise self.unexpected(
                    "aggregates are allowed in the head, HAVING and ORDER BY, but not nested"
                )
            return self._aggregate(self.take())
        token = self.take()
        arguments = self._expression_list()
        least, most = FUNCTIONS[name]
        if not least <= len(arguments) <= most:
            counted = str(least) if least == most else f"{least} to {most}"
            plural = "" if counted == "1" else "s"
            raise self.error(
                f"`{token.text}` takes {counted} argument{plural}, not {len(arguments)}", token
            )
        if name == "BOUND" and not isinstance(arguments[0], Variable):
            raise self.error("`BOUND` takes a variable", token, "write `BOUND(?x)`")
        return Call(name, arguments)

    def _aggregate(self, word: Token) -> Aggregate:
        """[127] Aggregate."""
        name = word.text.upper()
        self.expect("(")
        distinct = self.accept_word("DISTINCT")
        self.aggregates = False
        argument: Expression | None = None
        if name == "COUNT" and self.is_mark("*"):
            self.take()
            self.height = 0
        else:
            argument = self.expression()
        self.aggregates = True
        separator = None
        if name == "GROUP_CONCAT" and self.accept_mark(";"):
            if not self.accept_word("SEPARATOR"):
                raise self.unexpected("write `; SEPARATOR = ', '`")
            self.expect("=")
            if self.here is None or self.here.kind is not Kind.STRING:
                raise self.unexpected("write `; SEPARATOR = ', '`")
            separator = string_text(self.take(), self.source)
        self.expect(")")
        return Aggregate(name, argument, distinct, separator)

    def constraint(self) -> Expression:
        """[69] Constraint."""
        self.height = 0
        if self.is_mark("("):
            return self.bracketted()
        here = self.here
        if here is not None and here.kind in (Kind.IRI, Kind.PREFIXED):
            return self.function_call()
        return self.built_in()

    def alias(self) -> tuple[Expression, Variable, Span]:
        """Read ``(expression AS ?v)`` and return its span too."""
        opened = self.expect("(")
        found = self.expression()
        if not self.accept_word("AS"):
            raise self.unexpected("write `(expression AS ?name)`")
        name = self.named_variable()
        closed = self.expect(")")
        return found, name, Span(opened.start, closed.end)

    def named_variable(self) -> Variable:
        """[108] Var."""
        if self.here is None or self.here.kind is not Kind.VARIABLE:
            raise self.unexpected()
        return Variable(self.take().text[1:])


def _constant(term: object) -> Variable | NamedNode | Literal:
    assert isinstance(term, Variable | NamedNode | Literal)
    return term
