"""Checks KPL declarations against earlier ones and the ontology ([DyKnow10 Def. 4.6, 5.13-5.20]).

The paper leaves these rules open. A declaration precedes the uses of its symbol. Repeating a
declaration exactly changes nothing. Symbols are unique, but a sort and a feature may share a name,
as in Example 5.5. All generators of a feature have the same number of objects.
"""

from __future__ import annotations

from typing import Final, assert_never

from ...ontology.vocabulary import Vocabulary
from ...streams.policies.policy import Policy
from ..errors import LanguageError, Span
from . import ast
from .constraints import UNITS, to_policy
from .declarations import (
    PROCESSES,
    CheckedDeclaration,
    CompunitDeclaration,
    ForeachDeclaration,
    GeneratorDeclaration,
    Label,
    SinkDeclaration,
    SourceDeclaration,
    StreamDeclaration,
)
from .dependencies import generator_needs
from .generators import Generators
from .parser import parse_constraints, parse_label_term
from .printer import format_kpl
from .scope import Scope, check_unit, label_of
from .signature import Signature
from .sorts import BUILT_IN, declared_sort, read_sort
from .symbols import COMPUNIT, FEATURE, SINK, SOURCE, STREAM, Symbols

EMPTY: Final = Signature()


def check_kpl(
    specification: ast.Specification,
    source: str,
    vocabulary: Vocabulary | None = None,
    signature: Signature = EMPTY,
    unit: str = "ms",
) -> tuple[tuple[CheckedDeclaration, ...], Signature]:
    """Return what ``parse_kpl(source)`` adds to ``signature``: the new declarations, and all of
    them.

    ``unit`` is the unit of integers if the text states none. Without ``vocabulary`` no sort belongs
    to a feature. Raises `LanguageError` at the first invalid declaration; then nothing of the text
    is declared. Cost: linear in the text and the signature.
    """
    if specification.unit is not None:
        written = specification.unit
        unit = written.text
        if unit not in UNITS:
            raise LanguageError(
                f"`{unit}` is not a unit of abstract time", source, written.span, "ns, us, ms or s"
            )
    check_unit(unit)
    symbols = Symbols(BUILT_IN, signature.declarations)
    written_down = specification.declarations
    scope = Scope(source, unit, vocabulary, written_down, dict(signature.by_key), symbols)
    checker = _Checker(scope)
    for declaration in written_down:
        checker.declare(declaration)
    new = tuple(checker.new)
    return new, signature.with_declarations(new) if new else signature


def parse_policy(source: str, unit: str = "ms") -> Policy:
    """Parse a single policy, such as that of a subscription: ``any change, max delay 5s``; may be
    empty. Raises `LanguageError`."""
    check_unit(unit)
    return to_policy(parse_constraints(source), source, unit)


def parse_label(source: str) -> Label:
    """Parse a single label to its canonical form: ``dyknow:pos[ car1 ]`` is ``pos[car1]``. Raises
    `LanguageError`."""
    return label_of(parse_label_term(source), source)


