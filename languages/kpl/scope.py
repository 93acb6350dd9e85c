"""The state of the checker for one KPL text: the declarations so far, and errors.

`check` adds declarations; `sorts` and `generators` read them.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from ...ontology.vocabulary import Vocabulary
from ...rdf.namespaces import DYKNOW, PREFIXES
from ..errors import LanguageError, Span
from ..hints import count, suggest_name
from . import ast
from .constraints import UNITS
from .declarations import CheckedDeclaration, Label
from .symbols import OBJECT, Symbols


@dataclass(slots=True)
class Scope:
    """The text, and the signature with the text's declarations so far: ``by_key`` and ``symbols``.

    ``unit`` is that of integers. Without ``vocabulary`` no sort belongs to a feature.
    ``text_declarations`` are all of the text, for hints at later ones.
    """

    source: str
    unit: str
    vocabulary: Vocabulary | None
    text_declarations: tuple[ast.Declaration, ...]
    by_key: dict[str, CheckedDeclaration]
    symbols: Symbols

    def error(self, message: str, span: Span, hint: str = "") -> LanguageError:
        return LanguageError(message, self.source, span, hint)

    def keys_of(self, kind: type[CheckedDeclaration]) -> list[str]:
        return [key for key, value in self.by_key.items() if isinstance(value, kind)]

    def label(self, written: ast.LabelTerm) -> Label:
        return label_of(written, self.source)

    def check_symbol(self, name: str, kind: str, span: Span) -> None:
        """Check that the name has one kind only: the sets of symbols are disjoint (Def. 5.13)."""
        other = self.symbols.clash(name, kind)
        if other is not None:
            raise self.error(
                f"`{name}` is {other} already, so it cannot be {kind}",
                span,
                "a symbol stands for one thing (Def. 5.13); only a sort and a feature may share a "
                "name",
            )

    def check_label(self, written: ast.LabelTerm, variables: Iterable[str]) -> None:
        """Check the label of a declared generator: its symbols, and its number of objects."""
        label = self.label(written)
        for object, term in zip(label.objects, written.objects, strict=True):
            if object == label.feature:
                raise self.error(
                    f"`{object}` is the feature, so it cannot be its object",
                    term.span,
                    "a symbol stands for one thing (Def. 5.13)",
                )
            if object not in variables:
                self.check_symbol(object, OBJECT, term.span)
        self.check_arity(label, written.span)

    def check_arity(self, label: Label, span: Span) -> None:
        example = self.symbols.example(label.feature)
        if example is not None and len(example.objects) != len(label.objects):
            raise self.error(
                f"`{label.feature}` is of {count(len(example.objects), 'object')}, "
                f"and here of {len(label.objects)}",
                span,
                f"it is declared as {example}",
            )


def check_unit(unit: str) -> None:
    """Raise `ValueError` for a unit that integers cannot have."""
    if unit not in UNITS:
        raise ValueError(f"{unit!r} is not a unit of abstract time: ns, us, ms or s")


def label_of(label: ast.LabelTerm, source: str) -> Label:
    """Return the label in canonical form. Raises `LanguageError` for an unknown prefix."""
    check_prefix(label.feature, source)
    return Label(without_prefix(label.feature.text), tuple(name.text for name in label.objects))


def check_prefix(name: ast.Name, source: str) -> None:
    """Raise `LanguageError` for a name whose prefix is not in `PREFIXES`."""
    prefix, colon, _ = name.text.partition(":")
    if colon and prefix not in PREFIXES:
        hint = suggest_name(f"{prefix}:", (f"{known}:" for known in PREFIXES))
        span = Span(name.span.start, name.span.start + len(prefix))
        raise LanguageError(f"the prefix `{prefix}:` is not known", source, span, hint)


def without_prefix(name: str) -> str:
    """Return the canonical form: ``speed`` for ``dyknow:speed``. Names with another prefix keep it,
    and so do names that would be keywords."""
    prefix, _, local = name.partition(":")
    return local if PREFIXES.get(prefix) == DYKNOW and local not in ast.KEYWORDS else name
