"""Checks generators, their processes and their terms ([DyKnow10 Def. 4.7, 5.17-5.19]).

`check` calls this with the declarations so far. A variable of ``foreach`` stands for objects that
are known at run time: a term with one reads some generators of its feature.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from ..errors import LanguageError, Span
from ..hints import count, did_you_mean, suggest_name
from . import ast
from .constraints import to_policy, to_synchronization
from .declarations import (
    PROCESSES,
    Aggregate,
    CheckedDeclaration,
    CompunitDeclaration,
    Compute,
    FromSource,
    GeneratorDeclaration,
    JoinOf,
    Label,
    Process,
    Select,
    SelectObject,
    SinkDeclaration,
    SourceDeclaration,
    StreamDeclaration,
    Synchronize,
    Term,
    ValueSort,
)
from .scope import Scope
from .sorts import (
    fits,
    format_fields,
    misfit,
    misfit_hint,
    of_many_objects,
    tuple_sort,
)

_FORMS: Final = {
    "join": "join(pos[car1], speed[car1])",
    "sync": "sync(pos[car1], speed[car1]; sample every 100, max delay 50)",
    "aggregate": "aggregate(pos[car] foreach car in cars)",
    "select": "select(pos[car] foreach car in focus)",
    "selectObject": "selectObject(positions)",
}


@dataclass(frozen=True, slots=True)
class Generators:
    """Checks generators in a scope; ``variables`` are bound around them."""

    scope: Scope
    variables: tuple[str, ...] = ()

    def bind(self, variable: ast.Name) -> Generators:
        """Add a variable. Raises `LanguageError` if it is bound already."""
        if variable.text in self.variables:
            raise self.scope.error(
                f"`{variable.text}` is the variable of the `foreach` around this",
                variable.span,
                "choose another name",
            )
        return replace(self, variables=(*self.variables, variable.text))

    def generator(self, written: ast.Strmgen) -> GeneratorDeclaration:
        """Return the generator of ``strmgen LABEL = …``, without checking the symbols of its label.
        Raises `LanguageError`."""
        label = self.scope.label(written.label)
        name, span = written.process.text, written.process.span
        found = self.scope.by_key.get(name)
        self._check_form(written)
        if written.mediation is not None:
            return self._mediation(label, name, written.mediation)
        if not written.terms:
            if isinstance(found, SourceDeclaration):
                return GeneratorDeclaration(label, found.sort, FromSource(name))
            if isinstance(found, CompunitDeclaration) or name in PROCESSES:
                form = _FORMS.get(name, f"{name}(…)")
                raise self.scope.error(f"`{name}` needs input streams", span, f"write `{form}`")
            raise self._unknown_process(written.process, SourceDeclaration)
        if isinstance(found, SourceDeclaration):
            raise self.scope.error(
                f"`{name}` is a source, and sources take no inputs",
                span,
                f"write `strmgen {label} = {name}`",
            )
        if name not in PROCESSES and not isinstance(found, CompunitDeclaration):
            raise self._unknown_process(written.process, CompunitDeclaration)
        if name == "selectObject":
            return self._select_object(label, written)
        checked = [self.term(term) for term in written.terms]
        terms = tuple(term for term, _ in checked)
        sorts = [sort for _, sort in checked]
        if isinstance(found, CompunitDeclaration):
            self._check_inputs(found, written, sorts)
            return GeneratorDeclaration(label, found.sort, Compute(name, terms))
        made: Process = JoinOf(terms, inner_times=written.inner_times)
        if name == "sync":
            policy = to_synchronization(
                written.synchronization, self.scope.source, self.scope.unit, span
            )
            made = Synchronize(terms, policy)
        identifiers = [term.label.identifier for term in terms]
        return GeneratorDeclaration(
            label, tuple_sort(label.feature, identifiers, sorts, times=written.inner_times), made
        )

    def _check_form(self, written: ast.Strmgen) -> None:
        """Check that the inputs have the form that the process needs."""
        name = written.process.text
        if written.synchronization and name != "sync":
            raise self.scope.error(
                f"`{name}` takes no constraints of its own",
                written.synchronization[0].span,
                "constraints after `;` belong to `sync`; those of an input follow `with`",
            )
        if written.inner_times and name != "join":
            raise self.scope.error(
                f"`{name}` has no inner times",
                written.process.span,
                "only `join` has `; inner times`: a state has a valid time of its own",
            )
        mediates = name in ("aggregate", "select")
        if written.mediation is not None and not mediates:
            raise self.scope.error(
                "only `aggregate` and `select` have `foreach` among the inputs",
                written.mediation.variable.span,
                "declare a generator of one of them, and name its label here",
            )
        too_many = name == "selectObject" and len(written.terms) > 1
        if written.terms and (mediates or too_many):
            span = Span(written.terms[0].span.start, written.terms[-1].span.end)
            raise self.scope.error(
                f"these are not inputs of `{name}`", span, f"write `{_FORMS[name]}`"
            )

    def _check_inputs(
        self, unit: CompunitDeclaration, written: ast.Strmgen, sorts: list[ValueSort]
    ) -> None:
        declared = f"it is declared as {unit.name}({', '.join(s.name for s in unit.inputs)})"
        terms = written.terms
        if len(terms) != len(unit.inputs):
            first = min(len(unit.inputs), len(terms) - 1)
            raise self.scope.error(
                f"`{unit.name}` takes {count(len(unit.inputs), 'input')}, got {len(terms)}",
                terms[first].span,
                declared,
            )
        for term, sort, input in zip(terms, sorts, unit.inputs, strict=True):
            if not fits(sort, input, self.scope.vocabulary):
                raise self.scope.error(
                    f"`{unit.name}` takes a stream {misfit(sort, input)}",
                    term.label.span,
                    misfit_hint(sort, input, self.scope)
                    or self._tuple_hint(term, input)
                    or declared,
                )

    def _tuple_hint(self, term: ast.StreamTerm, input: ValueSort) -> str:
        label = self.scope.label(term.label)
        found = self.scope.by_key.get(str(label))
        tuples = isinstance(found, GeneratorDeclaration) and isinstance(
            found.process, JoinOf | Synchronize
        )
        if not tuples or label.feature == input.name:
            return ""
        return (
            f"the sort of a join or synchronization has the name of its feature: declare "
            f"`{label.feature}`, or name the feature `{input.name}`"
        )

    # -- mediation -------------------------------------------------------------------------

    def _mediation(self, label: Label, name: str, written: ast.Mediation) -> GeneratorDeclaration:
        members = self.members(written.members)
        inside = self.bind(written.variable)
        variable = written.variable.text
        pattern_label = self.scope.label(written.pattern.label)
        if variable not in pattern_label.objects:
            raise self.scope.error(
                f"`{variable}` is not an object of `{pattern_label}`",
                written.pattern.label.span,
                f"write `{pattern_label.feature}[{variable}]`",
            )
        pattern, sort = inside.term(written.pattern)
        if name == "select":
            return GeneratorDeclaration(label, sort, Select(variable, pattern, members))
        process = Aggregate(variable, pattern, members)
        return GeneratorDeclaration(label, of_many_objects(sort), process)

    def members(self, written: ast.StreamTerm) -> Term:
        """Check a term whose samples name objects."""
        term, sort = self.term(written)
        self._check_names_objects(term, sort, written)
        return term

    def _select_object(self, label: Label, written: ast.Strmgen) -> GeneratorDeclaration:
        if len(label.objects) != 1:
            raise self.scope.error(
                f"`{label}` does not name the object to select",
                written.process.span,
                "the label names one object: `strmgen pos[car1] = selectObject(positions)`",
            )
        term, sort = self.term(written.terms[0])
        self._check_names_objects(term, sort, written.terms[0])
        return GeneratorDeclaration(label, sort, SelectObject(term))

    def _check_names_objects(self, term: Term, sort: ValueSort, written: ast.StreamTerm) -> None:
        """Check that the sort has a text field, which names objects; an open sort may get one."""
        if sort.fields is not None and sort.object_field is None:
            raise self.scope.error(
                f"`{term.label}` is of sort `{sort.name}`, which has no field that names an object",
                written.label.span,
                "its sort needs a text, such as `object` or a structured sort with `id string`",
            )

    # -- terms -----------------------------------------------------------------------------

    def term(self, written: ast.StreamTerm) -> tuple[Term, ValueSort]:
        """Return a term that reads a declared generator, and the sort of its values."""
        label, span = self.scope.label(written.label), written.label.span
        term = Term(label, to_policy(written.policy, self.scope.source, self.scope.unit))
        if not set(self.variables).isdisjoint(label.objects):
            return term, self._pattern_sort(label, span)
        found = self.scope.by_key.get(str(label))
        if isinstance(found, GeneratorDeclaration):
            return term, found.sort
        if isinstance(found, StreamDeclaration):
            raise self.scope.error(
                f"`{label}` is a stream, and a term names a generator",
                span,
                f"write the label that it is made from: `{found.term.label}`",
            )
        raise self._unknown_label(label, span)

    def _pattern_sort(self, label: Label, span: Span) -> ValueSort:
        """Return the sort of a label with a variable: that of all generators of its feature."""
        self.scope.check_arity(label, span)
        sorts = self.scope.symbols.sorts(label.feature)
        if not sorts:
            raise self._unknown_pattern(label, span)
        names = sorted({sort.name for sort in sorts})
        if len(names) > 1:
            raise self.scope.error(
                f"streams of `{label.feature}` have different sorts: {', '.join(names)}",
                span,
                "the objects that a variable stands for need streams of one sort",
            )
        open_sort = next((sort for sort in sorts if sort.is_open), None)
        if open_sort is None and len(sorts) > 1:
            fields = ", ".join(f"({format_fields(sort.fields)})" for sort in sorts)
            raise self.scope.error(
                f"streams of `{label.feature}` have different fields: {fields}",
                span,
                "what one `foreach` makes for its objects has the same fields for all",
            )
        return open_sort or sorts[0]

    # -- unknown names ---------------------------------------------------------------------

    def _unknown_label(self, label: Label, span: Span) -> LanguageError:
        scope, name = self.scope, str(label)
        declaration = scope.by_key.get(name)
        if declaration is not None:
            return scope.error(
                f"`{name}` is {scope.symbols.kind(name)}, not a generator",
                span,
                f"it has no output: name the label of an input of `{name}`"
                if isinstance(declaration, SinkDeclaration)
                else f"declare a generator of it, `strmgen LABEL = {name}`, and name the label",
            )
        scope.check_arity(label, span)
        for later in scope.text_declarations:
            if isinstance(later, ast.Strmgen) and scope.label(later.label) == label:
                return self._used_before("generator", name, span, later)
        labels = scope.keys_of(GeneratorDeclaration)
        pattern = scope.symbols.pattern(label.feature)
        if pattern is None:
            hint = suggest_name(name, labels)
        else:
            hint = did_you_mean(name, labels) or (
                f"`{pattern}` is made for each new object: follow one object with "
                f"`select({pattern} foreach … in …)`"
            )
        return scope.error(f"there is no generator `{name}`", span, hint)

    def _unknown_pattern(self, label: Label, span: Span) -> LanguageError:
        """Return the error for a feature without generators."""
        scope, feature = self.scope, label.feature
        for declaration in scope.text_declarations:
            inside = declaration.generators if isinstance(declaration, ast.Foreach) else ()
            for later in (declaration, *inside):
                if isinstance(later, ast.Strmgen) and scope.label(later.label).feature == feature:
                    return self._used_before("generator", str(label), span, later)
        return scope.error(
            f"no object has a generator of `{feature}`",
            span,
            did_you_mean(feature, scope.symbols.features())
            or f"declare `strmgen {label} = …` in a `foreach`, or one for a known object",
        )

    def _unknown_process(self, name: ast.Name, kind: type[CheckedDeclaration]) -> LanguageError:
        scope, text = self.scope, name.text
        is_source = kind is SourceDeclaration
        what = "source" if is_source else "computational unit"
        form = f"source SORT {text}" if is_source else f"compunit SORT {text}(SORT)"
        for later in scope.text_declarations:
            kinds = ast.Source if is_source else ast.Compunit
            if isinstance(later, kinds) and later.name.text == text:
                return self._used_before(what, text, name.span, later)
        hint = did_you_mean(text, [*scope.keys_of(kind), *(() if is_source else PROCESSES)])
        other = scope.symbols.kind(text)
        if other is not None:
            hint = hint or f"declare a {what} of another name"
            return scope.error(f"`{text}` is {other}, not a {what}", name.span, hint)
        hint = hint or f"declare `{form}` first"
        return scope.error(f"there is no {what} `{text}`", name.span, hint)

    def _used_before(
        self, what: str, name: str, span: Span, later: ast.Declaration
    ) -> LanguageError:
        line = self.scope.source.count("\n", 0, later.span.start) + 1
        return self.scope.error(
            f"{what} `{name}` is used before it is declared",
            span,
            f"its declaration is on line {line}: move it up",
        )
