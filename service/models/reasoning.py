"""JSON models of answers about single verdicts and matches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypeAlias

from pydantic import BaseModel, Field

from ...reasoning.mtl.explanation import Explanation, Shown
from ...reasoning.patterns.recognition.explanation import ExplainedMatch, PartialMatches
from ...streams.time import TIME_MAX, TIME_MIN, format_time

ASKED = "the name of the query, or the id of the request"
Values: TypeAlias = dict[str, float | int | bool | str | None]


class ShownModel(BaseModel):
    """A feature, or a part of the formula at a depth, with its value at each state. Of a part that
    is true, false, unknown, or open: not known when the verdict was decided. Empty for a part
    that has no single value."""

    text: str
    depth: int
    values: list[float | bool | str | None]


class WhyModel(BaseModel):
    """Why a verdict is what it is: the states from the first that the formula looks at to the one
    that decides it, in order of valid time."""

    query: str = Field(description=ASKED)
    objects: dict[str, str]
    start: str
    verdict: Literal["true", "false", "unknown", "open"]
    decided: str | None
    states: list[str]
    features: list[ShownModel]
    formulas: list[ShownModel]

    @classmethod
    def of(cls, query: str, objects: Mapping[str, str], found: Explanation) -> WhyModel:
        def shown(each: Shown) -> ShownModel:
            values: list[Any] = list(each.values)
            return ShownModel(text=each.text, depth=each.depth, values=values)

        return cls(
            query=query,
            objects=dict(objects),
            start=format_time(found.start),
            verdict=found.verdict,  # type: ignore[arg-type]
            decided=None if found.decided is None else format_time(found.decided),
            states=list(map(format_time, found.valid)),
            features=list(map(shown, found.features)),
            formulas=list(map(shown, found.formulas)),
        )


class MatchedEventModel(BaseModel):
    """An event of a match: a sample of a stream."""

    event: str = Field(description="its name in the pattern")
    stream: str
    available: str
    valid: str
    values: Values


class ExplainedMatchModel(BaseModel):
    """A match with its results, and the events that it consists of."""

    available: str
    valid: str
    start: str
    end: str
    values: Values
    events: list[MatchedEventModel]


class MatchesWhyModel(BaseModel):
    """Why a pattern was recognized: the samples of each match that starts at a time, or is valid
    then."""

    query: str = Field(description=ASKED)
    matches: list[ExplainedMatchModel]

    @classmethod
    def of(cls, query: str, found: Sequence[ExplainedMatch]) -> MatchesWhyModel:
        return cls(
            query=query,
            matches=[
                ExplainedMatchModel(
                    available=format_time(each.available),
                    valid=format_time(each.valid),
                    start=format_time(each.start),
                    end=format_time(each.end),
                    values=dict(each.values),
                    events=[
                        MatchedEventModel(
                            event=event.event,
                            stream=event.stream,
                            available=format_time(event.available),
                            valid=format_time(event.valid),
                            values=dict(event.values),
                        )
                        for event in each.events
                    ],
                )
                for each in found
            ],
        )


class CameModel(BaseModel):
    """An event that has come: its valid time, and what the pattern reads of it."""

    event: str
    valid: str
    values: Values


class PendingModel(BaseModel):
    """An event that may still come, and the valid times between which."""

    event: str
    earliest: str
    latest: str | None = Field(description="null: there is no bound")


class PartialModel(BaseModel):
    """Events that have come, and when each of the others may."""

    events: list[CameModel]
    pending: list[PendingModel]


class PartialMatchesModel(BaseModel):
    """The partial matches of a pattern, the newest first. ``more``: there are or may be others."""

    query: str = Field(description=ASKED)
    watermark: str | None = Field(description="no sample that is valid before it comes any more")
    partial: list[PartialModel]
    more: bool

    @classmethod
    def of(cls, query: str, found: PartialMatches) -> PartialMatchesModel:
        return cls(
            query=query,
            # There is none before the first sample, nor after the end.
            watermark=None
            if found.watermark in (TIME_MIN, TIME_MAX)
            else format_time(found.watermark),
            partial=[
                PartialModel(
                    events=[
                        CameModel(event=name, valid=format_time(valid), values=dict(values))
                        for name, valid, values in each.events
                    ],
                    pending=[
                        PendingModel(
                            event=event.event,
                            earliest=format_time(event.earliest),
                            latest=None if event.latest is None else format_time(event.latest),
                        )
                        for event in each.pending
                    ],
                )
                for each in found.partial
            ],
            more=found.more,
        )
