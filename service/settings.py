"""Settings of the service: environment variables with the prefix ``DYKNOW_``."""

from __future__ import annotations

import os
from pathlib import Path

from pydantic import Field
from pydantic_settings import BaseSettings, SettingsConfigDict

MEBIBYTE = 1 << 20


def _workers() -> int:
    return max(2, min(4, os.cpu_count() or 1))


class Settings(BaseSettings):
    """What can be set; docs/api.md explains each. Sizes are bytes, durations seconds."""

    model_config = SettingsConfigDict(env_prefix="DYKNOW_", extra="ignore")

    host: str = "127.0.0.1"
    port: int = Field(default=8000, ge=0, le=65535)
    data: Path | None = None
    """Where ontology, templates and annotations are kept; None keeps them in memory."""
    processes: list[str] = []
    """Modules or .py files with user-written processes, loaded at the start."""
    body_limit: int = Field(default=8 * MEBIBYTE, gt=0)
    """A larger request body is refused with 413."""
    bodies_limit: int = Field(default=64 * MEBIBYTE, gt=0)
    """Bodies under way together; beyond it requests are refused with 429 and Retry-After."""
    live_timeout: float = Field(default=60.0, gt=0)
    """A sender of live samples from whom nothing comes for so long is let go, with 408."""
    tick: float = Field(default=0.1, gt=0)
    """How often the engine is told the time."""
    retention_samples: int = Field(default=100_000, gt=0)
    """How many samples of history a stream keeps when its declaration does not say."""
    history_limit: int = Field(default=10_000, gt=0)
    """How many samples one history answer holds when the request does not say."""
    sse_cache: int = Field(default=64 * MEBIBYTE, gt=0)
    """Encoded messages kept for all clients together."""
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
    query_rows: int = Field(default=5_000_000, gt=0)
    """Rows that one operator of a continuous query may make of one window."""
    query_results: int = Field(default=100_000, gt=0)
    """Solutions that a continuous query may have of one window."""
    query_deadline: float = Field(default=1.0, gt=0)
    """Seconds that Oxigraph may take for one window, where columns cannot evaluate it."""
    ontology_deadline: float = Field(default=20.0, gt=0)
    """Seconds for reading an ontology, and as many for what all of them entail."""
    ontology_triples: int = Field(default=100_000, gt=0)
    """Triples that the ontologies may have together, and as many that they may entail."""
    worker_memory: int = Field(default=512 * MEBIBYTE, ge=16 * MEBIBYTE)
    """What one worker process may take beside its program."""
    log_level: str = Field(default="info", pattern="^(debug|info|warning|error)$")
    log_json: bool = False
    """One JSON object a log line instead of text for people."""
