"""What ``dyknow replay`` opens: the recordings of a file or a pipe, the streams of the service that
get them, and the declarations of these."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer

from ....converters.recordings.many_streams import (
    Recordings,
    has_many_streams,
    is_log,
    open_recordings,
    open_table,
)
from ....converters.recordings.piped import Piped, Readable, open_pipe
from ....converters.recordings.recording import Recording
from ....converters.recordings.table_options import TableOptions
from ....converters.recordings.time_order import TimeOrder, in_time_order
from ....streams.sample import FieldType
from ....streams.time import HOUR
from ...client.client import Client, ServiceError


@dataclass(frozen=True, slots=True)
class Track:
    """A recording for a stream; ``there``: the stream if it exists already."""

    recording: Recording
    there: Mapping[str, Any] | None
    order: TimeOrder | None = None

    def in_time_order(self, sort: bool | None) -> Track:
        """Return the track with its rows sorted according to ``sort``."""
        order = in_time_order(self.recording, sort)
        return Track(order.recording, self.there, order)


@dataclass(frozen=True, slots=True)
class Opened:
    """The tracks by stream, and the recorder's losses (None: unknown)."""

    tracks: Mapping[str, Track]
    dropouts: int | None = None
    lost: int = 0
    notes: tuple[str, ...] = ()
    piped: Piped | None = None
    """The rows of a pipe."""


def _existing(client: Client, stream: str) -> dict[str, Any] | None:
    """Return the stream from the service; None if it does not exist."""
    try:
        return client.stream(stream)
    except ServiceError as error:
        if error.status != 404:
            raise
        return None


def _types(there: Mapping[str, Any] | None, names: Sequence[str]) -> dict[str, FieldType]:
    """Return the types of the existing stream's fields with these ``names``."""
    fields = () if there is None else there["fields"]
    return {f["name"]: FieldType(f["type"]) for f in fields if f["name"] in names}


def open_file(
    client: Client,
    file: Path,
    wanted: list[str],
    tables: TableOptions,
    utc: bool,
) -> Opened:
    """Open the streams of the file; fields of existing streams keep their types."""
    if not has_many_streams(file):
        there = _existing(client, _only(wanted))
        recording = open_table(file, tables)
        types = _types(there, recording.schema.names)
        if types and not recording.is_rdf:
            recording = open_table(file, tables, types)
        return Opened({wanted[0]: Track(recording, there)})
    found = open_recordings([file], tables, utc=utc)
    names = _chosen(wanted, found)
    there = {name: _existing(client, name) for name in names.values()}
    if not is_log(file):
        kinds = {
            topic: _types(there[name], found[topic].schema.names) for topic, name in names.items()
        }
        if any(kinds.values()):
            found = open_recordings([file], tables, kinds)
    tracks = {name: Track(found[topic], there[name]) for topic, name in names.items()}
    return Opened(tracks, found.dropouts, found.lost, found.notes)


def open_piped(client: Client, pipe: Readable, wanted: list[str], tables: TableOptions) -> Opened:
    """Open the stream of a pipe by reading its head."""
    there = _existing(client, _only(wanted))
    types = {} if there is None else {f["name"]: FieldType(f["type"]) for f in there["fields"]}
    piped = open_pipe(pipe, tables, types)
    return Opened({wanted[0]: Track(piped.recording, there)}, piped=piped)


def _only(wanted: list[str]) -> str:
    if len(wanted) != 1:
        raise typer.BadParameter("a table is played into one stream: --stream NAME")
    return wanted[0]


def _chosen(wanted: list[str], found: Recordings) -> dict[str, str]:
    """Return the stream to publish to, by the name in the recording."""
    names: dict[str, str] = {}
    for text in wanted:
        topic, _, name = text.partition("=")
        if topic not in found:
            raise typer.BadParameter(f"no stream {topic!r} in the recording: {', '.join(found)}")
        names[topic] = name or topic
    names = names or {topic: topic for topic in found}
    if len(set(names.values())) < len(names):
        raise typer.BadParameter("each stream of the recording needs a name of its own")
    return names


def declare(
    client: Client,
    name: str,
    track: Track,
    lateness: str | None,
    idle: str | None,
    ahead: int | None,
) -> None:
    """Declare the stream with the recording's fields and the options; the rest stays as in an
    existing stream."""
    fields = [{"name": f.name, "type": f.type.value} for f in track.recording.schema.fields]
    there = track.there
    if track.recording.is_rdf:
        _declare_rdf(client, name, there, lateness, idle, ahead)
        return
    if there is None:
        bound = HOUR if ahead is None else ahead
        client.put_stream(name, fields, lateness=lateness or 0, idle=idle, ahead=bound)
        return
    if {f["name"] for f in there["fields"]} == {f["name"] for f in fields}:
        fields = there["fields"]
        if lateness is None and idle is None and ahead is None:
            return
    client.put_stream(
        name,
        fields,
        lateness=there["lateness"] if lateness is None else lateness,
        idle=there["idle"] if idle is None else idle,
        ahead=there["ahead"] if ahead is None else ahead,
        retention=there["retention"],
        namespace=there["namespace"],
    )


def _declare_rdf(
    client: Client,
    name: str,
    there: Mapping[str, Any] | None,
    lateness: str | None,
    idle: str | None,
    ahead: int | None,
) -> None:
    """The same for a recording of RDF: a stream has its fields by its kind."""
    options = {"lateness": lateness, "idle": idle, "ahead": ahead}
    given: dict[str, Any] = {key: value for key, value in options.items() if value is not None}
    if there is not None and there["kind"] == "rdf":
        if not given:
            return
        kept = ("lateness", "idle", "ahead", "retention")
        client.put_rdf_stream(
            name, time=there["time"], **{**{key: there[key] for key in kept}, **given}
        )
        return
    client.put_rdf_stream(name, **given)
