"""The work of ``dyknow run`` for a monitor: print its verdicts over recorded streams."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import asdict

import typer

from ....converters.ndjson import sample_json
from ....engine.monitor_run import MonitorFailed, MonitorRun, Summary, run
from ....streams.sample import Value
from ..events import sample_line, show_emptiness
from ..output import err, fail, show_json, show_text
from ..parameters import BoundsWord, ReportWord, show_order, warn_of_annotations
from ..streams import text_or_file
from .run_options import RunOptions, files_of


def run_monitor(options: RunOptions) -> None:
    """Print the verdicts of a monitor over recorded streams, and a summary on standard error.
    Status 1 if the monitor fails."""
    _refuse_options_of_queries(options)
    if options.ssl is None:
        raise typer.BadParameter("a monitor reads tables of samples: --ssl says what they contain")
    files = files_of(options.stream)
    checked = run(
        options.text,
        files,
        ssl=text_or_file(options.ssl),
        ontology=options.ontology or (),
        sort=options.sort,
    )
    warn_of_annotations(checked.unrecorded, files)
    for name, order in checked.orders.items():
        show_order(files[name].name, order)
    for name in checked.unread:
        err().print(f"warning: the monitor does not need stream {name!r}", markup=False)
    failure = None
    try:
        _show_verdicts(checked, as_json=options.as_json)
    except MonitorFailed as error:
        failure = str(error)
    if options.explain:
        err().print(checked.explain(), markup=False, highlight=False)
    _show_summary(checked.summary, as_json=options.as_json)
    if failure is not None:
        raise fail(failure)


def _refuse_options_of_queries(options: RunOptions) -> None:
    given = {
        "--static": (options.static, "a domain ontology comes with --ontology"),
        "--semantics": (options.semantics, "a monitor has no windows"),
        "--bounds": (options.bounds is not BoundsWord.LATER, "a monitor has no windows"),
        "--origin": (options.origin != "0", "`sample every t, from TIME` sets the first state"),
        "--report": (
            options.report is not ReportWord.NON_EMPTY,
            "the text says it: `with report violations | changes | verdicts`",
        ),
        "--lateness": (options.lateness, "the text says it: `with max delay t`"),
        "--late": (options.late, "late samples are only counted"),
    }
    for option, (is_given, instead) in given.items():
        if is_given:
            raise typer.BadParameter(f"{option} means nothing for a monitor: {instead}")


def _show_verdicts(checked: MonitorRun, *, as_json: bool) -> None:
    for sequence, (available, valid, values) in enumerate(_samples(checked), 1):
        times = sample_json(available, valid, {})
        if as_json:
            sample = {"stream": checked.name, "sequence": sequence, **times, "values": values}
            show_json({"event": "sample", **sample})
        else:
            show_text(sample_line(str(times["valid"]), values))


def _samples(checked: MonitorRun) -> Iterator[tuple[int, int, dict[str, Value]]]:
    for batch in checked.batches():
        yield from batch.rows()


def _show_summary(summary: Summary, *, as_json: bool) -> None:
    if as_json:
        print(json.dumps(asdict(summary), ensure_ascii=False), file=sys.stderr)
        return
    verdicts = ", ".join(f"{count:,} {word}" for word, count in summary.verdicts.items())
    late = f"; {summary.late:,} samples were late" if summary.late else ""
    err().print(
        f"{summary.samples:,} samples read, {summary.states:,} states; verdicts: {verdicts}{late}",
        markup=False,
        highlight=False,
    )
    show_emptiness(summary.empty)
