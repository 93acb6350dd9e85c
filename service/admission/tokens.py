"""Bearer tokens (RFC 6750) with the scopes read, publish and admin (docs/reference/access.md).

A line a token, `<scope>[,<scope>] <name> <token or sha256:hex>`, in a file or the environment.
Memory keeps hashes only. service/admission/gate looks tokens up; `token_file` reads the file again
when it changes.
"""

from __future__ import annotations

import hashlib
import ipaddress
import os
import re
import secrets
import stat
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..config.settings import Settings

PREFIX = "dyk_"
"""The prefix of tokens of `new_token`, by which secret scanners find them."""
SHORTEST = 20
"""Characters of a token, at least: a client could guess a shorter one."""
LARGEST = 1 << 20
"""Bytes of a file of tokens, at most."""
FORM = "a line is: <scope>[,<scope>] <name> <token or sha256:hex>"

_TOKEN = re.compile(r"[A-Za-z0-9._~+/-]+=*")
_NAME = re.compile(r"[A-Za-z0-9._@-]{1,64}")
_HASHED = "sha256:"
_HASH = re.compile(r"[0-9a-fA-F]{64}")
_COMMENT = re.compile(r"(?:^|\s)#.*")


class Scope(StrEnum):
    """A permission; ``admin`` includes the others, ``publish`` does not include reading."""

    READ = "read"
    PUBLISH = "publish"
    ADMIN = "admin"


@dataclass(frozen=True, slots=True)
class Caller:
    """The owner of a token: its name, and its scopes with included ones. ``digest`` is the token's
    hash: two tokens may have one name."""

    name: str
    scopes: frozenset[Scope]
    digest: bytes = field(default=b"", repr=False)

    def may(self, scope: Scope) -> bool:
        """Whether the token allows ``scope``."""
        return scope in self.scopes


@dataclass(frozen=True, slots=True)
class Stamp:
    """The version of a file: inode, size, and the times (ns) of the last change of its content and
    of its status, such as its mode."""

    place: int
    size: int
    changed: int
    marked: int

    @classmethod
    def of(cls, status: os.stat_result) -> Stamp | None:
        """The stamp of a file; None for a pipe, which cannot be read again."""
        if not stat.S_ISREG(status.st_mode):
            return None
        return cls(status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns)


class TokensError(Exception):
    """Invalid or missing tokens: the error, and a hint."""

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint


class Tokens:
    """The valid tokens. Without any, the service accepts requests without a token."""

    def __init__(
        self, callers: Iterable[tuple[bytes, Caller]] = (), stamp: Stamp | None = None
    ) -> None:
        self._callers = dict(callers)
        self._issued: dict[bytes, Caller] = {}
        self.stamp = stamp
        """The stamp of their file; None without a file, or for a pipe."""

    def __len__(self) -> int:
        """The number of tokens."""
        return len(self._callers)

    @property
    def required(self) -> bool:
        """Whether requests need a token."""
        return bool(self._callers)

    def caller(self, token: bytes) -> Caller | None:
        """The caller with ``token``; None if it is unknown.

        Cost: a hash and a look-up, for any number of tokens. Its time reveals nothing of the
        token: it depends on the hash, and a client cannot choose the parts of a hash.
        """
        return self._callers.get(digest_of(token))

    def allows(self, caller: Caller | None, scope: Scope) -> bool:
        """Whether a request of ``caller`` may go on: its token is still valid, with ``scope``.
        ``caller`` is None if no token was required."""
        if caller is None:
            return True
        now = self.current(caller)
        return now is not None and now.may(scope)

    def current(self, caller: Caller) -> Caller | None:
        """The present name and scopes of the token of ``caller``; None if it was removed."""
        return self._callers.get(caller.digest)

    def replace(self, others: Tokens) -> None:
        """Replace the tokens by ``others``, except those that this process issued."""
        self._callers = others._callers | self._issued
        self.stamp = others.stamp

    def issue(self, name: str, *scopes: Scope) -> str:
        """Issue a token for a part of this process, valid until the process ends."""
        token = new_token()
        digest = digest_of(token.encode())
        self._issued[digest] = self._callers[digest] = Caller(name, including(scopes), digest)
        return token

    @classmethod
    def of(cls, settings: Settings) -> Tokens:
        """Read the tokens of the settings' file and text.

        Raises `TokensError` for invalid ones, and without any if the service listens on an address
        that other machines reach.
        """
        found: dict[bytes, Caller] = {}
        stamp = None
        if settings.tokens_file is not None:
            data, stamp = _text_of(settings.tokens_file)
            found |= read_tokens(data, str(settings.tokens_file), found)
        if text := settings.tokens.get_secret_value():
            found |= read_tokens(text.replace(";", "\n"), "DYKNOW_TOKENS", found)
        if not found and not is_loopback(settings.host):
            raise TokensError(
                f"{settings.host or 'every address'} can be reached from other machines, "
                "and there are no tokens",
                "make one: dyknow token me --scope admin --add tokens.txt; then: dyknow serve "
                f"--host {settings.host} --tokens tokens.txt (docs/reference/access.md)",
            )
        return cls(found.items(), stamp)


