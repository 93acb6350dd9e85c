"""Requests that come slowly, or never wholly: for bombs.py."""

from __future__ import annotations

import socket
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress

NDJSON = "application/x-ndjson"
SECONDS = 2


def slow_bodies(address: str) -> list[tuple[str, Callable[[], Counter[str]]]]:
    """Bodies of which little comes, or nearly all."""
    host, _, port = address.rpartition(":")

    def opened(path: str, length: str, body: bytes) -> socket.socket:
        connection = socket.create_connection((host, int(port)), 10)
        connection.sendall(
            f"POST {path} HTTP/1.1\r\nHost: {address}\r\nContent-Type: {NDJSON}\r\n"
            f"{length}\r\n\r\n".encode()
        )
        with suppress(OSError):
            connection.sendall(body)
        return connection

    def many(
        count: int, path: str, length: str, body: bytes, drop: bytes
    ) -> Callable[[], Counter[str]]:
        def thrown() -> Counter[str]:
            connections = [opened(path, length, body) for _ in range(count)]
            until = time.monotonic() + SECONDS
            while time.monotonic() < until:
                for connection in connections:
                    with suppress(OSError):
                        connection.send(drop)
                time.sleep(0.1)
            for connection in connections:
                connection.close()
            return Counter({"left": count})

        return thrown

    samples = "/streams/quiet/samples"
    size = "Content-Length: 8000000"
    return [
        ("bodies", many(300, samples, size, b'{"valid":', b" ")),
        (
            "live bodies",
            many(300, f"{samples}/live", "Transfer-Encoding: chunked", b"", b"1\r\n \r\n"),
        ),
        ("nearly whole bodies", many(8, samples, size, b"{" + b" " * 7_999_000, b" ")),
        ("heads", many(300, "/healthz", "X: a", b"", b"X: a\r\n")),
    ]
