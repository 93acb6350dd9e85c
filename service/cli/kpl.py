"""``dyknow kpl``: check KPL declarations, prove and run them on a recording, without a server; add,
show and remove them with one."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from ...converters.ndjson import sample_json
from ...converters.recordings.many_streams import in_order, open_recordings
from ...converters.wire import Incoming
from ...engine.kpl.verification import Proof, prove_specification, rehearse
from ...engine.model.errors import DyknowError
from ...engine.processes.registry import PROCESSES
from ...languages.kpl import (
    Signature,
    SourceDeclaration,
    StreamDeclaration,
    check_kpl,
    format_kpl,
    parse_kpl,
)
from ...languages.ssl import check_ssl, parse_ssl
from ...languages.ssl.annotation import StreamAnnotation
from ...ontology.ontology import Ontology
from ...streams.time import format_time
from ..http.problems import problem_of
from ..runtime.process_watchdog import Watchdog
from .output import (
    DEFAULT_URL,
    Json,
    Url,
    connect,
    err,
    fail,
    show_json,
    show_lines,
    show_table,
    show_text,
    show_values,
)
from .serve import load
from .streams import read_text, text_or_file

kpl = typer.Typer(
    help="KPL, the knowledge processing language: check, prove, run, add, show, remove.",
    no_args_is_help=True,
)

File = Annotated[
    Path, typer.Argument(help="A text of KPL declarations.", exists=True, dir_okay=False)
]
Unit = Annotated[
    Literal["ns", "us", "ms", "s"],
    typer.Option(help="What integers are where the text does not say."),
]


@kpl.command()
def check(file: File, unit: Unit = "ms", as_json: Json = False) -> None:
    """Check declarations and print them in their one spelling."""
    signature = _signature(file, unit)
    if as_json:
        show_lines({"name": one.key, "text": format_kpl(one)} for one in signature.declarations)
    else:
        show_text(format_kpl(signature.declarations))


Recordings = Annotated[
    list[str],
    typer.Argument(
        help="A flight log, a table named like its source, NAME=FILE, or a folder of them.",
        metavar="RECORDING...",
    ),
]
Modules = Annotated[
    list[str] | None,
    typer.Option(
        "--processes", help="A module or .py file with computational units. May be repeated."
    ),
]
TimeUnit = Annotated[
    str | None,
    typer.Option(
        help="Unit of numeric times in tables: s, ms, us, ns; else by magnitude, and small ones "
        "are what the text's integers are."
    ),
]


Ssl = Annotated[
    str | None,
    typer.Option(
        help="What the sources are about, SSL text or its file: policies then hold for each object "
        "by itself."
    ),
]


@kpl.command()
def prove(
    file: File,
    recording: Recordings,
    ssl: Ssl = None,
    processes: Modules = None,
    unit: Unit = "ms",
    time_unit: TimeUnit = None,
    as_json: Json = False,
) -> None:
    """Replay a recording and prove each policy, join and sync against its definition.

    Status 1 if one does not hold, or if nothing was proved. "as recorded" tells whether the
    recording itself keeps the policy, and the first sample that does not.
    """
    signature, samples = _recorded(file, recording, processes, unit, time_unit)
    annotations = _annotations(signature, ssl)
    with _watched() as watchdog:
        proofs = prove_specification(signature, PROCESSES, samples, watchdog, annotations)
    if as_json:
        show_lines(_as_json(proof) for proof in proofs)
    else:
        _show(proofs)
    if not all(proof.holds for proof in proofs):
        raise typer.Exit(1)
    if not any(proof.received for proof in proofs):
        raise fail(
            "nothing was proved: "
            + ("no stream has a sample" if proofs else "the text has no stream, join or sync"),
            "record samples of the sources"
            if proofs
            else "declare stream NAME = LABEL with POLICY",
        )


@kpl.command()
def run(
    file: File,
    recording: Recordings,
    stream: Annotated[
        list[str] | None,
        typer.Option(
            help="A stream, label or source; else every declared stream. May be repeated."
        ),
    ] = None,
    ssl: Ssl = None,
    processes: Modules = None,
    unit: Unit = "ms",
    time_unit: TimeUnit = None,
    as_json: Json = False,
) -> None:
    """Replay a recording and print the samples of the declared streams, by available time.

    With --json one a line, as they can be published again.
    """
    signature, samples = _recorded(file, recording, processes, unit, time_unit)
    annotations = _annotations(signature, ssl)
    names = stream or [d.key for d in signature.declarations if isinstance(d, StreamDeclaration)]
    with _watched() as watchdog:
        rehearsal = rehearse(signature, PROCESSES, samples, watchdog, annotations)
        made = {name: rehearsal.application.samples_of(name) for name in names}
    rows = heapq.merge(
        *([(a, name, v, values) for a, v, values in batch.rows()] for name, batch in made.items()),
        key=lambda row: row[:2],
    )
    if as_json:
        show_lines(
            {"stream": name, **sample_json(available, valid, values)}
            for available, name, valid, values in rows
        )
    else:
        for available, name, valid, values in rows:
            times = f"{format_time(available)}  {format_time(valid)}"
            show_text(f"{name}  {times}  {show_values(values)}")
    for name, reason in rehearsal.failures:
        err().print(f"{name}: {reason}", markup=False)
    if rehearsal.failures:
        raise typer.Exit(1)


def _recorded(
    file: Path,
    recording: list[str],
    processes: list[str] | None,
    unit: str,
    time_unit: str | None,
) -> tuple[Signature, Iterator[tuple[str, Incoming]]]:
    """What was declared, and what was recorded of its sources."""
    signature = _signature(file, unit)
    load(processes or ())
    types = {
        one.name: {field.name: field.type for field in one.sort.fields or ()}
        for one in signature.declarations
        if isinstance(one, SourceDeclaration)
    }
    recordings = open_recordings(
        recording,
        time_unit=time_unit,
        types=types,
        abstract_unit=_unit_of(read_text(file), unit),
        skip_empty=True,
    )
    sources = [one.name for one in signature.declarations if isinstance(one, SourceDeclaration)]
    missing = [name for name in sources if name not in recordings]
    if missing:
        said = f"nothing was recorded for source {', '.join(missing)}"
        hint = f"name a file with {missing[0]}=FILE; there are {', '.join(recordings)}"
        if len(missing) == len(sources):
            raise fail(said, hint)
        err().print(f"{said}, so it is silent ({hint})", markup=False)
    return signature, in_order({n: recordings[n] for n in sources if n in recordings})


def _annotations(signature: Signature, ssl: str | None) -> list[StreamAnnotation]:
    """What an SSL text says of streams of the specification; others are named in a warning."""
    if ssl is None:
        return []
    text = text_or_file(ssl)
    checked = check_ssl(parse_ssl(text), text, Ontology.open(None).vocabulary)
    found = [one for one in checked if isinstance(one, StreamAnnotation)]
    for one in found:
        if signature.find(one.stream) is None:
            err().print(
                f"warning: the SSL text annotates stream {one.stream!r}, which is not declared",
                markup=False,
            )
    return found


@contextmanager
def _watched() -> Iterator[Watchdog]:
    """A runner of user-written code; refusals of the engine become messages."""
    watchdog = Watchdog()
    try:
        yield watchdog
    except DyknowError as error:
        problem = problem_of(error).model().model_dump(exclude_none=True)
        raise fail(str(error), problem=problem) from error
    finally:
        watchdog.close()


@kpl.command()
def add(
    source: Annotated[str, typer.Argument(help="KPL text, its file, or - .")],
    unit: Unit = "ms",
    url: Url = DEFAULT_URL,
    as_json: Json = False,
) -> None:
    """Declare processes and streams in a running service."""
    text = text_or_file(source)
    with connect(url) as client:
        found = client.declare_kpl(text, unit)
    if as_json:
        show_lines(found)
        return
    for declaration in found:
        show_text(declaration["text"])
    if not found:
        show_text("nothing new: all of it was declared before")


@kpl.command()
def show(
    name: Annotated[str | None, typer.Argument(help="A name or label; else everything.")] = None,
    url: Url = DEFAULT_URL,
    as_json: Json = False,
) -> None:
    """Print what is declared in a running service, or all about one declaration."""
    with connect(url) as client:
        if name is not None:
            one = client.kpl_declaration(name)
            if as_json:
                show_json(one)
            else:
                _show_one(one)
            return
        found = client.kpl()
    if as_json:
        show_lines(found)
    elif found:
        show_text("\n".join(declaration["text"] for declaration in found))
    else:
        show_text("nothing is declared yet: dyknow kpl add FILE")


@kpl.command()
def remove(
    name: Annotated[str, typer.Argument(help="A name or label.")],
    cascade: Annotated[
        bool, typer.Option("--cascade", help="Also what cannot be without it.")
    ] = False,
    url: Url = DEFAULT_URL,
    as_json: Json = False,
) -> None:
    """Stop and forget a declaration in a running service."""
    with connect(url) as client:
        removed = client.remove_kpl(name, cascade=cascade)
    if as_json:
        show_json({"removed": removed})
    else:
        show_text(f"removed {', '.join(removed)}")


def _unit_of(text: str, otherwise: str) -> str:
    declared = parse_kpl(text).unit
    return otherwise if declared is None else declared.text


def _show_one(one: dict[str, Any]) -> None:
    show_text(one["text"])
    rows = [
        ("stream", one["stream"]),
        ("unit", one["unit"]),
        ("uses", ", ".join(one["uses"])),
        ("used by", ", ".join(one["used_by"])),
        ("failure", one["failure"]),
        ("errors", one["errors"] or None),
        ("restarts", one["restarts"] or None),
        ("last error", one["last_error"]),
        ("violations", one["violations"]),
        *_counted(one["counters"]),
    ]
    show_table(["", ""], [(key, str(value)) for key, value in rows if value], empty="")


def _counted(counters: dict[str, Any]) -> list[tuple[str, str]]:
    """Counters as rows; what was dropped by its reasons."""
    rows = []
    for key, value in counters.items():
        if isinstance(value, dict):
            rows += [(f"{key}: {reason}", str(count)) for reason, count in value.items()]
        else:
            rows.append((key, str(value)))
    return rows


def _signature(file: Path, unit: str) -> Signature:
    text = read_text(file)
    vocabulary = Ontology.open(None).vocabulary
    _, signature = check_kpl(parse_kpl(text), text, vocabulary, unit=unit)
    return signature


def _show(proofs: tuple[Proof, ...]) -> None:
    show_table(
        ["stream", "samples", "sent", "dropped", "delayed", "approximated", "policy"],
        [
            [
                proof.stream,
                proof.received,
                proof.counters.sent,
                sum(proof.counters.dropped.values()),
                proof.counters.delayed,
                proof.counters.approximated,
                "holds" if proof.holds else "does not hold",
            ]
            for proof in proofs
        ],
        empty="",
    )
    for proof in proofs:
        if proof.failure is not None:
            show_text(f"{proof.stream}: not proved: {proof.failure}")
        if proof.refutation is not None:
            refuted = proof.refutation
            show_text(f"{proof.stream}: row {refuted.row + 1}: {refuted.message}")
        if proof.as_recorded is not None:
            first = proof.as_recorded
            show_text(f"{proof.stream}: not as recorded, from row {first.row + 1}: {first.message}")


def _as_json(proof: Proof) -> dict[str, object]:
    found = {"refutation": proof.refutation, "as_recorded": proof.as_recorded}
    return {
        "stream": proof.stream,
        "term": proof.term,
        "holds": proof.holds,
        "received": proof.received,
        "sent": proof.counters.sent,
        "dropped": {str(kind): count for kind, count in proof.counters.dropped.items()},
        "delayed": proof.counters.delayed,
        "approximated": proof.counters.approximated,
        "failure": proof.failure,
        **{
            key: None if at is None else {"row": at.row + 1, "message": at.message}
            for key, at in found.items()
        },
    }