class _Checker:
    """Declares a text's declarations in order; ``new`` are those that did not exist."""

    def __init__(self, scope: Scope) -> None:
        self.new: list[CheckedDeclaration] = []
        self._scope = scope
        self._generators = Generators(scope)

    def declare(self, declaration: ast.Declaration) -> None:
        scope = self._scope
        match declaration:
            case ast.Source(sort, name):
                made = SourceDeclaration(name.text, read_sort(sort, scope))
                self.check_name(name.text, SOURCE, name.span)
                self.add(made, name.span)
            case ast.Compunit(sort, name, inputs):
                output = read_sort(sort, scope)
                wanted = tuple(read_sort(input, scope) for input in inputs)
                self.check_name(name.text, COMPUNIT, name.span)
                self.add(CompunitDeclaration(name.text, output, wanted), name.span)
            case ast.Strmgen(label):
                self.add(self.generator(declaration, self._generators), label.span)
            case ast.Stream(name, written):
                self.check_name(name.text, STREAM, name.span)
                term, values = self._generators.term(written)
                self.add(StreamDeclaration(name.text, values, term), name.span)
            case ast.Sort(name):
                self.add(declared_sort(declaration, scope), name.span)
            case ast.Foreach(variable, members):
                span = Span(variable.span.start, members.span.end)
                self.add(self.foreach(declaration), span)
            case ast.Sink(name, inputs):
                self.check_name(name.text, SINK, name.span)
                terms = tuple(self._generators.term(input)[0] for input in inputs)
                self.add(SinkDeclaration(name.text, terms), name.span)
            case _:
                assert_never(declaration)

    def add(self, declaration: CheckedDeclaration, span: Span) -> None:
        """Declare it, unless an equal declaration exists."""
        existing = self._scope.by_key.get(declaration.key)
        if existing is None:
            self._scope.by_key[declaration.key] = declaration
            self._scope.symbols.add(declaration)
            self.new.append(declaration)
        elif existing != declaration:
            hint = "it makes the same generators for the same objects: remove the other one first"
            if not isinstance(existing, ForeachDeclaration):
                # The last line: the first may state the unit.
                text = format_kpl(existing, self._scope.unit).splitlines()[-1]
                hint = f"there is `{text}`: remove it first, or choose another name"
            raise self._scope.error(
                f"`{declaration.key}` is declared already, and differently", span, hint
            )

    def check_name(self, name: str, kind: str, span: Span) -> None:
        """Check that a declared symbol is not predefined, and is of one kind only."""
        if name in PROCESSES:
            raise self._scope.error(
                f"`{name}` is a process of the language",
                span,
                f"choose another name; {', '.join(PROCESSES)} are predefined",
            )
        self._scope.check_symbol(name, kind, span)

    # -- generators ------------------------------------------------------------------------

    def generator(
        self, written: ast.Strmgen, generators: Generators, *members: Label
    ) -> GeneratorDeclaration:
        """Check a generator, alone or in a ``foreach`` over ``members``, with the symbols of its
        label."""
        scope, span = self._scope, written.label.span
        feature = scope.label(written.label).feature
        self.check_name(feature, FEATURE, written.label.feature.span)
        scope.check_label(written.label, generators.variables)
        made = generators.generator(written)
        reader = scope.symbols.reader(feature)
        if reader is not None and made.sort not in scope.symbols.sorts(feature):
            raise scope.error(
                f"`{made.label}` has another sort than the existing streams of `{feature}`",
                span,
                f"`{reader}` reads the streams of every object, which need one sort",
            )
        needs = (*map(str, members), *generator_needs(made, *generators.variables))
        if scope.symbols.is_circle(feature, needs):
            raise scope.error(
                f"`{made.label}` would depend on itself",
                span,
                f"`{reader or made.label}` reads `{feature}` of every object, and this is one: "
                "give it a feature of its own",
            )
        return made

    def foreach(self, declaration: ast.Foreach) -> ForeachDeclaration:
        scope = self._scope
        members = self._generators.members(declaration.members)
        inside = self._generators.bind(declaration.variable)
        variable = declaration.variable.text
        generators: list[GeneratorDeclaration] = []
        for written in declaration.generators:
            generator = self.generator(written, inside, members.label)
            label, span = generator.label, written.label.span
            if variable not in label.objects:
                raise scope.error(
                    f"`{label}` would be declared once for each object",
                    span,
                    f"its label names the object: `{label.feature}[{variable}]`",
                )
            if any(label == earlier.label for earlier in generators):
                raise scope.error(
                    f"`{label}` is declared twice for each object",
                    span,
                    "leave one of the two out",
                )
            scope.symbols.add_pattern(generator, variable, members.label)
            generators.append(generator)
        made = ForeachDeclaration(variable, members, tuple(generators))
        for generator, written in zip(generators, declaration.generators, strict=True):
            other = scope.symbols.foreach_key(members.label, generator.label, variable)
            if other not in (None, made.key):
                raise scope.error(
                    f"`{generator.label}` is made for each object already",
                    written.label.span,
                    f"`{other}` does: remove it first, or leave this one out",
                )
        return made
