"""The work of ``dyknow run``: read files as streams, and evaluate a query over them."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import typer
from pyoxigraph import Literal, NamedNode

from ....continuous.evaluate import Explained, TimedTerm, Window, evaluate
from ....converters.recordings.many_streams import open_stream
from ....converters.recordings.table_options import GUESSED
from ....converters.recordings.time_order import in_time_order
from ....converters.to_triples import SampleConverter, node_names
from ....languages.errors import LanguageError
from ....languages.ssl import check_ssl, parse_ssl
from ....languages.ssl.annotation import StreamAnnotation
from ....ontology.errors import OntologyError
from ....ontology.ontology import Ontology
from ....ontology.texts.formats import FORMATS
from ....ontology.units import Unit
from ....ontology.vocabulary import Vocabulary
from ....rdf.dictionary import TermDictionary
from ....rdf.namespaces import local_name, shorten
from ....rdf.timed import TimedTriples, TripleRows
from ....streams.instants import Places
from ....streams.time import format_time, parse_duration
from ..output import err, fail, show_json, show_table, show_text
from ..parameters import (
    origin_of,
    show_order,
    warn_of_annotations,
)
from ..streams import read_text, text_or_file
from .empty_windows import Traffic
from .run_options import RunOptions, add_file, existing_file, files_of
from .triples_file import (
    TripleWriter,
    holds_graphs,
    read_timed_graphs,
    read_timed_triples,
)


def run_query(options: RunOptions) -> None:
    """Evaluate a continuous query over recorded streams and print each window's result."""
    if options.ontology:
        raise typer.BadParameter("--ontology is for monitors: a query reads files with --static")
    behind = _lateness(options.lateness)
    begin = origin_of(options.origin)
    files = files_of(options.stream)
    known = _static(options.static or ())
    paths = list(known.values()) if isinstance(known, dict) else known
    if options.late is not None:
        _check_late(behind, files, options.ssl)
    inputs: dict[str, Any]
    if options.ssl is not None:
        inputs = _samples(files, text_or_file(options.ssl), paths, options)
    elif options.tables != GUESSED:
        raise typer.BadParameter(
            "--time-column, --time-unit, --time-format and --delimiter are for tables of samples: "
            "give their annotation with --ssl"
        )
    else:
        inputs = _triples(files, in_order=behind is not None)
    traffic = Traffic()
    inputs = {name: traffic.watch(given) for name, given in inputs.items()}
    late = _Late(None if options.late is None else TripleWriter(options.late))
    explained = Explained(time.perf_counter_ns)
    try:
        windows = evaluate(
            options.text,
            inputs,
            static=known,
            semantics=None if options.semantics is None else options.semantics.value,
            bounds=options.bounds.value,
            origin=begin,
            lateness=behind,
            explained=explained if options.explain else None,
            report=options.report.value,
            late=late.add,
        )
    except (LanguageError, OntologyError):
        raise  # the command line prints them with their place
    except ValueError as error:
        raise fail(str(error)) from error
    with late:
        count = _print(windows, as_json=options.as_json)
    if options.explain:
        err().print(str(explained), markup=False, highlight=False)
    if not options.as_json:
        behind_by = f", {late.count} late" if late.count else ""
        show_text(f"({count} {'window' if count == 1 else 'windows'} with a result{behind_by})")
        if not count:
            err().print(f"nothing came: {traffic.why_empty(options.text, known)}", markup=False)


def _print(windows: Iterator[Window], *, as_json: bool) -> int:
    """Show the windows that have a result; return their number."""
    count = 0
    for window in windows:
        if isinstance(window.solutions, list) and not window.solutions:
            continue
        count += 1
        if as_json:
            show_json({"end": format_time(window.end), "solutions": _plain(window.solutions)})
        else:
            _show(window.end, window.solutions)
    return count


class _Late:
    """Counts late triples, and writes them to a file if there is one."""

    def __init__(self, writer: TripleWriter | None) -> None:
        self.count = 0
        self._writer = writer

    def __enter__(self) -> _Late:
        return self

    def __exit__(self, *_: object) -> None:
        if self._writer is not None:
            self._writer.close()

    def add(self, triple: TimedTerm) -> None:
        """Count and write a late triple."""
        self.count += 1
        if self._writer is not None:
            self._writer.write(triple)


def _check_late(lateness: int | None, files: Mapping[str, Path], ssl: str | None) -> None:
    """Check that triples can be late: only files that are read in their own order have such."""
    if lateness is None:
        raise typer.BadParameter("--late requires --lateness: sorted files have no late triples")
    if ssl is not None or any(map(holds_graphs, files.values())):
        raise typer.BadParameter(
            "--late goes with timed triples (.ndjson, .csv): tables of samples and graphs are "
            "sorted, and nothing of them is late"
        )


