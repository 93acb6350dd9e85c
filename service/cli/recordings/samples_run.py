"""The work of ``dyknow run`` for a monitor or a pattern: print its results."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import asdict

import typer

from ....converters.ndjson import sample_json
from ....engine.recorded_run import RecordedRun, RunFailed, Summary, run
from ....streams.sample import Value
from ..events import sample_line, show_emptiness
from ..output import err, fail, show_json, show_text
from ..parameters import BoundsWord, ReportWord, show_order, warn_of_annotations
from ..streams import text_or_file
from .run_options import RunOptions, files_of


def run_over_samples(options: RunOptions, what: str) -> None:
    """Print the results of a monitor or pattern (``what`` names it) over recorded streams, and a
    summary on standard error. Status 1 if it fails."""
    _refuse_options_of_queries(options, what)
    if options.ssl is None:
        raise typer.BadParameter(f"a {what} reads tables of samples: --ssl says what they contain")
    files = files_of(options.stream)
    running = run(
        options.text,
        files,
        ssl=text_or_file(options.ssl),
        ontology=options.ontology or (),
        sort=options.sort,
        tables=options.tables,
    )
    warn_of_annotations(running.unrecorded, files)
    for name, order in running.orders.items():
        show_order(files[name].name, order)
    for name in running.unread:
        err().print(f"warning: the {what} does not need stream {name!r}", markup=False)
    failure = None
    try:
        _show_results(running, as_json=options.as_json)
    except RunFailed as error:
        failure = str(error)
    if options.explain:
        err().print(running.explain(), markup=False, highlight=False)
    _show_summary(running.summary, as_json=options.as_json)
    if failure is not None:
        raise fail(failure)


def _refuse_options_of_queries(options: RunOptions, what: str) -> None:
    is_monitor = what == "monitor"
    given = {
        "--static": (options.static, "a domain ontology comes with --ontology"),
        "--semantics": (options.semantics, f"a {what} has no windows"),
        "--bounds": (options.bounds is not BoundsWord.LATER, f"a {what} has no windows"),
        "--origin": (
            options.origin != "0",
            "`sample every t, from TIME` sets the first state"
            if is_monitor
            else "a pattern has no windows",
        ),
        "--report": (
            options.report is not ReportWord.NON_EMPTY,
            "the text says it: `with report violations | changes | verdicts`"
            if is_monitor
            else "each match is reported",
        ),
        "--lateness": (
            options.lateness,
            "the text says it: `with max delay t`",
        ),
        "--late": (options.late, "late samples are only counted"),
    }
    for option, (is_given, instead) in given.items():
        if is_given:
            raise typer.BadParameter(f"{option} means nothing for a {what}: {instead}")


def _show_results(running: RecordedRun, *, as_json: bool) -> None:
    for sequence, (available, valid, values) in enumerate(_samples(running), 1):
        times = sample_json(available, valid, {})
        if as_json:
            sample = {"stream": running.name, "sequence": sequence, **times, "values": values}
            show_json({"event": "sample", **sample})
        else:
            show_text(sample_line(str(times["valid"]), values))


def _samples(running: RecordedRun) -> Iterator[tuple[int, int, dict[str, Value]]]:
    for batch in running.batches():
        yield from batch.rows()


def _show_summary(summary: Summary, *, as_json: bool) -> None:
    if as_json:
        print(json.dumps(asdict(summary), ensure_ascii=False), file=sys.stderr)
        return
    told = f"{summary.results:,} results"
    if summary.states is not None and summary.verdicts is not None:
        verdicts = ", ".join(f"{count:,} {word}" for word, count in summary.verdicts.items())
        told = f"{summary.states:,} states; verdicts: {verdicts}"
    late = f"; {summary.late:,} samples were late" if summary.late else ""
    err().print(f"{summary.samples:,} samples read, {told}{late}", markup=False, highlight=False)
    show_emptiness(summary.empty)
