"""JSON models of registered continuous queries."""

from __future__ import annotations

from urllib.parse import quote

from pydantic import BaseModel, Field

from ...engine.durability.accepted_commands import WaitingCommand, query_view
from ...engine.model import views
from .events import PlanModel
from .parts import iso


class OptionsModel(BaseModel):
    """The options for what the query's text leaves open."""

    semantics: str = Field(description="bag or set: whether equal triples count each or once")
    bounds: str = Field(description="of a window with end e: (e - RANGE, e] or [e - RANGE, e)")
    origin: str = Field(description="windows end at origin + k STEP")
    report: str = Field(description="non-empty, change or close: which windows give a result")
    strategy: str = Field(description="how streams are chosen if the text names none")
    since: str = Field(description="where the results begin, as requested")


class QueryModel(BaseModel):
    """A registered query. Its results are the stream ``stream``; ``events`` sends them as events,
    and ``results`` as SPARQL results."""

    name: str
    kind: str = Field(description="STREAM, QUERY, MONITOR or PATTERN")
    form: str = Field(description="SELECT, CONSTRUCT, ASK; empty for a monitor or a pattern")
    dialect: str = Field(description="C-SPARQL, RSP-QL or MTL")
    state: str = Field(
        description="running, failed, ended; not restored or waiting: from an earlier run"
    )
    failure: str | None = Field(description="why it failed, was not restored or waits")
    users: int = Field(description="number of registrations: the last removal stops the query")
    stream: str | None
    fields: dict[str, str] = Field(description="the fields of the stream's samples and their types")
    reads: list[str] = Field(description="the streams that the query reads directly")
    position: str | None = Field(description="id of the stream's last sample: follow with since=")
    events: str | None
    results: str
    explain: str
    windows: int = Field(description="number of windows whose results are kept")
    last_window: str | None = Field(description="the end of the last closed window")
    late: int = Field(
        description="samples that came too late for their windows; the stream `NAME_late_STREAM` "
        "has those of a stream, from the first request for it on"
    )
    errors: int = Field(
        description="windows without a result, which exceeded a limit of rows, time or memory "
        "(three in a row stop the query); fields of a window with a value that their type cannot "
        "hold"
    )
    last_error: str | None = Field(description="the window of the last error, and its need or loss")
    waits_for: list[str] = Field(
        description="streams without samples that are not idle: no window closes before they begin"
    )
    watermark: str | None = Field(description="all windows that end before it have closed")
    held_back_by: list[str] = Field(
        description="the streams with the least watermark: the next window closes when they go on, "
        "end, or become idle"
    )
    options: OptionsModel
    plan: PlanModel | None
    empty: str | None = Field(None, description="why the stream has no sample yet")
    source: str
    explanation: str | None = Field(None, description="each stage, if requested")

    @classmethod
    def waiting(cls, waiting: WaitingCommand, epoch: str) -> QueryModel:
        """Return the model of a waiting query. If its text is no longer valid, some members are
        empty."""
        return cls.of(query_view(waiting), epoch)

    @classmethod
    def of(cls, view: views.QueryView, epoch: str, explanation: str | None = None) -> QueryModel:
        path = f"/queries/{quote(view.name, safe='')}"
        stream = view.stream
        return cls(
            name=view.name,
            kind=view.kind,
            form=view.form,
            dialect=view.dialect,
            state=view.state,
            failure=view.failure,
            users=view.users,
            stream=stream,
            fields={field.name: str(field.type) for field in view.fields},
            reads=list(view.reads),
            position=None if stream is None else f"{epoch}-{view.position}",
            events=None if stream is None else f"/streams/{quote(stream, safe='')}/events",
            results=f"{path}/results",
            explain=f"{path}?explain=true",
            windows=view.windows,
            last_window=iso(view.last_window),
            late=view.late,
            errors=view.errors,
            last_error=view.last_error,
            waits_for=list(view.waits_for),
            watermark=iso(view.watermark),
            held_back_by=list(view.held_back_by),
            options=OptionsModel(
                semantics=view.semantics,
                bounds=view.bounds,
                origin=iso(view.origin) or "",
                report=view.report,
                strategy=view.strategy,
                since=view.since,
            ),
            plan=None if view.plan is None else PlanModel.of(view.plan),
            empty=view.empty,
            source=view.source,
            explanation=explanation,
        )