def _lateness(text: str | None) -> int | None:
    try:
        return None if text is None else parse_duration(text)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error


def _static(given: Sequence[str]) -> list[Path] | dict[str, Path]:
    """Return files, or graphs by name, but not both: a query reads all files, but only the graphs
    that its FROM clauses name."""
    files: list[Path] = []
    named: dict[str, Path] = {}
    for text in given:
        iri, equals, name = text.rpartition("=")
        if equals and iri and not Path(text).is_file():
            add_file(named, "--static", iri, Path(name))
        else:
            files.append(existing_file(Path(text)))
    if files and named:
        raise typer.BadParameter("--static: name every file with IRI=, or none")
    return named or files


def _triples(files: Mapping[str, Path], *, in_order: bool) -> dict[str, Any]:
    found: dict[str, Any] = {}
    dictionary = TermDictionary()
    for iri, path in files.items():
        if holds_graphs(path):
            found[iri] = read_timed_graphs(path, dictionary)
            continue
        triples = read_timed_triples(path)
        found[iri] = triples if in_order else list(triples)
    return found


def _samples(
    files: Mapping[str, Path], ssl: str, static: Sequence[Path], options: RunOptions
) -> dict[str, Any]:
    """Convert tables of samples to timed triples, by the annotation of the stream's name."""
    ontology = Ontology.open()
    for path in static:
        text = read_text(path)
        ontology.load(text, name=path.stem, format=FORMATS.get(path.suffix.lower(), "turtle"))
    vocabulary = ontology.vocabulary
    checked = check_ssl(parse_ssl(ssl), ssl, vocabulary)
    annotations = [a for a in checked if isinstance(a, StreamAnnotation)]
    effect = "; it is used all the same" if len(annotations) == 1 else ""
    warn_of_annotations(
        (one.stream for one in annotations), map(_stream_name, files), effect=effect
    )
    dictionary = TermDictionary()
    found: dict[str, Any] = {}
    for iri, path in files.items():
        annotation = _annotation(iri, annotations)
        order = in_time_order(open_stream(path, _stream_name(iri), options.tables), options.sort)
        show_order(path.name, order)
        recording = order.recording
        converter = SampleConverter(
            annotation,
            recording.schema,
            vocabulary,
            dictionary,
            units=_units(annotation, vocabulary),
        )
        tables: list[TripleRows] = []
        places = Places()
        for incoming in recording:
            available = incoming.batch.available
            names = node_names(available, places.of(available)) if converter.makes_nodes else None
            tables += converter.convert(incoming.batch, names).tables
        found[iri] = TimedTriples(dictionary, tuple(tables))
    return found


def _units(annotation: StreamAnnotation, vocabulary: Vocabulary) -> dict[str, Unit]:
    """Return the ontology's unit of each feature, which queries use."""
    known = {
        content.feature: vocabulary.feature(content.feature) for content in annotation.contents
    }
    return {feature: info.unit for feature, info in known.items() if info and info.unit is not None}


def _stream_name(iri: str) -> str:
    return local_name(iri).removesuffix(".trdf")


def _annotation(iri: str, annotations: Sequence[StreamAnnotation]) -> StreamAnnotation:
    name = _stream_name(iri)
    for annotation in annotations:
        if annotation.stream == name:
            return annotation
    if len(annotations) == 1:
        return annotations[0]
    raise fail(
        f"--ssl has no annotation of stream {name!r}", f"annotate it: stream {name} contains"
    )


def _show(end: int, solutions: object) -> None:
    show_text(f"window that ends {format_time(end)}")
    if isinstance(solutions, bool):
        show_text("  yes" if solutions else "  no")
        return
    assert isinstance(solutions, list)
    if isinstance(solutions[0], Mapping):
        names = list(dict.fromkeys(name for row in solutions for name in row))
        show_table(names, [[_term(row.get(name)) for name in names] for row in solutions])
    else:
        for triple in solutions:
            show_text("  " + " ".join(_term(term) for term in triple))


def _plain(solutions: object) -> object:
    if isinstance(solutions, bool):
        return solutions
    assert isinstance(solutions, list)
    return [
        {name: str(term) for name, term in row.items()}
        if isinstance(row, Mapping)
        else [str(term) for term in row]
        for row in solutions
    ]


def _term(term: object) -> str:
    if isinstance(term, NamedNode):
        return shorten(term.value)
    if isinstance(term, Literal):
        return term.value
    return "-" if term is None else str(term)
