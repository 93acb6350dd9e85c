"""The work of ``dyknow kpl check``, ``prove`` and ``run``: without a server, on recordings."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import typer

from ....converters.ndjson import sample_json
from ....converters.recordings.many_streams import in_order, open_recordings
from ....converters.recordings.table_options import TableOptions
from ....converters.recordings.time_order import in_time_order
from ....converters.wire import Incoming
from ....engine.kpl.verification import Proof, prove_specification, rehearse
from ....engine.processes.registry import PROCESSES
from ....languages.kpl import (
    Signature,
    SourceDeclaration,
    StreamDeclaration,
    check_kpl,
    format_kpl,
    parse_kpl,
)
from ....languages.ssl import check_ssl, parse_ssl
from ....languages.ssl.annotation import StreamAnnotation
from ....ontology.ontology import Ontology
from ....streams.time import format_time
from ...runtime.process_watchdog import Watchdog
from ..loading import load
from ..output import err, fail, show_lines, show_table, show_text, show_values
from ..streams import read_text, text_or_file


def check(file: Path, unit: str, *, as_json: bool) -> None:
    """Print the declarations of ``file`` in canonical form."""
    signature = _signature(file, unit)
    if as_json:
        show_lines({"name": one.key, "text": format_kpl(one)} for one in signature.declarations)
    else:
        show_text(format_kpl(signature.declarations))


@dataclass(frozen=True, slots=True)
class Recorded:
    """Declarations with the recordings of their sources: the options of the command."""

    file: Path
    recording: list[str]
    ssl: str | None
    processes: list[str] | None
    unit: str
    tables: TableOptions
    """The option ``abstract_unit`` is that of the declarations."""
    is_sorted: bool = False

    def open(self) -> tuple[Signature, Iterator[tuple[str, Incoming]]]:
        """Read the declarations and the recordings of their sources."""
        signature = _signature(self.file, self.unit)
        load(self.processes or ())
        types = {
            one.name: {field.name: field.type for field in one.sort.fields or ()}
            for one in signature.declarations
            if isinstance(one, SourceDeclaration)
        }
        recordings = open_recordings(
            self.recording,
            replace(self.tables, abstract_unit=_unit_of(read_text(self.file), self.unit)),
            types,
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
        read = {n: recordings[n] for n in sources if n in recordings}
        if self.is_sorted:
            read = {n: in_time_order(each, sort=True).recording for n, each in read.items()}
        return signature, in_order(read)


def prove(recorded: Recorded, *, as_json: bool) -> None:
    """Print the proof of each policy, join and sync; status 1 unless all hold."""
    signature, samples = recorded.open()
    annotations = _annotations(signature, recorded.ssl)
    with _with_watchdog() as watchdog:
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


def run(recorded: Recorded, stream: Sequence[str] | None, *, as_json: bool) -> None:
    """Print the samples of all declared streams, or of those in ``stream``."""
    signature, samples = recorded.open()
    annotations = _annotations(signature, recorded.ssl)
    names = stream or [d.key for d in signature.declarations if isinstance(d, StreamDeclaration)]
    with _with_watchdog() as watchdog:
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


def _annotations(signature: Signature, ssl: str | None) -> list[StreamAnnotation]:
    """Return the annotations of the specification's streams; warn of other streams."""
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
def _with_watchdog() -> Iterator[Watchdog]:
    """Run user-written code under a watchdog."""
    watchdog = Watchdog()
    try:
        yield watchdog
    finally:
        watchdog.close()


def _unit_of(text: str, otherwise: str) -> str:
    declared = parse_kpl(text).unit
    return otherwise if declared is None else declared.text


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
