"""KPL declarations against what is declared and the ontology ([DyKnow10 Def. 5.13-5.20]).

What the paper leaves open is settled here. A symbol is declared before it is used. Declaring a
symbol again exactly as it is changes nothing. A sort is one of the language, one that was
declared, a feature of the ontology, or else *open*: known by name only, as the paper's ``pos``.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Final, assert_never

from ...ontology.vocabulary import Vocabulary
from ...rdf.datatypes import KNOWN, range_type
from ...rdf.namespaces import DYKNOW, PREFIXES, XSD
from ...streams.policy import Policy
from ...streams.sample import Field, FieldType, Schema
from ...streams.tuples import flat_names, flat_schema
from ..errors import LanguageError, Span
from . import ast
from .constraints import UNITS, to_policy, to_synchronization
from .parser import parse_constraints, parse_label_term
from .signature import (
    PROCESSES,
    VALUE,
    CheckedDeclaration,
    CompunitDeclaration,
    Compute,
    FromSource,
    GeneratorDeclaration,
    JoinOf,
    Label,
    Process,
    Signature,
    SortDeclaration,
    SourceDeclaration,
    StreamDeclaration,
    Synchronize,
    Term,
    ValueSort,
)

EMPTY: Final = Signature()

_BUILT_IN: Final = {
    "float": FieldType.FLOAT,
    "double": FieldType.FLOAT,
    "decimal": FieldType.FLOAT,
    "integer": FieldType.INTEGER,
    "int": FieldType.INTEGER,
    "long": FieldType.INTEGER,
    "boolean": FieldType.BOOLEAN,
    "string": FieldType.STRING,
    # Def. 5.13 wants these two: a time is ns since 1970, an object is its name.
    "time": FieldType.INTEGER,
    "object": FieldType.STRING,
}
_OWN_KIND: Final = ("time", "object")
_KINDS: Final = {
    SourceDeclaration: "a source",
    CompunitDeclaration: "a computational unit",
    GeneratorDeclaration: "a feature",
    StreamDeclaration: "a stream",
    SortDeclaration: "a sort",
}


def check_kpl(
    specification: ast.Specification,
    source: str,
    vocabulary: Vocabulary | None = None,
    signature: Signature = EMPTY,
    unit: str = "ms",
) -> tuple[tuple[CheckedDeclaration, ...], Signature]:
    """What ``parse_kpl(source)`` adds to ``signature``: the new declarations, and all of them.

    ``unit`` is what integers are where the text does not say. Without ``vocabulary`` no sort is a
    feature's. Raises `LanguageError` at the first declaration that makes no sense; nothing of the
    text is then declared. Cost: linear in the text and the signature.
    """
    if specification.unit is not None:
        written = specification.unit
        unit = written.text
        if unit not in UNITS:
            raise LanguageError(
                f"`{unit}` is no unit of abstract time", source, written.span, "ns, us, ms or s"
            )
    checker = _Checker(source, vocabulary, signature, unit, specification)
    for declaration in specification.declarations:
        checker.declare(declaration)
    new = tuple(checker.new)
    return new, signature.with_declarations(new) if new else signature


def parse_policy(source: str, unit: str = "ms") -> Policy:
    """A policy by itself, as a subscription gives it: ``any change, max delay 5s``; may be empty.
    Raises `LanguageError`."""
    return to_policy(parse_constraints(source), source, unit)


def parse_label(source: str) -> Label:
    """A label by itself in its one spelling: ``dyknow:pos[ car1 ]`` is ``pos[car1]``.
    Raises `LanguageError`."""
    return _label(parse_label_term(source), source)


def _label(label: ast.LabelTerm, source: str) -> Label:
    feature = _unprefixed(label.feature, source)
    return Label(feature, tuple(name.text for name in label.objects))


def _unprefixed(name: ast.Name, source: str) -> str:
    """One spelling: domain terms are written without their prefix, others with it."""
    prefix, colon, local = name.text.partition(":")
    if not colon:
        return name.text
    if prefix not in PREFIXES:
        near = difflib.get_close_matches(prefix, PREFIXES, n=1)
        hint = f"did you mean {near[0]}:?" if near else f"known are {', '.join(PREFIXES)}"
        span = Span(name.span.start, name.span.start + len(prefix))
        raise LanguageError(f"the prefix `{prefix}:` is not known", source, span, hint)
    return local if PREFIXES[prefix] == DYKNOW else name.text


class _Checker:
    """One text on its way: ``by_key`` is the signature with what the text has added so far."""

    def __init__(
        self,
        source: str,
        vocabulary: Vocabulary | None,
        signature: Signature,
        unit: str,
        specification: ast.Specification,
    ) -> None:
        self.new: list[CheckedDeclaration] = []
        self._source = source
        self._vocabulary = vocabulary
        self._unit = unit
        self._written = specification.declarations
        self._by_key = dict(signature.by_key)
        self._symbols: dict[str, str] = {}
        """Symbol -> the kind of thing that it is; sorts are apart."""
        self._arities: dict[str, Label] = {}
        """Feature -> a label with as many objects as it has."""
        self._sorts_used: set[str] = set()
        for declaration in signature.declarations:
            self._enter(declaration)

    def error(self, message: str, span: Span, hint: str = "") -> LanguageError:
        return LanguageError(message, self._source, span, hint)

    def declare(self, declaration: ast.Declaration) -> None:
        match declaration:
            case ast.Source():
                name = declaration.name
                checked: CheckedDeclaration = SourceDeclaration(
                    name.text, self.sort(declaration.sort)
                )
            case ast.Compunit():
                name = declaration.name
                inputs = tuple(map(self.sort, declaration.inputs))
                checked = CompunitDeclaration(name.text, self.sort(declaration.sort), inputs)
            case ast.Strmgen():
                name = declaration.label.feature
                checked = self.generator(declaration)
            case ast.Stream():
                name = declaration.name
                term, sort = self.term(declaration.term)
                checked = StreamDeclaration(name.text, sort, term)
            case ast.Sort():
                name = declaration.name
                checked = SortDeclaration(self.value_sort(declaration))
            case _:
                assert_never(declaration)
        self.check_symbol(checked, declaration, name)
        if checked.key not in self._by_key:
            self._by_key[checked.key] = checked
            self._enter(checked)
            self.new.append(checked)

    def _enter(self, declaration: CheckedDeclaration) -> None:
        match declaration:
            case SourceDeclaration():
                self._sorts_used.add(declaration.sort.name)
            case CompunitDeclaration():
                self._sorts_used.update(s.name for s in (declaration.sort, *declaration.inputs))
            case GeneratorDeclaration():
                self._symbols[declaration.label.feature] = _KINDS[GeneratorDeclaration]
                self._arities.setdefault(declaration.label.feature, declaration.label)
                return
            case StreamDeclaration():
                pass
            case SortDeclaration():
                return
            case _:
                assert_never(declaration)
        self._symbols[declaration.name] = _KINDS[type(declaration)]

    def check_symbol(
        self, checked: CheckedDeclaration, declaration: ast.Declaration, name: ast.Name
    ) -> None:
        """Symbols are unique, and the sets of them disjoint (Def. 5.13); sorts are apart."""
        there = self._by_key.get(checked.key)
        if isinstance(checked, SortDeclaration):
            text = checked.sort.name
            if there is None and text in self._sorts_used:
                raise self.error(
                    f"sort `{text}` is declared after it was used",
                    name.span,
                    "declare it before every source and compunit of that sort",
                )
        else:
            text = checked.label.feature if isinstance(checked, GeneratorDeclaration) else name.text
            if text in PROCESSES:
                raise self.error(
                    f"`{text}` is a process of the language", name.span, "choose another name"
                )
            kind, wanted = self._symbols.get(text), _KINDS[type(checked)]
            if kind is not None and kind != wanted:
                raise self.error(
                    f"`{text}` is {kind} already, so it cannot be {wanted}",
                    name.span,
                    "sources, computational units, features and streams have names of their own",
                )
            if isinstance(checked, GeneratorDeclaration):
                assert isinstance(declaration, ast.Strmgen)
                self.check_arity(checked.label, declaration.label.span)
        if there is not None and there != checked:
            span = declaration.label.span if isinstance(declaration, ast.Strmgen) else name.span
            raise self.error(
                f"`{checked.key}` is declared already, and differently",
                span,
                "remove the other declaration first, or choose another name",
            )

    # -- generators and terms --------------------------------------------------------------

    def generator(self, declaration: ast.Strmgen) -> GeneratorDeclaration:
        label = _label(declaration.label, self._source)
        process, name = declaration.process, declaration.process.text
        found = self._by_key.get(name)
        if declaration.synchronization and name != "sync":
            raise self.error(
                f"`{name}` takes no constraints of its own",
                declaration.synchronization[0].span,
                "constraints after `;` belong to `sync`; those of an input stand after `with`",
            )
        if not declaration.terms:
            if isinstance(found, SourceDeclaration):
                return GeneratorDeclaration(label, found.sort, FromSource(name))
            if isinstance(found, CompunitDeclaration) or name in PROCESSES:
                raise self.error(
                    f"`{name}` needs input streams", process.span, f"write `{name}(…)`"
                )
            raise self.unknown(process, "source", SourceDeclaration, ast.Source)
        if isinstance(found, SourceDeclaration):
            raise self.error(
                f"`{name}` is a source, and sources take no inputs",
                process.span,
                f"write `strmgen {label} = {name}`",
            )
        if name not in PROCESSES and not isinstance(found, CompunitDeclaration):
            raise self.unknown(process, "computational unit", CompunitDeclaration, ast.Compunit)
        checked = [self.term(term) for term in declaration.terms]
        terms = tuple(term for term, _ in checked)
        sorts = [sort for _, sort in checked]
        if isinstance(found, CompunitDeclaration):
            self.check_inputs(found, declaration, sorts)
            return GeneratorDeclaration(label, found.sort, Compute(name, terms))
        made: Process = JoinOf(terms)
        if name == "sync":
            policy = to_synchronization(
                declaration.synchronization, self._source, self._unit, process.span
            )
            made = Synchronize(terms, policy)
        return GeneratorDeclaration(label, _tuple_sort(label, terms, sorts), made)

    def check_inputs(
        self, unit: CompunitDeclaration, declaration: ast.Strmgen, sorts: list[ValueSort]
    ) -> None:
        wanted = ", ".join(sort.name for sort in unit.inputs)
        terms = declaration.terms
        if len(terms) != len(unit.inputs):
            first = min(len(unit.inputs), len(terms) - 1)
            raise self.error(
                f"`{unit.name}` takes {_count(len(unit.inputs), 'input')}, got {len(terms)}",
                terms[first].span,
                f"it is declared as {unit.name}({wanted})",
            )
        for term, sort, input in zip(terms, sorts, unit.inputs, strict=True):
            if not self.fits(sort, input):
                problem = (
                    f"with ({_fields(input)}), and this one has ({_fields(sort)})"
                    if sort.name == input.name
                    else f"of sort `{input.name}`, and this one is of sort `{sort.name}`"
                )
                raise self.error(
                    f"`{unit.name}` takes a stream {problem}",
                    term.label.span,
                    f"it is declared as {unit.name}({wanted})",
                )

    def fits(self, sort: ValueSort, input: ValueSort) -> bool:
        """By name; synonyms are one sort, and a sub-feature's values are its feature's."""
        if sort.name == input.name:
            return sort.fields is None or input.fields is None or sort.fields == input.fields
        if sort.feature is not None and input.feature is not None and self._vocabulary is not None:
            return input.feature in self._vocabulary.superfeatures(sort.feature)
        both = {sort.name, input.name}
        plain = all(name in _BUILT_IN or name.startswith("xsd:") for name in both)
        return plain and both.isdisjoint(_OWN_KIND) and sort.fields == input.fields

    def term(self, term: ast.StreamTerm) -> tuple[Term, ValueSort]:
        label = _label(term.label, self._source)
        found = self._by_key.get(str(label))
        if not isinstance(found, GeneratorDeclaration):
            if not isinstance(found, StreamDeclaration):
                self.check_arity(label, term.label.span)
            name = ast.Name(str(label), term.label.span)
            raise self.unknown(name, "generator", GeneratorDeclaration, ast.Strmgen)
        return Term(label, to_policy(term.policy, self._source, self._unit)), found.sort

    def check_arity(self, label: Label, span: Span) -> None:
        known = self._arities.get(label.feature)
        if known is not None and len(known.objects) != len(label.objects):
            raise self.error(
                f"`{label.feature}` is of {_count(len(known.objects), 'object')}, "
                f"and here of {len(label.objects)}",
                span,
                f"it is declared as {known}",
            )

    def unknown(
        self,
        name: ast.Name,
        what: str,
        kind: type[CheckedDeclaration],
        written: type[ast.Source | ast.Compunit | ast.Strmgen],
    ) -> LanguageError:
        """The error for a symbol that is not declared: as something else, later, misspelt."""
        found = self._by_key.get(name.text)
        if isinstance(found, StreamDeclaration) and kind is GeneratorDeclaration:
            return self.error(
                f"`{name.text}` is a stream, and a term names a generator",
                name.span,
                f"write the label that it is made from: `{found.term.label}`",
            )
        if found is not None:
            return self.error(f"`{name.text}` is {_KINDS[type(found)]}, no {what}", name.span)
        for declaration in self._written:
            if isinstance(declaration, written):
                spelling = (
                    str(_label(declaration.label, self._source))
                    if isinstance(declaration, ast.Strmgen)
                    else declaration.name.text
                )
                if spelling == name.text:
                    line = self._source.count("\n", 0, declaration.span.start) + 1
                    return self.error(
                        f"{what} `{name.text}` is used before it is declared",
                        name.span,
                        f"its declaration is on line {line}: move it up",
                    )
        known = [key for key, value in self._by_key.items() if isinstance(value, kind)]
        if kind is CompunitDeclaration:
            known += PROCESSES
        return self.error(f"there is no {what} `{name.text}`", name.span, _near(name.text, known))

    # -- sorts -----------------------------------------------------------------------------

    def sort(self, name: ast.Name) -> ValueSort:
        text = _unprefixed(name, self._source)
        if text in _BUILT_IN:
            return _simple(text, _BUILT_IN[text])
        declared = self._by_key.get(f"sort {text}")
        if isinstance(declared, SortDeclaration):
            return declared.sort
        prefix, colon, local = text.partition(":")
        if prefix == "xsd":
            if XSD + local not in KNOWN:
                known = [iri.removeprefix(XSD) for iri in KNOWN]
                raise self.error(f"XSD has no `{local}`", name.span, _near(local, known))
            return _simple(text, range_type(XSD + local))
        iri = PREFIXES[prefix] + local if colon else DYKNOW + text
        info = None if self._vocabulary is None else self._vocabulary.feature(iri)
        if info is None:
            return ValueSort(text, None)
        if info.range is None:
            return ValueSort(text, None, iri)
        return _simple(text, range_type(info.range), iri)

    def value_sort(self, declaration: ast.Sort) -> ValueSort:
        name = declaration.name
        if name.text in _BUILT_IN:
            raise self.error(
                f"`{name.text}` is a sort of the language", name.span, "choose another name"
            )
        if isinstance(declaration.value, ast.Name):
            sort = self.sort(declaration.value)
            if sort.fields is None:
                raise self.open_sort(declaration.value)
            return ValueSort(name.text, sort.fields)
        fields: dict[str, Field] = {}
        for field, written in declaration.value:
            if field.text in fields:
                raise self.error(f"field `{field.text}` is there twice", field.span)
            sort = self.sort(written)
            if sort.fields is None:
                raise self.open_sort(written)
            if sort.simple_type is None:
                raise self.error(
                    f"a field holds one value, and `{written.text}` has ({_fields(sort)})",
                    written.span,
                    "write its fields one by one",
                )
            fields[field.text] = Field(field.text, sort.simple_type)
        return ValueSort(name.text, tuple(fields.values()))

    def open_sort(self, name: ast.Name) -> LanguageError:
        known = [key.removeprefix("sort ") for key in self._by_key if key.startswith("sort ")]
        return self.error(
            f"what values of `{name.text}` are is not known",
            name.span,
            _near(name.text, [*_BUILT_IN, *known]),
        )


def _simple(name: str, type: FieldType, feature: str | None = None) -> ValueSort:
    return ValueSort(name, (Field(VALUE, type),), feature)


def _tuple_sort(label: Label, terms: Iterable[Term], sorts: Iterable[ValueSort]) -> ValueSort:
    schemas: list[Schema] = []
    for sort in sorts:
        if sort.fields is None:
            return ValueSort(label.feature, None)
        schemas.append(Schema(sort.fields))
    names = flat_names([term.label.identifier for term in terms], schemas)
    return ValueSort(label.feature, flat_schema(names, schemas).fields)


def _fields(sort: ValueSort) -> str:
    return ", ".join(f"{field.name} {field.type}" for field in sort.fields or ())


def _count(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def _near(name: str, known: Iterable[str]) -> str:
    names = sorted(set(known))
    near = difflib.get_close_matches(name, names, n=3)
    if near:
        return f"did you mean {' or '.join(near)}?"
    if not names:
        return "none is declared yet: declare it first"
    listed = ", ".join(names[:8]) + (" …" if len(names) > 8 else "")
    return f"known are {listed}"
