"""Random requests by the OpenAPI schema: whatever comes, the service does not fail."""

from __future__ import annotations

import os
from copy import deepcopy
from typing import Any

import schemathesis
from hypothesis import HealthCheck, settings
from schemathesis.checks import not_a_server_error, status_code_conformance
from waiting import PATIENCE

from dyknow.engine.engine import Engine
from dyknow.service.app import create_app
from dyknow.service.config.settings import Settings


@schemathesis.serializer(
    "application/x-ndjson",
    "application/sparql-query",
    "text/turtle",
    "application/rdf+xml",
    "application/ld+json",
    "application/n-triples",
    "application/n-quads",
    "application/trig",
)
def plain_text(ctx: schemathesis.SerializationContext, value: Any) -> bytes:
    return value if isinstance(value, bytes) else str(value).encode(errors="replace")


@schemathesis.serializer("application/vnd.apache.arrow.stream")
def raw_bytes(ctx: schemathesis.SerializationContext, value: Any) -> bytes:
    return value if isinstance(value, bytes) else bytes(str(value), "utf-8", "replace")


app = create_app(Engine(epoch="e1"), Settings(body_limit=1 << 16), lambda: 10**18)
# Event streams have no end of their own; tests/service/sse/test_sse.py is about them.
# Not `from_asgi`: it gives up after ten seconds, which a busy machine needs.
document = schemathesis.openapi.from_dict(deepcopy(app.openapi()))
document.app, document.location = app, "/openapi.json"
# Every bound of every parameter takes a minute, some of it in each worker before the first test:
# `make soak` has that.
document.config.phases.coverage.enabled = "DYKNOW_BOUNDS" in os.environ
schema = document.exclude(path_regex="/events$")


@schema.parametrize()
@settings(
    max_examples=20,
    deadline=None,
    derandomize=True,
    suppress_health_check=list(HealthCheck),
)
def test_no_request_makes_the_service_fail(case: schemathesis.Case) -> None:
    checks = [not_a_server_error, status_code_conformance]
    case.call_and_validate(checks=checks, timeout=PATIENCE)