def new_token() -> str:
    """Make a token of 256 random bits."""
    return PREFIX + secrets.token_urlsafe(32)


def line_of(scopes: Iterable[Scope], name: str, token: str) -> str:
    """The line of a token in the file, with its hash, so that the file does not reveal it."""
    return f"{','.join(scopes)} {name} {_HASHED}{digest_of(token.encode()).hex()}"


def digest_of(token: bytes) -> bytes:
    """The hash of a token. One round of SHA-256 is enough for 256 random bits."""
    return hashlib.sha256(token).digest()


def including(scopes: Iterable[Scope]) -> frozenset[Scope]:
    """``scopes`` with the scopes that they include."""
    given = frozenset(scopes)
    return frozenset(Scope) if Scope.ADMIN in given else given


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches ``host``. Of names this is true of localhost only."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host.lower() == "localhost"


def is_name(text: str) -> bool:
    """Whether ``text`` may be the name of a token."""
    return _NAME.fullmatch(text) is not None


def read_tokens(text: str, origin: str, known: Iterable[bytes] = ()) -> dict[bytes, Caller]:
    """Read the tokens of a text, by their hash. ``origin`` names the text in errors.

    Raises `TokensError` with the number of the line, without its content, which may be a secret.
    """
    found: dict[bytes, Caller] = {}
    for number, line in _lines(text):
        place = f"{origin}, line {number}"
        parts = line.split()
        if len(parts) != 3:
            raise TokensError(f"{place}: it has {len(parts)} parts, not 3", FORM)
        digest = _digest(parts[2], place)
        if digest in found or digest in known:
            raise TokensError(f"{place}: this token is there already", "make another one")
        if not is_name(parts[1]):
            raise TokensError(f"{place}: a name has letters, digits and . _ @ -, at most 64", FORM)
        found[digest] = Caller(parts[1], including(_scopes(parts[0], place)), digest)
    if not found:
        raise TokensError(f"{origin} has no tokens", "make one: dyknow token --help")
    return found


def _lines(text: str) -> Iterator[tuple[int, str]]:
    for number, line in enumerate(text.removeprefix("\ufeff").split("\n"), 1):
        if stripped := _COMMENT.sub("", line).strip():
            yield number, stripped


def _scopes(text: str, place: str) -> list[Scope]:
    try:
        return [Scope(each) for each in text.split(",")]
    except ValueError:
        raise TokensError(f"{place}: scopes are {', '.join(Scope)}", FORM) from None


def _digest(text: str, place: str) -> bytes:
    if text.startswith(_HASHED):
        if not _HASH.fullmatch(text.removeprefix(_HASHED)):
            raise TokensError(f"{place}: sha256: is followed by 64 hexadecimal digits", FORM)
        return bytes.fromhex(text.removeprefix(_HASHED))
    if not _TOKEN.fullmatch(text):
        raise TokensError(f"{place}: a token has letters, digits and - . _ ~ + /", FORM)
    if len(text) < SHORTEST:
        raise TokensError(
            f"{place}: the token can be guessed, it has {len(text)} characters",
            f"one has at least {SHORTEST}; make one: dyknow token --help",
        )
    return digest_of(text.encode())


def _text_of(path: Path) -> tuple[str, Stamp | None]:
    """Read a file, and its stamp. Raises `TokensError` also if other users may read or change it,
    since it may contain tokens in plain text."""
    try:
        with path.open("rb") as file:
            status = os.fstat(file.fileno())
            mode = status.st_mode
            # Only its reader gets the content of a pipe, with any mode; Windows has no modes.
            if os.name == "posix" and stat.S_ISREG(mode) and mode & 0o037:
                raise TokensError(
                    f"{path} can be read or changed by others (mode {stat.S_IMODE(mode):04o})",
                    _made_ours(path, status.st_uid, status.st_gid),
                )
            data = file.read(LARGEST + 1)
    except PermissionError as error:
        raise TokensError(
            f"{path} cannot be read: {error.strerror}", _made_ours(path, None, None)
        ) from error
    except OSError as error:
        raise TokensError(
            f"{path} cannot be read: {error.strerror}", "say where it is with --tokens"
        ) from error
    if len(data) > LARGEST:
        raise TokensError(f"{path} is no file of tokens: it has more than {LARGEST} bytes", FORM)
    try:
        return data.decode(), Stamp.of(status)
    except UnicodeDecodeError as error:
        raise TokensError(f"{path} is no UTF-8 at byte {error.start}", FORM) from error


def _made_ours(path: Path, owner: int | None, group: int | None) -> str:
    """The command after which only the user of this process may read a file. In a container another
    user may own the file, and only the owner can change its mode."""
    if os.name != "posix" or owner == os.geteuid():
        return f"chmod 600 {path}"
    if group in (os.getegid(), *os.getgroups()):
        return f"chmod 640 {path}"
    return (
        f"the service runs as user {os.geteuid()}, group {os.getegid()}: let its group read the "
        f"file, chgrp {os.getegid()} {path}; chmod 640 {path} "
        "(docs/how-to/deploy.md#in-a-container)"
    )
