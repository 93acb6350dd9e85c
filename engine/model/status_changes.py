"""Changes of the stream space, which the status stream reports ([Introspection15 §3.2])."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from ...languages.ssl.annotation import StreamAnnotation
from ...matching.space import TransformationDescription


class ChangeKind(StrEnum):
    """The kinds of changes; the status stream has them as texts."""

    STREAM_ADDED = "stream added"
    STREAM_REMOVED = "stream removed"
    STREAM_ANNOTATED = "stream annotated"
    STREAM_NAMED = "stream named"
    STREAM_ENDED = "stream ended"
    QUALITY_CHANGED = "quality changed"
    TRANSFORMATION_ANNOTATED = "transformation annotated"
    TRANSFORMATION_REMOVED = "transformation removed"
    UNIT_STARTED = "unit started"
    UNIT_STOPPED = "unit stopped"
    UNIT_FAILED = "unit failed"
    UNIT_RESTARTED = "unit restarted"
    UNIT_STOPPED_BY_RULE = "unit stopped by rule"
    LIMIT_REACHED = "limit reached"
    INPUTS_CHANGED = "inputs changed"
    NOT_RESTORED = "not restored"
    STATE_LOST = "state not kept"
    REFUSED = "report refused"


class Role(StrEnum):
    """The kind of process that changed ([DyKnow10 §4.3], SPEC §1)."""

    UNIT = "ComputationalUnit"
    SOURCE = "Source"
    SINK = "Sink"


@dataclass(frozen=True, slots=True)
class Change:
    """One change of the stream space; fields that do not apply are empty or None.

    ``specification`` is the text of the change: SSL, KPL, C-SPARQL, or a transformation with its
    parameters. For a failure, and for a registration that could not be restored, it is the reason.
    ``policy`` is the policy that ``stream`` obeys, in KPL. ``aliases`` are all further names of
    ``stream``.
    ``synchronization`` is the unit that was inserted to synchronize the inputs of ``unit``.
    ``unsynchronized`` are the inputs of that one, which the transformation itself has
    ([Introspection15 §4.1]).
    ``annotation`` is the new annotation of ``stream``, ``quality`` (0..1) its new quality,
    ``described`` the new description of ``transformation``.
    """

    kind: ChangeKind
    stream: str = ""
    unit: str = ""
    transformation: str = ""
    inputs: tuple[str, ...] = ()
    specification: str = ""
    role: Role = Role.UNIT
    policy: str = ""
    annotation: StreamAnnotation | None = None
    quality: float | None = None
    described: KnownTransformation | None = None
    aliases: tuple[str, ...] = ()
    synchronization: str = ""
    unsynchronized: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class KnownTransformation:
    """A transformation's description for matching, its implementation and parameters."""

    description: TransformationDescription
    implementation: str
    parameters: tuple[tuple[str, str], ...] = ()
