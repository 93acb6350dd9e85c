"""Clients of server-sent events that do what the standard lets them do, over bare sockets: read,
read nothing, close after any byte and resume."""

from __future__ import annotations

import re
import selectors
import socket
import time
from dataclasses import dataclass, field

MESSAGE = re.compile(rb"(?:id: ([^\n]+)\n)?event: (\w+)\ndata: ([^\n]*)\n\n")
PATIENCE = 30.0


def connect(
    url: str, path: str, after: str = "", receive: int | None = None, accept: str = "*/*"
) -> socket.socket:
    """A connection that has asked for ``path``; with ``receive`` bytes of room for the answer."""
    host, _, port = url.removeprefix("http://").rpartition(":")
    connection = socket.socket()
    if receive is not None:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive)
    connection.settimeout(PATIENCE)
    connection.connect((host, int(port)))
    wanted = f"Accept: {accept}\r\n" + (f"Last-Event-ID: {after}\r\n" if after else "")
    connection.sendall(f"GET {path} HTTP/1.1\r\nHost: {host}:{port}\r\n{wanted}\r\n".encode())
    return connection


def head(connection: socket.socket) -> tuple[int, dict[str, str], bytes]:
    """Status and headers of the answer, and what of its body came with them."""
    data = b""
    while b"\r\n\r\n" not in data:
        more = connection.recv(4096)
        if not more:
            raise ConnectionError("no answer")
        data += more
    first, _, rest = data.partition(b"\r\n\r\n")
    lines = first.decode().split("\r\n")
    headers = dict(line.lower().split(": ", 1) for line in lines[1:])
    return int(lines[0].split()[1]), headers, rest


def chunks(data: bytes) -> tuple[bytes, bytes]:
    """The bodies of the chunks that are whole, and the rest."""
    bodies = b""
    while (end := data.find(b"\r\n")) >= 0:
        size = int(data[:end], 16)
        if len(data) < end + 2 + size + 2:
            break
        bodies += data[end + 2 : end + 2 + size]
        data = data[end + 2 + size + 2 :]
    return bodies, data


@dataclass
class Reader:
    """Reads one path; closes after each of ``cuts`` bytes of answers and resumes after the last
    message that it had whole."""

    url: str
    path: str
    cuts: list[int] = field(default_factory=list)
    samples: list[bytes] = field(default_factory=list)
    """The ids of samples, in the order in which they came."""
    others: list[tuple[str, bytes]] = field(default_factory=list)
    """Kind and data of other messages."""
    connection: socket.socket = field(init=False)
    ended: bool = False

    def __post_init__(self) -> None:
        self._open()

    def receive(self) -> None:
        """What is there now."""
        data = self.connection.recv(1 << 16)
        if not data:
            self.ended = True
            self.connection.close()
            return
        if self._budget is not None:
            data = data[: self._budget]
            self._budget -= len(data)
        self._raw += data
        if self._in_head:
            first, found, rest = self._raw.partition(b"\r\n\r\n")
            if found:
                assert b" 200 " in first.split(b"\r\n")[0], first
                position = re.search(rb"(?i)dyknow-position: (.*)", first)
                assert position is not None
                self.after = self.after or position[1].decode().strip()
                self._raw, self._in_head = rest, False
        if not self._in_head:
            bodies, self._raw = chunks(self._raw)
            self._take(bodies)
        if self._budget == 0:
            self.connection.close()
            self._open()

    def _open(self) -> None:
        self._raw = self._text = b""
        self._in_head = True
        self._budget = self.cuts.pop() if self.cuts else None
        self.after: str = getattr(self, "after", "")
        self.connection = connect(self.url, self.path, self.after)

    def _take(self, data: bytes) -> None:
        self._text += data
        end = 0
        for found in MESSAGE.finditer(self._text):
            if found[2] == b"sample":
                self.samples.append(found[1])
                self.after = found[1].decode()
            else:
                self.others.append((found[2].decode(), found[3]))
            end = found.end()
        self._text = self._text[end:]


def read_all(readers: list[Reader], patience: float = PATIENCE) -> None:
    """Read until the answers of all have ended."""
    limit = time.monotonic() + patience
    with selectors.DefaultSelector() as selector:
        while running := [reader for reader in readers if not reader.ended]:
            assert time.monotonic() < limit, f"{len(running)} have not ended"
            for reader in running:
                selector.register(reader.connection, selectors.EVENT_READ, reader)
            ready = selector.select(1)
            for reader in running:
                selector.unregister(reader.connection)
            for key, _ in ready:
                key.data.receive()
