"""The work of ``dyknow inspect``: read a recording, and show what it holds."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from ....converters.recordings.many_streams import (
    Recordings,
    has_many_streams,
    is_log,
    open_recordings,
)
from ....converters.recordings.overview import Overview, overview
from ....converters.recordings.table_options import TableOptions
from ....ontology.ontology import Ontology
from ....ontology.texts.formats import FORMATS
from ....ontology.vocabulary import Vocabulary
from ....rdf.namespaces import shorten
from ....streams.time import format_duration, format_time
from ..output import brief, connect, err, fail, show_json, show_table, show_text
from ..parameters import show_losses
from ..streams import read_text
from .ssl_skeleton import known_features, ssl_skeleton

_OPTIONS: Final = ("time_column", "time_unit", "time_format", "delimiter")


@dataclass(frozen=True, slots=True)
class Inspected:
    """A recording, its streams by name, and the words that know features: also those of the
    ``ontologies`` and of the service at ``url``."""

    file: Path
    tables: TableOptions
    utc: bool
    recordings: Recordings
    streams: Mapping[str, Overview]
    vocabulary: Vocabulary
    ontologies: Sequence[Path]
    url: str | None


def inspect(
    file: Path, tables: TableOptions, utc: bool, ontology: Sequence[Path], url: str | None
) -> Inspected:
    """Read the recording and the ontologies, also those of the service at ``url``. Raises
    `WireError` and `OntologyError`."""
    known = Ontology.open(None)
    if url is not None:
        with connect(url) as client:
            shipped = set(known.ontologies())
            texts = [client.ontology(each) for each in client.ontologies() if each not in shipped]
        if texts:
            # As one text: each load makes the closure again.
            known.load("\n".join(texts), name=url)
    for path in ontology:
        format = FORMATS.get(path.suffix.lower(), "turtle")
        known.load(read_text(path), name=path.stem, format=format)
    recordings = open_recordings([file], tables, utc=utc)
    streams = {name: overview(recording) for name, recording in recordings.items()}
    return Inspected(file, tables, utc, recordings, streams, known.vocabulary, ontology, url)


def show_streams(found: Inspected, written: Path | None) -> None:
    """Print each stream's fields and times, then the SSL text, unless it is ``written`` to a file,
    and the next commands."""
    for name, its in found.streams.items():
        show_text(_summary(name, its))
        features = known_features(its, found.vocabulary)
        rows = [
            (field.name, field.type.value, _feature(field.name, its, features))
            for field in its.schema.fields
        ]
        show_table(["field", "type", "feature"], rows, unfolded=["field"])
        show_text("")
    recordings = found.recordings
    show_losses(recordings.dropouts, recordings.lost, recordings.notes)
    if _is_rdf(found):
        show_text("RDF says itself what it means: it needs no SSL text.")
    else:
        show_text(_skeletons(found) if written is None else f"The SSL text is in {written}.")
    if not found.file.is_dir() or is_log(found.file):
        show_text("\nnext:")
        for command in _next(found, written):
            show_text(f"  {command}")


def write_skeletons(found: Inspected, path: Path) -> None:
    """Write the SSL text of all streams to a new file: an older one may be filled in already."""
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(_skeletons(found) + "\n")
    except FileExistsError:
        raise fail(f"there is a file {path} already", "name a new one with --skeleton") from None


def show_json_streams(found: Inspected) -> None:
    """Print a line of JSON for each stream."""
    for name, its in found.streams.items():
        features = known_features(its, found.vocabulary)
        show_json(
            {
                "stream": name,
                "samples": its.samples,
                "first": format_time(its.first),
                "last": format_time(its.last),
                "rate": its.rate,
                "out_of_order": its.out_of_order,
                "time_column": its.time_column,
                "has_available": its.has_available,
                "id_field": its.id_field,
                "objects": its.objects,
                "fields": [
                    {"name": f.name, "type": f.type.value, "feature": features.get(f.name)}
                    for f in its.schema.fields
                ],
                "ssl": ssl_skeleton(name, its, found.vocabulary),
            }
        )
    for note in found.recordings.notes:
        err().print(f"note: {note}", markup=False, highlight=False)


def _summary(name: str, its: Overview) -> str:
    each = f" for each of {its.objects:,} {its.id_field}" if its.id_field else ""
    rate = "all at one time" if its.rate is None else f"{its.rate:.3g}/s{each} (median)"
    order = f"{its.out_of_order:,} rows out of order" if its.out_of_order else "all in order"
    available = ", available times by its own column" if its.has_available else ""
    length = brief(format_duration(its.last - its.first))
    return (
        f"{name}: {its.samples:,} samples in {length}, {rate}, {order}\n"
        f"  {format_time(its.first)} to {format_time(its.last)}, valid times by "
        f"{its.time_column!r}{available}"
    )


def _feature(field: str, its: Overview, features: Mapping[str, str]) -> str:
    if field == its.id_field:
        return "(names the object)"
    return shorten(features[field]) if field in features else "-"


def _is_rdf(found: Inspected) -> bool:
    return all(recording.is_rdf for recording in found.recordings.values())


def _skeletons(found: Inspected) -> str:
    texts = [ssl_skeleton(name, its, found.vocabulary) for name, its in found.streams.items()]
    return "\n\n".join(texts)


def _next(found: Inspected, written: Path | None) -> list[str]:
    """The commands that write the SSL text and play the recording by it."""
    options = {
        f"--{name.replace('_', '-')}": value
        for name in _OPTIONS
        if (value := getattr(found.tables, name)) is not None
    }
    words = [word for pair in options.items() for word in pair] + ["--utc"] * found.utc
    file, first = str(found.file), next(iter(found.streams))
    text = found.file.name.partition(".")[0] + ".ssl" if written is None else str(written)
    streams = ["--stream", first] if not has_many_streams(found.file) else []
    if _is_rdf(found):
        return [shlex.join(["dyknow", "replay", file, *streams, *words])]
    service = [] if found.url is None else ["--url", found.url]
    known = [word for path in found.ontologies for word in ("--ontology", str(path))]
    write = shlex.join(["dyknow", "inspect", file, *words, *known, *service, "--skeleton", text])
    play = shlex.join(["dyknow", "replay", file, *streams, *words, *service, "--ssl", text])
    return [write, play] if written is None else [play]
