"""Changes of the stream space: what the status stream tells ([Introspection15 §3.2])."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from ...languages.ssl.annotation import StreamAnnotation
from ...matching.space import TransformationDescription


class ChangeKind(StrEnum):
    """What happened to the stream space."""

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
    INPUTS_CHANGED = "inputs changed"
    NOT_RESTORED = "not restored"
    UNKEPT = "state not kept"
    REFUSED = "report refused"


class Role(StrEnum):
    """Which kind of process a change is about ([DyKnow10 §4.3], SPEC §1)."""

    UNIT = "ComputationalUnit"
    SOURCE = "Source"
    SINK = "Sink"


@dataclass(frozen=True, slots=True)
class Change:
    """One change of the stream space; fields that do not apply are empty.

    ``specification`` is the text by which the change was made: SSL, KPL, C-SPARQL, or a
    transformation with its parameters; of a failure, the reason, and so of an annotation kept by
    an earlier run that does not hold any more. ``policy`` is what ``stream`` keeps, in KPL.
    ``aliases`` are all further names of ``stream``, if it was named.
    ``synchronization`` is the unit that was inserted to bring the inputs of ``unit`` together, and
    ``fed`` what that one reads: the inputs that the transformation has ([Introspection15 §4.1]).
    ``annotation`` is what ``stream`` contains from now on, ``quality`` (0..1) how good it is,
    ``described`` what ``transformation`` takes and gives; None where nothing is said of it.
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
    fed: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class KnownTransformation:
    """What a transformation takes and gives, and the code with parameters behind it."""

    description: TransformationDescription
    implementation: str
    parameters: tuple[tuple[str, str], ...] = ()
