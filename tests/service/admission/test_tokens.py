"""Tokens: what a file of them may say, who may read it, what the command makes of it."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from pydantic import SecretStr
from typer.testing import CliRunner

from dyknow.engine.engine import Engine
from dyknow.service.admission.tokens import (
    Scope,
    Tokens,
    TokensError,
    digest_of,
    is_loopback,
    new_token,
    read_tokens,
)
from dyknow.service.app import create_app
from dyknow.service.cli import app
from dyknow.service.config.settings import Settings

SECRET = "a-token-that-is-long-enough"
ALL = frozenset(Scope)


def test_a_line_gives_name_scopes_and_token() -> None:
    text = f"""# who may do what
    publish  gateway {SECRET}  # on the roof

    read,publish dash sha256:{digest_of(b"other").hex()}
    """
    found = read_tokens(text, "f")
    gateway, dash = found[digest_of(SECRET.encode())], found[digest_of(b"other")]
    assert (gateway.name, gateway.scopes) == ("gateway", {Scope.PUBLISH})
    assert (dash.name, dash.scopes) == ("dash", {Scope.READ, Scope.PUBLISH})


def test_admin_includes_the_others_and_publish_does_not_read() -> None:
    (admin,) = read_tokens(f"admin a {SECRET}", "f").values()
    assert admin.scopes == ALL
    (publish,) = read_tokens(f"publish p {SECRET}", "f").values()
    assert not publish.may(Scope.READ)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (f"wirte x {SECRET}", "scopes are read, publish, admin"),
        (f"read,,admin x {SECRET}", "scopes are"),
        (f"read {SECRET}", "it has 2 parts"),
        (f"read x {SECRET} y", "it has 4 parts"),
        ("read x short", "can be guessed"),
        (f"read x {SECRET}ö", "a token has letters"),
        ("read x sha256:12", "64 hexadecimal digits"),
        (f"read x\x01y {SECRET}", "a name has letters"),
        (f"read two {SECRET[::-1]}\nread x {SECRET[::-1]}", "there already"),
    ],
)
def test_a_bad_line_is_told_by_its_number_and_not_by_its_secret(line: str, words: str) -> None:
    text = f"# first\nread one {SECRET}1\n{line}"
    with pytest.raises(TokensError) as caught:
        read_tokens(text, "tokens.txt")
    assert "tokens.txt, line " in caught.value.message
    assert words in caught.value.message
    assert caught.value.message.startswith(f"tokens.txt, line {text.count(chr(10)) + 1}")
    assert caught.value.hint
    assert SECRET not in f"{caught.value}{caught.value.hint}"
    assert "short" not in caught.value.message


@pytest.mark.parametrize("text", ["", "# nobody\n", " \n;"])
def test_no_tokens_at_all_is_a_mistake_where_a_file_was_named(text: str) -> None:
    with pytest.raises(TokensError, match="has no tokens"):
        read_tokens(text.replace(";", "\n"), "f")


def test_tokens_of_file_and_environment_hold_together(tmp_path: Path) -> None:
    path = tmp_path / "tokens"
    path.write_text(f"\ufeffread one {SECRET}1\r\n")
    path.chmod(0o640)
    settings = Settings(
        tokens_file=path, tokens=SecretStr(f"publish two {SECRET}2;admin three {SECRET}3")
    )
    tokens = Tokens.of(settings)
    named = [tokens.caller(f"{SECRET}{i}".encode()) for i in range(1, 5)]
    assert [None if one is None else one.name for one in named] == ["one", "two", "three", None]
    # `dyknow serve` logs its settings.
    assert SECRET not in f"{settings!r} {settings.model_dump_json()}"
    with pytest.raises(TokensError, match=r"DYKNOW_TOKENS, line 2: .* there already"):
        Tokens.of(
            Settings(tokens_file=path, tokens=SecretStr(f"read x {SECRET}9;read y {SECRET}1"))
        )


@pytest.mark.skipif(os.name != "posix", reason="Windows has no such modes")
@pytest.mark.parametrize("mode", [0o644, 0o604, 0o602, 0o620, 0o601])
def test_a_file_that_others_may_read_or_change_is_refused(tmp_path: Path, mode: int) -> None:
    path = tmp_path / "tokens"
    path.write_text(f"read one {SECRET}")
    path.chmod(mode)
    with pytest.raises(TokensError) as caught:
        Tokens.of(Settings(tokens_file=path))
    assert caught.value.hint == f"chmod 600 {path}"


def test_a_file_that_is_none_is_told(tmp_path: Path) -> None:
    with pytest.raises(TokensError, match="cannot be read"):
        Tokens.of(Settings(tokens_file=tmp_path / "nowhere"))
    path = tmp_path / "tokens"
    path.write_bytes(b"read x \xff")
    path.chmod(0o600)
    with pytest.raises(TokensError, match="no UTF-8 at byte 7"):
        Tokens.of(Settings(tokens_file=path))
    path.write_bytes(b"#" * (1 << 21))
    with pytest.raises(TokensError, match="more than"):
        Tokens.of(Settings(tokens_file=path))


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "", "192.168.1.5", "example.org", "0", "127.1"])
def test_without_tokens_only_this_machine_is_listened_to(host: str) -> None:
    assert not is_loopback(host)
    with pytest.raises(TokensError) as caught:
        create_app(Engine(epoch="e1"), Settings(host=host), lambda: 0)
    assert "dyknow token" in caught.value.hint
    settings = Settings(host=host, tokens=SecretStr(f"read x {SECRET}"))
    assert create_app(Engine(epoch="e1"), settings, lambda: 0)


@pytest.mark.parametrize("host", ["127.0.0.1", "127.0.0.2", "::1", "localhost", "LocalHost"])
def test_on_this_machine_none_are_needed(host: str) -> None:
    assert is_loopback(host)
    assert not Tokens.of(Settings(host=host)).required


def test_tokens_that_are_made_cannot_be_guessed() -> None:
    made = {new_token() for _ in range(100)}
    assert len(made) == 100
    assert all(len(token) >= 43 and token.startswith("dyk_") for token in made)


def test_the_command_makes_a_token_and_its_line(tmp_path: Path) -> None:
    path = tmp_path / "tokens.txt"
    path.write_text("# mine")  # without a line feed at its end
    path.chmod(0o600)
    runner = CliRunner()
    made = {}
    for name, scopes in (("me", ["admin"]), ("gw", ["read", "publish"]), ("dash", [])):
        options = [f"--scope={scope}" for scope in scopes]
        result = runner.invoke(app, ["token", name, *options, "--add", str(path)])
        assert result.exit_code == 0, result.output
        made[name] = result.stdout.strip()
    assert all(token not in path.read_text() for token in made.values())
    tokens = Tokens.of(Settings(tokens_file=path))
    found = {name: tokens.caller(token.encode()) for name, token in made.items()}
    scopes_of = {name: caller and caller.scopes for name, caller in found.items()}
    assert scopes_of == {
        "me": ALL,
        "gw": {Scope.READ, Scope.PUBLISH},
        "dash": {Scope.READ},
    }


def test_a_file_that_the_command_makes_is_its_owners(tmp_path: Path) -> None:
    path = tmp_path / "new.txt"
    assert CliRunner().invoke(app, ["token", "me", "--add", str(path)]).exit_code == 0
    assert path.stat().st_mode & 0o777 == 0o600
    nowhere = tmp_path / "no" / "where"
    result = CliRunner().invoke(app, ["token", "me", "--add", str(nowhere)])
    assert result.exit_code == 1
    assert "cannot be written" in result.stderr


def test_the_command_tells_programs_in_json() -> None:
    result = CliRunner().invoke(app, ["token", "me", "--scope", "publish", "--json"])
    told = json.loads(result.stdout)
    assert read_tokens(told["line"], "f") == read_tokens(f"publish me {told['token']}", "f")
    assert CliRunner().invoke(app, ["token", "not a name"]).exit_code == 1


@pytest.mark.parametrize("options", [["--host", "0.0.0.0"], ["--tokens", "nowhere"]])
def test_serve_refuses_before_it_listens(options: list[str]) -> None:
    result = CliRunner().invoke(app, ["serve", "--port", "0", *options])
    assert result.exit_code == 1
    assert "hint:" in result.stderr
    assert "token" in result.stderr


def test_tokens_of_this_process_are_accepted() -> None:
    tokens = Tokens(read_tokens(f"read one {SECRET}", "f").items())
    token = tokens.issue("flights", Scope.ADMIN)
    caller = tokens.caller(token.encode())
    assert caller is not None
    assert caller.scopes == ALL
