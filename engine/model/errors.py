"""What the engine refuses, by type. Each error says what to do next; nothing took effect."""

from __future__ import annotations


class DyknowError(Exception):
    """Base of the engine's refusals: ``detail`` says what is wrong, ``hint`` what to do next."""

    title = "refused"

    def __init__(self, detail: str, hint: str = "") -> None:
        super().__init__(detail)
        self.detail = detail
        self.hint = hint

    @property
    def causes(self) -> str:
        """What is wrong, with all that caused it."""
        return self.detail

    def __str__(self) -> str:
        return f"{self.causes} ({self.hint})" if self.hint else self.causes


class UnknownStream(DyknowError):
    """No stream has this name."""

    title = "unknown stream"


class UnknownTemplate(DyknowError):
    """No template has this name."""

    title = "unknown template"


class UnknownEvent(DyknowError):
    """The ontology knows no such event ([Events14 §V.B]: it must exist to be requested)."""

    title = "unknown event"


class UnknownTransformation(DyknowError):
    """No transformation has this name."""

    title = "unknown transformation"


class UnknownRequest(DyknowError):
    """No event request has this id."""

    title = "unknown request"


class UnknownFeature(DyknowError):
    """The ontology knows no such feature, sort or object."""

    title = "unknown term"


class AlreadyExists(DyknowError):
    """Something has this name already."""

    title = "already exists"


class Conflict(DyknowError):
    """The change contradicts what is there: another schema, something in use."""

    title = "conflict"


class BadArguments(DyknowError):
    """Arguments of a request that do not fit the template's parameters."""

    title = "wrong arguments"


class NoPlan(DyknowError):
    """Semantic matching found no way; ``missing`` says what would be needed."""

    title = "no plan"

    def __init__(self, detail: str, missing: tuple[str, ...], hint: str = "") -> None:
        super().__init__(detail, hint)
        self.missing = missing

    @property
    def causes(self) -> str:
        more = [cause for cause in self.missing if cause not in self.detail]
        return f"{self.detail}: {'; '.join(more)}" if more else self.detail


class Refused(DyknowError):
    """A request that the engine understands and does not carry out."""

    title = "refused"


class UnknownQuery(DyknowError):
    """No registered query has this name."""

    title = "unknown query"


class NotAnnotated(DyknowError):
    """A query names a stream of which nobody has said what it contains."""

    title = "stream without annotation"


class NoResult(DyknowError):
    """No window of a query has closed yet."""

    title = "no result yet"


class UnknownDeclaration(DyknowError):
    """Nothing of this name was declared in KPL."""

    title = "unknown declaration"


UNKNOWN = (UnknownStream, UnknownTemplate, UnknownTransformation, UnknownRequest, UnknownQuery)
"""What is raised where something is to be removed that is not there."""
