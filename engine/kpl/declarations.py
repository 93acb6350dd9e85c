"""KPL declarations of the running system: parsed, started, and stored over a restart
([DyKnow10 §5.2], SPEC §1)."""

from __future__ import annotations

from collections.abc import Callable

from ...languages.errors import LanguageError
from ...languages.kpl import (
    CheckedDeclaration,
    CompunitDeclaration,
    ForeachDeclaration,
    GeneratorDeclaration,
    Signature,
    SinkDeclaration,
    SortDeclaration,
    SourceDeclaration,
    StreamDeclaration,
    ast,
    check_kpl,
    format_kpl,
    parse_kpl,
)
from ...ontology.ontology import Ontology
from ..model.errors import DyknowError, UnknownDeclaration
from ..model.status_changes import Change, ChangeKind
from ..model.views import DeclarationView
from ..units.base import ComputationalUnit
from ..units.foreach import ConfigurationProcess
from ..units.mediation import MediationUnit
from ..units.policy import PolicyUnit, counts_of
from ..units.sampled_source import SampledSource
from .application import Application, Process

_SEPARATOR = "\n\n"
"""Separates stored declarations: some have several lines, none contains an empty line."""
_KINDS = {
    SourceDeclaration: "source",
    CompunitDeclaration: "compunit",
    GeneratorDeclaration: "strmgen",
    StreamDeclaration: "stream",
    SortDeclaration: "sort",
    ForeachDeclaration: "foreach",
    SinkDeclaration: "sink",
}


