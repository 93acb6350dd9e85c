"""Registered continuous queries, as JSON."""

from __future__ import annotations

from urllib.parse import quote

from pydantic import BaseModel, Field

from ...engine.durability.accepted_commands import WaitingCommand, query_view
from ...engine.model import views
from .events import PlanModel
from .parts import iso


class OptionsModel(BaseModel):
    """How a query is read where its text leaves it open."""

    semantics: str = Field(description="bag or set: whether equal triples count each or once")
    bounds: str = Field(description="of a window with end e: (e - RANGE, e] or [e - RANGE, e)")
    origin: str = Field(description="windows end at origin + k STEP")
    report: str = Field(description="non-empty, change or close: which windows give a result")
    strategy: str = Field(description="how streams are chosen for a query that names none")
    since: str = Field(description="where it began, as asked for")


class QueryModel(BaseModel):
    """A registered query. Its results are the stream ``stream``, as events at ``events``, as SPARQL
    results at ``results``."""

    name: str
    kind: str = Field(description="STREAM or QUERY, as the text registers it")
    form: str = Field(description="SELECT, CONSTRUCT, ASK")
    dialect: str = Field(description="C-SPARQL or RSP-QL")
    state: str = Field(
        description="running, failed, ended; not restored, waiting: of an earlier run"
    )
    failure: str | None = Field(description="why it has failed, is not restored or waits")
    users: int = Field(description="how often it was registered: it stops with the last removal")
    stream: str | None
    fields: dict[str, str] = Field(description="the fields of the stream's samples and their types")
    reads: list[str] = Field(description="the streams that the query itself reads")
    position: str | None = Field(description="id of the stream's last sample: follow with since=")
    events: str | None
    results: str
    explain: str
    windows: int = Field(description="how many windows' results are kept")
    last_window: str | None = Field(description="the end of the last window that closed")
    late: int = Field(
        description="samples that came too late for their windows; the stream `NAME_late_STREAM` "
        "has those of a stream, from when it is first asked for"
    )
    errors: int = Field(
        description="windows that needed more rows, time or memory than they may, and have no "
        "result (after three in a row the query is stopped); fields of a window with a value that "
        "they cannot hold"
    )
    last_error: str | None = Field(description="of which window, and what it needed or lost")
    waits_for: list[str] = Field(
        description="streams that have not begun and are not idle: nothing closes before"
    )
    watermark: str | None = Field(description="windows that end before have closed")
    held_back_by: list[str] = Field(
        description="the streams that are least far: the next window closes when they go on, end, "
        "or are idle"
    )
    options: OptionsModel
    plan: PlanModel | None
    empty: str | None = Field(None, description="why the stream has no sample yet")
    source: str
    explanation: str | None = Field(None, description="each stage, where it was asked for")

    @classmethod
    def waiting(cls, waiting: WaitingCommand, epoch: str) -> QueryModel:
        """One that waits, as it was asked for; of a text that is not understood any more there is
        less to say."""
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
