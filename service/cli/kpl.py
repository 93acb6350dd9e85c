"""``dyknow kpl``: check KPL declarations, and prove them on a recording, without a server."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ...converters.recordings import in_order, open_recordings
from ...engine.errors import DyknowError
from ...engine.loading import load_processes
from ...engine.processes import PROCESSES
from ...engine.proving import Proof, prove_specification
from ...languages.kpl import Signature, SourceDeclaration, check_kpl, format_kpl, parse_kpl
from ...ontology.ontology import Ontology
from ..problems import problem_of
from .output import Json, fail, show_lines, show_table, show_text
from .streams import read_text

kpl = typer.Typer(
    help="KPL, the knowledge processing language: check, prove.", no_args_is_help=True
)

File = Annotated[
    Path, typer.Argument(help="A text of KPL declarations.", exists=True, dir_okay=False)
]
Unit = Annotated[
    str, typer.Option(help="What integers are where the text does not say: ns, us, ms or s.")
]


@kpl.command()
def check(file: File, unit: Unit = "ms", as_json: Json = False) -> None:
    """Check declarations and print them in their one spelling."""
    signature = _signature(file, unit)
    if as_json:
        show_lines({"name": one.key, "text": format_kpl(one)} for one in signature.declarations)
    else:
        show_text(format_kpl(signature.declarations))


@kpl.command()
def prove(
    file: File,
    recording: Annotated[
        list[str],
        typer.Argument(
            help="A flight log, a table named like its source, NAME=FILE, or a folder of them.",
            metavar="RECORDING...",
        ),
    ],
    processes: Annotated[
        list[str] | None,
        typer.Option(help="A module or .py file with computational units. May be repeated."),
    ] = None,
    unit: Unit = "ms",
    time_unit: Annotated[
        str | None,
        typer.Option(help="Unit of numeric times in tables: s, ms, us, ns; else by magnitude."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Replay a recording and prove that each declared stream is what its policy admits.

    Status 1 if one is not. "as recorded" tells whether the recording itself keeps the policy, and
    the first sample that does not.
    """
    signature = _signature(file, unit)
    for report in load_processes(processes or ()):
        if report.error:
            raise fail(f"{report.origin}: {report.error}")
    recordings = open_recordings(recording, time_unit=time_unit)
    sources = [one.name for one in signature.declarations if isinstance(one, SourceDeclaration)]
    missing = [name for name in sources if name not in recordings]
    if missing:
        raise fail(
            f"nothing was recorded for source {', '.join(missing)}",
            f"name a file with {missing[0]}=FILE; there are {', '.join(recordings)}",
        )
    try:
        chosen = {name: recordings[name] for name in sources}
        proofs = prove_specification(signature, PROCESSES, in_order(chosen))
    except DyknowError as error:
        problem = problem_of(error).model().model_dump(exclude_none=True)
        raise fail(str(error), problem=problem) from error
    if as_json:
        show_lines(_as_json(proof) for proof in proofs)
    else:
        _show(proofs)
    if not all(proof.holds for proof in proofs):
        raise typer.Exit(1)


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
        empty="the text declares no stream: stream NAME = LABEL with POLICY",
    )
    for proof in proofs:
        if proof.failure is not None:
            show_text(f"{proof.stream}: a unit failed: {proof.failure}")
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
