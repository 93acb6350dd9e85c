"""Changes of the stream space: what the status stream tells ([Introspection15 §3.2])."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class ChangeKind(StrEnum):
    """What happened to the stream space."""

    STREAM_ADDED = "stream added"
    STREAM_REMOVED = "stream removed"
    STREAM_ANNOTATED = "stream annotated"
    STREAM_ENDED = "stream ended"
    TRANSFORMATION_ANNOTATED = "transformation annotated"
    UNIT_STARTED = "unit started"
    UNIT_STOPPED = "unit stopped"
    UNIT_FAILED = "unit failed"
    UNIT_RESTARTED = "unit restarted"
    UNIT_STOPPED_BY_RULE = "unit stopped by rule"
    INPUTS_CHANGED = "inputs changed"
    NOT_RESTORED = "not restored"


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
    """

    kind: ChangeKind
    stream: str = ""
    unit: str = ""
    transformation: str = ""
    inputs: tuple[str, ...] = ()
    specification: str = ""
    role: Role = Role.UNIT
    policy: str = ""
