"""KPL in the running system: text in, processes at work, text kept over a restart
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
"""Between declarations where they are kept: some have several lines, none has an empty one."""
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
    """What was declared in KPL, and the application that it makes.

    The declarations are kept in the store in their one spelling. What does not hold any more after
    a restart (the code of a unit is gone, a stream has other fields) is told on the status
    stream, left out, and kept.
    """

    def __init__(
        self, ontology: Ontology, application: Application, changed: Callable[[Change], None]
    ) -> None:
        self._ontology = ontology
        self._application = application
        self._changed = changed
        self._texts: dict[str, str] = {}
        self._not_restored: dict[str, str] = {}

    @property
    def signature(self) -> Signature:
        """Everything that is declared."""
        return self._application.signature

    def add(self, text: str, unit: str = "ms") -> tuple[str, ...]:
        """Declare, and start what is declared; all of the text or nothing. Gives the keys of what
        is new: what was declared in the same words before changes nothing.

        Raises `LanguageError`, and what `Application.add` raises.
        """
        new = self._declare(text, unit)
        if new:
            self._keep()
        return tuple(declaration.key for declaration in new)

    def remove(self, name: str, *, cascade: bool = False) -> tuple[str, ...]:
        """See `Application.remove`. What was not restored is forgotten by its first line, or by its
        name where nothing else has it."""
        for text in self._not_restored:
            if text.partition("\n")[0] == name:
                del self._not_restored[text]
                self._keep()
                return (name,)
        try:
            removed = self._application.remove(name, cascade=cascade)
        except UnknownDeclaration:
            if not self.forget(name):
                raise
            return (name,)
        for key in removed:
            del self._texts[key]
        self._keep()
        return removed

    def text(self) -> str:
        """All declarations in their one spelling; declared in this order they give the same."""
        return "".join(f"{text}\n" for text in self._in_order())

    def __len__(self) -> int:
        """How many declarations there are, those that do not hold any more included."""
        return len(self._texts) + len(self._not_restored)

    def views(self) -> tuple[DeclarationView, ...]:
        """All declarations, in order; then those of an earlier run that do not hold any more."""
        views = [self._view(declaration) for declaration in self.signature.declarations]
        return (*views, *(_lost(text, why) for text, why in self._not_restored.items()))

    def view(self, name: str) -> DeclarationView:
        """One, by name, label or key; raises `UnknownDeclaration`."""
        return self._view(self._application.declaration(name))

    def used_by(self, name: str) -> tuple[str, ...]:
        """The keys of all that cannot be without it, users first; raises `UnknownDeclaration`."""
        return self.signature.dependents(self._application.declaration(name).key)

    def restore(self, started: Callable[[str], None]) -> None:
        """Declare what an earlier run was told; what does not hold any more is told and left. See
        `Application.add`."""
        kept = self._ontology.registered.kpl()
        if not kept:
            return
        try:
            self._declare(kept, started=started)
        except (LanguageError, DyknowError):
            # Something does not hold any more: what can be without it is restored.
            for text in kept.split(_SEPARATOR):
                self._declare_again(text, started)

    def add_what_holds(self, text: str, unit: str = "ms") -> None:
        """Declare what an earlier run was told and had not kept yet, as `restore` does."""
        try:
            self._declare(text, unit)
        except (LanguageError, DyknowError):
            for each in self._parts(text, unit):
                self._declare_again(each)
        self._keep()

    def forget(self, name: str) -> bool:
        """Forget what was not restored, by its name, label or key; whether it was there."""
        for text in tuple(self._not_restored):
            if _is_called(name, text):
                del self._not_restored[text]
                self._keep()
                return True
        return False

    def _declare_again(self, text: str, started: Callable[[str], None] = lambda _: None) -> None:
        try:
            self._declare(text, started=started)
        except (LanguageError, DyknowError) as error:
            self._not_restored[text] = str(error)
            reason = f"{error}\n{text}"
            self._changed(Change(ChangeKind.NOT_RESTORED, specification=reason))

    def _parts(self, text: str, unit: str) -> tuple[str, ...]:
        """The declarations of a text as they are kept; in one where it makes no sense now."""
        has_unit = False
        try:
            specification = parse_kpl(text)
            has_unit = specification.unit is not None
            new, _ = check_kpl(specification, text, self._ontology.vocabulary, self.signature, unit)
        except LanguageError:
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

    def _keep(self) -> None:
        self._ontology.registered.set_kpl(_SEPARATOR.join((*self._in_order(), *self._not_restored)))

    def _in_order(self) -> list[str]:
        """Each behind what it uses: a removal may have changed the order of declaration."""
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


def _is_called(name: str, text: str) -> bool:
    """Whether a declaration, as it is kept, is of this name, label or key."""
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


def _lost(text: str, reason: str) -> DeclarationView:
    """A declaration of an earlier run that does not hold any more."""
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
    """What a process counts, beside its errors."""
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
