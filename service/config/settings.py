"""Settings of the service: environment variables with the prefix ``DYKNOW_``."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

from pydantic import Field, SecretStr
from pydantic_settings import BaseSettings, SettingsConfigDict

from ...converters.wire import BatchLimits
from ...journal.durability import Durability

MEBIBYTE = 1 << 20


def _workers() -> int:
    return max(2, min(4, os.cpu_count() or 1))


class Settings(BaseSettings):
    """The settings, explained in docs/reference/settings.md. Sizes are bytes, durations seconds."""

    model_config = SettingsConfigDict(env_prefix="DYKNOW_", extra="ignore")

    host: str = "127.0.0.1"
    port: int = Field(default=8000, ge=0, le=65535)
    data: Path | None = None
    """The data directory; None keeps everything in memory."""
    durability: Durability = Durability.FSYNC
    """With ``data``: an acknowledged change survives a loss of power (fsync), or the end of the
    process (write)."""
    checkpoint_interval: float = Field(default=300.0, gt=0)
    """With ``data``: the time between two checkpoints, which make a start quick."""
    checkpoint_work: float = Field(default=4.0, gt=0)
    """A checkpoint follows after this many seconds of work, which a start would repeat, unless
    checkpoints would take more than a twentieth of the time."""
    checkpoint_bytes: int = Field(default=256 * MEBIBYTE, gt=0)
    """A checkpoint follows after this growth of the log."""
    processes: list[str] = []
    """Modules or .py files with user-written processes, loaded at the start."""
    body_limit: int = Field(default=8 * MEBIBYTE, gt=0)
    """A larger request body is refused with 413."""
    bodies_limit: int = Field(default=64 * MEBIBYTE, gt=0)
    """All bodies under way; beyond it requests get 429 and Retry-After."""
    batch_samples: int = Field(default=1_000_000, gt=0)
    """A batch of more samples is refused with 400."""
    text_limit: int = Field(default=64 * 1024, gt=0)
    """The bytes of one text in a batch; a batch with a longer one is refused with 400."""
    live_timeout: float = Field(default=60.0, gt=0)
    """A live body of which nothing arrives for so long ends with 408."""
    tokens: SecretStr = SecretStr("")
    """Tokens: lines as in service/admission/tokens with ``;`` between."""
    tokens_file: Path | None = None
    """The file of tokens, a line a token."""
    trusted_hosts: str = ""
    """Further hosts of this service in a Host header, with commas between; ``*`` trusts all."""
    trusted_origins: str = ""
    """Origins of other pages that may use this service, with commas between."""
    body_timeout: float = Field(default=30.0, gt=0)
    """A body that has not arrived after so long is refused with 408 (live bodies: live_timeout)."""
    body_rate: int = Field(default=500, ge=0)
    """A body that arrives at fewer bytes a second is refused with 408; 0: any rate."""
    answer_timeout: float = Field(default=30.0, gt=0)
    """A client that takes nothing of its answer for so long loses its connection."""
    answer_rate: int = Field(default=2_000, ge=0)
    """A client that takes fewer bytes a second loses its connection; 0: any rate."""
    answers: int = Field(default=256, gt=0)
    """Long answers under way; beyond it further ones get 503 and Retry-After."""
    answers_limit: int = Field(default=256 * MEBIBYTE, gt=0)
    """Bytes of long answers under way; beyond it further ones get 503 and Retry-After."""
    head_timeout: float = Field(default=15.0, gt=0)
    """A connection without a complete head for so long is closed."""
    max_connections: int = Field(default=12_000, gt=0)
    """Further connections are refused with 503."""
    max_connections_per_client: int = Field(default=10_000, gt=0)
    """Connections of one address; further ones are refused with 503."""
    max_streams: int = Field(default=10_000, gt=0)
    """Streams; while there are so many, a request that would create one gets 403."""
    max_templates: int = Field(default=1_000, gt=0)
    """Event templates, likewise."""
    max_requests: int = Field(default=100_000, gt=0)
    """Event requests, subscriptions and registered queries together, likewise."""
    max_declarations: int = Field(default=10_000, gt=0)
    """Declarations in KPL, likewise."""
    max_transformations: int = Field(default=1_000, gt=0)
    """Transformations, likewise, including those of the program."""
    max_ontologies: int = Field(default=100, gt=0)
    """Ontologies, likewise."""
    tick: float = Field(default=0.1, gt=0)
    """The time between two ticks of the engine."""
    retention_samples: int = Field(default=100_000, gt=0, le=100_000_000)
    """Samples of history that a stream keeps, unless its declaration sets a number."""
    retention_bytes: int = Field(default=256 * MEBIBYTE, gt=0, lt=2**63)
    """Bytes of history, unless the declaration sets a number of bytes or samples."""
    history_limit: int = Field(default=10_000, gt=0)
    """Samples of one history answer, unless the request sets a number."""
    sse_cache: int = Field(default=64 * MEBIBYTE, gt=0)
    """Encoded messages of event streams that are kept for all clients together."""
    sse_clients: int = Field(default=10_000, gt=0)
    """Clients of event streams; beyond it further ones get 503 and Retry-After."""
    sse_clients_each: int = Field(default=8_000, gt=0)
    """Clients of event streams with one token, or address; beyond it further ones get 429. Fewer
    than all, so that no client takes every place. Behind a proxy all have one address."""
    sse_ping: float = Field(default=15.0, ge=0)
    """The time between two comments to idle clients of event streams; 0 sends none."""
    sse_send_timeout: float = Field(default=30.0, gt=0)
    """A client of an event stream that takes nothing for so long is cut off; it may resume."""
    sparql_deadline: float = Field(default=10.0, gt=0)
    """A SPARQL query that takes longer gets 503."""
    sparql_workers: int = Field(default_factory=_workers, gt=0)
    """Worker processes, each of which evaluates one SPARQL query at a time. One sender has all of
    several but one at most."""
    sparql_waiting: int = Field(default=32, ge=0)
    """SPARQL queries that wait for a worker; beyond it queries get 503 and Retry-After."""
    sparql_rows: int = Field(default=100_000, gt=0)
    """A result of more rows or triples is refused with 422."""
    sparql_bytes: int = Field(default=64 * MEBIBYTE, gt=0)
    """A result of more bytes is refused with 422."""
    query_rows: int = Field(default=2_000_000, gt=0)
    """Rows that one operator of a continuous query may produce for one window."""
    query_results: int = Field(default=100_000, gt=0)
    """Solutions that a continuous query may have for one window."""
    query_deadline: float = Field(default=1.0, gt=0)
    """Seconds that Oxigraph may take for one question, when columns cannot evaluate a window."""
    query_seconds: float = Field(default=5.0, gt=0)
    """Seconds of processor time that one window of a continuous query may take."""
    query_behind: float = Field(default=60.0, gt=0)
    """A query whose windows take so many seconds without catching up fails."""
    ontology_deadline: float = Field(default=20.0, gt=0)
    """Seconds to read an ontology, and as many for the closure of all ontologies."""
    ontology_triples: int = Field(default=100_000, gt=0)
    """Triples of all ontologies, and of what they entail."""
    memory_limit: int | None = Field(default=None, ge=0)
    """While the service takes this much, requests that need more get 503 and Retry-After; 0: none.
    None: half of the memory of the machine or container (service/admission/memory_limit)."""
    worker_memory: int = Field(default=512 * MEBIBYTE, ge=16 * MEBIBYTE)
    """Memory that one worker process may take beside its program."""
    metrics_streams: int = Field(default=1_000, ge=0)
    """Streams, and units, with lines of their own in /metrics; all others have common ones."""
    slow_request: float = Field(default=1.0, gt=0)
    """A request that takes longer is a warning in the log."""
    drain: float = Field(default=0.0, ge=0)
    """When the service stops, it goes on for so long, and reports that it is not ready."""
    log_level: str = Field(default="info", pattern="^(debug|info|warning|error)$")
    log_json: bool = False
    """A JSON object a log line, instead of text."""

    @property
    def batch_limits(self) -> BatchLimits:
        """The limits of a batch. Decompressed, Arrow may have eight times the bytes of a body. A
        line may contain some of the longest texts."""
        line = max(MEBIBYTE, 16 * self.text_limit)
        return BatchLimits(self.batch_samples, self.text_limit, 8 * self.body_limit, line)

    @property
    def live_batch_limits(self) -> BatchLimits:
        """The limits of live samples, whose Arrow batches are decoded as a whole."""
        return replace(self.batch_limits, decoded=self.body_limit)
