"""Files of RDF with times as recordings of a stream of RDF (`rdf.statements`)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

from pyoxigraph import RdfFormat

from ...streams.sample import SampleBatch
from ...streams.string_pool import StringPool
from ..csv_table import CHUNK
from ..errors import WireError
from ..rdf.statements import SCHEMA, decode_statements
from .recording import Recording
from .text_files import ending, read_whole

FORMATS: Final = {
    ".nt": RdfFormat.N_TRIPLES,
    ".nq": RdfFormat.N_QUADS,
    ".ttl": RdfFormat.TURTLE,
    ".trig": RdfFormat.TRIG,
    ".jsonld": RdfFormat.JSON_LD,
}


def is_rdf_file(path: Path) -> bool:
    """Whether the name of a file ends like one of RDF, without ``.gz``."""
    return ending(path) in FORMATS


def open_rdf(path: Path, time_property: str = "") -> Recording:
    """The statements of a file, at the times of their graphs, or by ``time_property`` (an IRI).

    Raises `WireError` with the line, also for a file without times. Memory: the whole file.
    """
    pools: dict[str, StringPool] = {}
    format = FORMATS[ending(path)]
    incoming = decode_statements(read_whole(path), format, pools, None, time_property)
    if incoming.stamped:
        raise WireError(
            None,
            f"{path.name} says no times",
            "put its triples into graphs with prov:generatedAtTime (.nq, .trig), or name the "
            "property that gives times: --time-column IRI",
        )
    batch = incoming.batch

    def read() -> Iterator[SampleBatch]:
        for start in range(0, len(batch), CHUNK):
            yield batch.take(slice(start, start + CHUNK))

    told = time_property or "prov:generatedAtTime"
    return Recording(SCHEMA, len(batch), pools, read, time_column=told, is_rdf=True)
