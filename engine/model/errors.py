"""Errors of the engine. Each has a hint for the user; the refused command had no effect."""

from __future__ import annotations


class DyknowError(Exception):
    """Base of the engine's errors: ``detail`` is the problem, ``hint`` the way out."""

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
    """The ontology has no such event ([Events14 §V.B]: it must exist to be requested)."""

    title = "unknown event"


class UnknownTransformation(DyknowError):
    """No transformation has this name."""

    title = "unknown transformation"


class UnknownRequest(DyknowError):
    """No event request has this id."""

    title = "unknown request"


class UnknownFeature(DyknowError):
    """The ontology has no such feature, sort or object, or there is no such implementation."""

    title = "unknown term"


class UnknownOntology(DyknowError):
    """No loaded ontology has this name."""

    title = "unknown ontology"


class AlreadyExists(DyknowError):
    """The name is taken."""

    title = "already exists"


class Conflict(DyknowError):
    """The change contradicts the present state: another schema, something in use."""

    title = "conflict"


class BadArguments(DyknowError):
    """Invalid arguments of a request."""

    title = "wrong arguments"


class OntologyInUse(Conflict):
    """An ontology cannot be removed: ``used_by`` lists what names its terms."""

    def __init__(self, detail: str, used_by: tuple[str, ...], hint: str = "") -> None:
        super().__init__(detail, hint)
        self.used_by = used_by


class NoPlan(DyknowError):
    """Semantic matching found no plan; ``missing`` lists the missing features."""

    title = "no plan"

    def __init__(self, detail: str, missing: tuple[str, ...], hint: str = "") -> None:
        super().__init__(detail, hint)
        self.missing = missing

    @property
    def causes(self) -> str:
        more = [cause for cause in self.missing if cause not in self.detail]
        return f"{self.detail}: {'; '.join(more)}" if more else self.detail


class Refused(DyknowError):
    """The engine does not carry out such a request, for example one about the system's names."""

    title = "refused"


class UnknownObject(DyknowError):
    """Neither the ontology nor a sample of an annotated stream names the object."""

    title = "unknown object"


class UnknownNode(DyknowError):
    """Nothing that runs has this name."""

    title = "unknown node"


class UnknownQuery(DyknowError):
    """No registered query has this name."""

    title = "unknown query"


class NotAnnotated(DyknowError):
    """A query names a stream that has no annotation."""

    title = "stream without annotation"


class NoResult(DyknowError):
    """No window of a query has closed yet."""

    title = "no result yet"


class UnknownDeclaration(DyknowError):
    """No KPL declaration has this name."""

    title = "unknown declaration"


UNKNOWN = (
    UnknownStream,
    UnknownTemplate,
    UnknownTransformation,
    UnknownRequest,
    UnknownQuery,
    UnknownOntology,
)
"""The errors of removing something that does not exist."""