class KplDeclarations:
    """The KPL declarations and their application.

    The ontology stores the declarations in canonical spelling. After a restart one of them may no
    longer be valid: the code of a unit is missing, or a stream has other fields. The status stream
    reports it, and it stays stored.
    """

    def __init__(
        self, ontology: Ontology, application: Application, changed: Callable[[Change], None]
    ) -> None:
        self._ontology = ontology
        self._application = application
        self._report = changed
        self._texts: dict[str, str] = {}
        self._not_restored: dict[str, str] = {}

    @property
    def signature(self) -> Signature:
        """Everything that is declared."""
        return self._application.signature

    def add(self, text: str, unit: str = "ms") -> tuple[str, ...]:
        """Add all declarations of a text, or none, and start them. Returns the keys of the new
        ones: repeating an equal declaration changes nothing.

        Raises `LanguageError`, and the errors of `Application.add`.
        """
        new = self._declare(text, unit)
        if new:
            self._store()
        return tuple(declaration.key for declaration in new)

    def remove(self, name: str, *, cascade: bool = False) -> tuple[str, ...]:
        """Remove a declaration (`Application.remove`), or one that was not restored: by its first
        line, or by its name if no other declaration has it."""
        for text in self._not_restored:
            # Its view shows the first line as its name (`_lost_view`).
            if text.partition("\n")[0] == name:
                del self._not_restored[text]
                self._store()
                return (name,)
        try:
            removed = self._application.remove(name, cascade=cascade)
        except UnknownDeclaration:
            if not self.forget(name):
                raise
            return (name,)
        for key in removed:
            del self._texts[key]
        self._store()
        return removed

    def text(self) -> str:
        """All declarations in canonical spelling, in an order in which they can be declared."""
        return "".join(f"{text}\n" for text in self._in_order())

    def __len__(self) -> int:
        """The number of declarations, with those that were not restored."""
        return len(self._texts) + len(self._not_restored)

    def views(self) -> tuple[DeclarationView, ...]:
        """The views of all declarations in order, then of those that were not restored."""
        views = [self._view(declaration) for declaration in self.signature.declarations]
        return (*views, *(_lost_view(text, why) for text, why in self._not_restored.items()))

    def view(self, name: str) -> DeclarationView:
        """The view of a declaration by name, label or key. Raises `UnknownDeclaration`."""
        return self._view(self._application.declaration(name))

    def used_by(self, name: str) -> tuple[str, ...]:
        """The keys of the dependents of a declaration, users first. Raises `UnknownDeclaration`."""
        return self.signature.dependents(self._application.declaration(name).key)

    def restore(self, started: Callable[[str], None]) -> None:
        """Declare the stored declarations again; report those that are not valid any more. For
        ``started`` see `Application.add`."""
        kept = self._ontology.registered.kpl()
        if not kept:
            return
        try:
            self._declare(kept, started=started)
        except (LanguageError, DyknowError):
            # One of them is not valid: declare each alone, so that the others are restored.
            for text in kept.split(_SEPARATOR):
                self._restore_one(text, started)

    def add_valid(self, text: str, unit: str = "ms") -> None:
        """Declare the valid declarations of a text that an earlier run accepted and had not stored
        in a checkpoint."""
        try:
            self._declare(text, unit)
        except (LanguageError, DyknowError):
            for each in self._parts(text, unit):
                self._restore_one(each)
        self._store()

    def forget(self, name: str) -> bool:
        """Remove a declaration that was not restored, by name, label or key; return whether there
        was one."""
        for text in tuple(self._not_restored):
            if _has_name(name, text):
                del self._not_restored[text]
                self._store()
                return True
        return False

    def _restore_one(self, text: str, started: Callable[[str], None] = lambda _: None) -> None:
        try:
            self._declare(text, started=started)
        except (LanguageError, DyknowError) as error:
            self._not_restored[text] = str(error)
            reason = f"{error}\n{text}"
            self._report(Change(ChangeKind.NOT_RESTORED, specification=reason))

    def _parts(self, text: str, unit: str) -> tuple[str, ...]:
        """Split a text into declarations in canonical spelling; a text with errors stays whole."""
        has_unit = False
        try:
            specification = parse_kpl(text)
            has_unit = specification.unit is not None
            new, _ = check_kpl(specification, text, self._ontology.vocabulary, self.signature, unit)
        except LanguageError:
            # The next start reads the stored text without the unit of this command.
            lines = [line for line in text.splitlines() if line.strip()]
            return ("\n".join(lines if has_unit else [f"unit {unit}", *lines]),)
        return tuple(format_kpl(declaration) for declaration in new)

    def _declare(
        self, text: str, unit: str = "ms", started: Callable[[str], None] = lambda _: None
    ) -> tuple[CheckedDeclaration, ...]:
        vocabulary = self._ontology.vocabulary
        new, _ = check_kpl(parse_kpl(text), text, vocabulary, self.signature, unit)
        self._application.add(new, started)
        self._texts.update((declaration.key, format_kpl(declaration)) for declaration in new)
        for declaration in new:
            self._not_restored.pop(self._texts[declaration.key], None)
        return new

    def _store(self) -> None:
        self._ontology.registered.set_kpl(_SEPARATOR.join((*self._in_order(), *self._not_restored)))

    def _in_order(self) -> list[str]:
        """The texts in order of dependency. The order of `_texts` may differ after a removal."""
        return [self._texts[declaration.key] for declaration in self.signature.declarations]

    def _view(self, declaration: CheckedDeclaration) -> DeclarationView:
        key = declaration.key
        process = self._application.process_of(key)
        stream = self._application.stream_of(key)
        violations = process.violations if isinstance(process, PolicyUnit) else None
        return DeclarationView(
            name=key,
            kind=_KINDS[type(declaration)],
            text=self._texts[key],
            stream=None if stream is None else stream.name,
            unit=None if process is None else process.name,
            uses=self.signature.uses(declaration),
            failure=None if process is None else process.failure,
            errors=0 if process is None else process.counters.errors,
            restarts=0 if process is None else process.counters.restarts,
            last_error=None if process is None else process.counters.last_error,
            counters=_counters(process),
            violations=None if violations is None else violations.name,
        )


def _has_name(name: str, text: str) -> bool:
    """Whether a stored declaration has this name, label or key."""
    try:
        declarations = parse_kpl(text).declarations
    except LanguageError:
        return False
    for declaration in declarations:
        match declaration:
            case ast.Strmgen(label):
                if text[label.span.start : label.span.end] == name:
                    return True
            case ast.Foreach():
                pass
            case _:
                if declaration.name.text == name:
                    return True
    return False


def _lost_view(text: str, reason: str) -> DeclarationView:
    """Return the view of a declaration that was not restored."""
    return DeclarationView(
        name=text.partition("\n")[0],
        kind="not restored",
        text=text,
        stream=None,
        unit=None,
        uses=(),
        failure=reason,
        errors=0,
        restarts=0,
        last_error=None,
        counters={},
        violations=None,
    )


def _counters(process: Process | None) -> dict[str, object]:
    """Return the counters of a process without those of errors."""
    match process:
        case PolicyUnit():
            return counts_of(process)
        case SampledSource():
            return {"missed": process.missed, "without room": process.without_room}
        case ConfigurationProcess():
            return {
                "objects": len(process.objects),
                "waiting": process.waiting,
                "leaving": len(process.leaving),
            }
        case MediationUnit():
            return {"inputs": len(process.inputs) - 1, "without stream": list(process.missing)}
        case ComputationalUnit():
            return {"late": process.late}
        case _:
            return {}
