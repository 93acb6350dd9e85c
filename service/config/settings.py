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
    """The settings (docs/reference/settings.md). Sizes are bytes, durations seconds."""

    model_config = SettingsConfigDict(env_prefix="DYKNOW_", extra="ignore")

    host: str = "127.0.0.1"
    port: int = Field(default=8000, ge=0, le=65535)
    data: Path | None = None
    """Where ontology, templates and annotations are kept; None keeps them in memory."""
    durability: Durability = Durability.FSYNC
    """With ``data``: an acknowledged change survives a loss of power (fsync), or the end of the
    process (write)."""
    checkpoint_interval: float = Field(default=300.0, gt=0)
    """With ``data``: the state is written down this often, so that a start is quick."""
    checkpoint_work: float = Field(default=4.0, gt=0)
    """And after so many seconds of work, as a start does that work again: unless checkpoints would
    take more than a twentieth of the time."""
    checkpoint_bytes: int = Field(default=256 * MEBIBYTE, gt=0)
    """And whenever the log has grown by so much."""
    processes: list[str] = []
    """Modules or .py files with user-written processes, loaded at the start."""
    body_limit: int = Field(default=8 * MEBIBYTE, gt=0)
    """A larger request body is refused with 413."""
    bodies_limit: int = Field(default=64 * MEBIBYTE, gt=0)
    """Bodies under way together; beyond it requests are refused with 429 and Retry-After."""
    batch_samples: int = Field(default=1_000_000, gt=0)
    """A batch of more samples is refused with 400."""
    text_limit: int = Field(default=64 * 1024, gt=0)
    """So is one in which one text has more bytes."""
    live_timeout: float = Field(default=60.0, gt=0)
    """A sender of live samples from whom nothing comes for so long is let go, with 408."""
    tokens: SecretStr = SecretStr("")
    """Who may do what: lines of service/admission/tokens with ``;`` between."""
    tokens_file: Path | None = None
    """The same as a file, a line a token."""
    trusted_hosts: str = ""
    """Further names of this service in a Host header, with commas between; ``*`` trusts all."""
    trusted_origins: str = ""
    """Origins of pages elsewhere that may use this service, with commas between."""
    body_timeout: float = Field(default=30.0, gt=0)
    """A body that is not there after so long is refused with 408 (live bodies: live_timeout)."""
    body_rate: int = Field(default=500, ge=0)
    """So is one that comes more slowly than so many bytes a second; 0 asks for no rate."""
    answer_timeout: float = Field(default=30.0, gt=0)
    """A client that takes nothing of its answer for so long is let go."""
    answer_rate: int = Field(default=2_000, ge=0)
    """So is one that takes less than so many bytes a second; 0 asks for no rate."""
    answers: int = Field(default=256, gt=0)
    """Long answers under way; beyond it further ones are refused with 503 and Retry-After."""
    answers_limit: int = Field(default=256 * MEBIBYTE, gt=0)
    """Bytes of them; beyond it the same."""
    head_timeout: float = Field(default=15.0, gt=0)
    """A connection on which no request comes to be for so long is closed."""
    max_connections: int = Field(default=12_000, gt=0)
    """Further connections are refused with 503."""
    max_connections_per_client: int = Field(default=10_000, gt=0)
    """The same, of one address."""
    max_streams: int = Field(default=10_000, gt=0)
    """While there are so many streams, what makes further ones is refused with 403."""
    max_templates: int = Field(default=1_000, gt=0)
    """The same, of event templates."""
    max_requests: int = Field(default=100_000, gt=0)
    """The same, of event requests, subscriptions and registered queries together."""
    max_declarations: int = Field(default=10_000, gt=0)
    """The same, of declarations in KPL."""
    max_transformations: int = Field(default=1_000, gt=0)
    """The same, of transformations, those that come with the program among them."""
    max_ontologies: int = Field(default=100, gt=0)
    """The same, of ontologies."""
    tick: float = Field(default=0.1, gt=0)
    """How often the engine is told the time."""
    retention_samples: int = Field(default=100_000, gt=0, le=100_000_000)
    """How many samples of history a stream keeps when its declaration does not say."""
    retention_bytes: int = Field(default=256 * MEBIBYTE, gt=0, lt=2**63)
    """And how many bytes, when it says neither this nor how many samples."""
    history_limit: int = Field(default=10_000, gt=0)
    """How many samples one history answer holds when the request does not say."""
    sse_cache: int = Field(default=64 * MEBIBYTE, gt=0)
    """Encoded messages kept for all clients together."""
    sse_clients: int = Field(default=10_000, gt=0)
    """Clients of event streams together; beyond it they are refused with 503 and Retry-After."""
    sse_clients_each: int = Field(default=8_000, gt=0)
    """Those of one address, or token, alone; beyond it with 429. Less than all together: nobody
    alone takes every place. Behind a proxy all have one address."""
    sse_ping: float = Field(default=15.0, ge=0)
    """A comment is sent to idle clients this often; 0 sends none."""
    sse_send_timeout: float = Field(default=30.0, gt=0)
    """A client that takes nothing for so long is let go; it may resume."""
    sparql_deadline: float = Field(default=10.0, gt=0)
    """A SPARQL query without an answer after this time is answered with 503."""
    sparql_workers: int = Field(default_factory=_workers, gt=0)
    """How many SPARQL queries are evaluated at once, each in a process of its own."""
    sparql_waiting: int = Field(default=32, ge=0)
    """How many more may wait; beyond it queries are answered with 503 and Retry-After."""
    sparql_rows: int = Field(default=100_000, gt=0)
    """A result of more rows or triples is refused with 422."""
    sparql_bytes: int = Field(default=64 * MEBIBYTE, gt=0)
    """A result of more bytes is refused with 422."""
    query_rows: int = Field(default=2_000_000, gt=0)
    """Rows that one operator of a continuous query may make of one window."""
    query_results: int = Field(default=100_000, gt=0)
    """Solutions that a continuous query may have of one window."""
    query_deadline: float = Field(default=1.0, gt=0)
    """Seconds that Oxigraph may take for one question, where columns cannot evaluate a window."""
    query_seconds: float = Field(default=5.0, gt=0)
    """Seconds of processor time that one window of a continuous query may take."""
    query_behind: float = Field(default=60.0, gt=0)
    """A query whose windows have taken so many without catching up is cut off."""
    ontology_deadline: float = Field(default=20.0, gt=0)
    """Seconds for reading an ontology, and as many for what all of them entail."""
    ontology_triples: int = Field(default=100_000, gt=0)
    """Triples that the ontologies may have together, and as many that they may entail."""
    memory_limit: int | None = Field(default=None, ge=0)
    """While the service takes so much, what would make it grow is refused with 503 and Retry-After;
    0 for no limit. None: half of what the machine or container has
    (service/admission/memory_limit)."""
    worker_memory: int = Field(default=512 * MEBIBYTE, ge=16 * MEBIBYTE)
    """What one worker process may take beside its program."""
    metrics_streams: int = Field(default=1_000, ge=0)
    """So many streams, and units, /metrics tells one by one; all others together."""
    slow_request: float = Field(default=1.0, gt=0)
    """A request that takes longer is a warning in the log."""
    drain: float = Field(default=0.0, ge=0)
    """When the service is told to stop, it goes on for so long, and says that it is not ready."""
    log_level: str = Field(default="info", pattern="^(debug|info|warning|error)$")
    log_json: bool = False
    """One JSON object a log line instead of text for people."""

    @property
    def batch_limits(self) -> BatchLimits:
        """What a batch may have; of Arrow eight times a body once it is decompressed. A line has
        room for some of the longest texts."""
        line = max(MEBIBYTE, 16 * self.text_limit)
        return BatchLimits(self.batch_samples, self.text_limit, 8 * self.body_limit, line)

    @property
    def live_batch_limits(self) -> BatchLimits:
        """The same of live samples, whose Arrow batches are decoded at once."""
        return replace(self.batch_limits, decoded=self.body_limit)
