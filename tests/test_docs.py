"""The pages: linked, with links that lead somewhere, and blocks and commands that are right.

tests/service/test_pages.py runs the commands of the tutorial and the how-to pages.
"""

from __future__ import annotations

import configparser
import json
import re
import tomllib
from functools import lru_cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml
from pages import anchors, blocks, commands, headings, links, pages, prose
from places import ROOT
from pyoxigraph import RdfFormat, parse

from dyknow.engine.engine import Engine
from dyknow.languages.chronicle import is_chronicle
from dyknow.languages.kpl import parse_kpl
from dyknow.languages.mtl import (
    is_formula_template,
    parse_formula_template,
    parse_monitor,
)
from dyknow.languages.sase import is_sase
from dyknow.languages.ssl import parse_ssl
from dyknow.service.app import create_app
from dyknow.service.cli.main import COMMANDS, command
from dyknow.service.config.settings import Settings

DOCS = ROOT / "docs"
INDEX = DOCS / "README.md"
PAGES = pages()
PREFIXES = """@prefix : <http://www.dyknow.eu/ontology#> .
@prefix dyknow: <http://www.ida.liu.se/dyknow/> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
@prefix xsd: <http://www.w3.org/2001/XMLSchema#> .
"""
UNCHECKED = frozenset({"text", "console", "sh", "sparql", "csv", "http"})
"""Languages whose blocks other tests run or compare, or that are output."""
NOT_THERE = {"service/console", "docker/tokens.txt"}
"""What is to come, and what a user makes."""
MENTION = re.compile(r"(?<![\w/.])docs/[\w./#-]*\w(?:, \"([^\"\n]+)\")?")
MENTIONING = ("*.py", "*.md", "*.toml", "*.yaml", "*.ttl", "*.lark", "Makefile", "Dockerfile")


def by_name(page: Path) -> str:
    return str(page.relative_to(ROOT))


@pytest.mark.parametrize("page", PAGES, ids=by_name)
def test_links_lead_somewhere(page: Path) -> None:
    for link in links(page):
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


def test_every_page_is_in_the_index() -> None:
    """And none is twice: the index is the one list of all pages."""
    linked = [(DOCS / link).resolve() for link in links(INDEX)]
    assert sorted(linked) == sorted(page for page in DOCS.rglob("*.md") if page != INDEX)


def test_the_readme_leads_to_the_index() -> None:
    assert "docs/README.md" in links(ROOT / "README.md")


def test_every_page_is_of_one_kind() -> None:
    kinds = {page.relative_to(DOCS).parts[0] for page in DOCS.rglob("*.md")}
    both = {"README.md", "comparison.md"}
    assert kinds == {*both, "tutorial", "how-to", "reference", "explanation"}


def mentions() -> list[tuple[str, str, str]]:
    """Each place that names a file of docs/: the file that does, the name, a heading of it."""
    return [
        (by_name(path), match[0].partition(", ")[0], match[1] or "")
        for room in ROOT.iterdir()
        if room.name[0] != "." and room.name != "build"
        for pattern in MENTIONING
        for path in (room.rglob(pattern) if room.is_dir() else [room] * room.match(pattern))
        if path != Path(__file__)
        for match in MENTION.finditer(path.read_text())
    ]


def test_mentioned_pages_exist() -> None:
    """In docstrings, messages and comments, too: `docs/x/y.md`, with a heading or an anchor."""
    wrong, mentioned = [], mentions()
    for place, name, heading in mentioned:
        path, _, anchor = name.partition("#")
        found = [ROOT / path] if (ROOT / path).exists() else list(ROOT.glob(path + "-*"))
        if not found or (heading and heading not in headings(found[0])):
            wrong.append((place, name, heading))
        elif anchor and anchor not in anchors(found[0]):
            wrong.append((place, name, anchor))
    assert wrong == []
    assert len(mentioned) > 100


@pytest.mark.parametrize("page", PAGES, ids=by_name)
def test_named_files_exist(page: Path) -> None:
    """Files of the checkout that a page names in code marks."""
    rooms = "|".join(path.name for path in ROOT.iterdir() if path.is_dir() and path.name[0] != ".")
    named = set(re.findall(rf"`((?:{rooms})/[\w./*-]*\w)", prose(page))) - NOT_THERE
    for name in named:
        assert list(ROOT.glob(name)) or list(ROOT.glob(name + ".*")), name


def test_each_figure_names_the_command_that_prints_it() -> None:
    page = (DOCS / "explanation" / "performance.md").read_text()
    table = re.findall(r"^\| (.*) \| `(bench/[\w/]+\.py)[^`]*` \|$", page, re.MULTILINE)
    assert len(table) == len(re.findall(r" 20\d\d-\d\d-\d\d, ", page)) > 40
    assert all((ROOT / script).exists() for _, script in table)


@pytest.mark.parametrize("page", PAGES, ids=by_name)
def test_blocks_are_of_their_language(page: Path) -> None:
    assert len(re.findall(r"^```", page.read_text(), re.MULTILINE)) == 2 * len(blocks(page))
    for block in blocks(page):
        match block.language:
            case "python":
                compile(block.text, str(page), "exec")
            case "json":
                json.loads(block.text)
            case "turtle":
                text = PREFIXES + block.text.replace("^^string", "^^xsd:string")
                list(parse(text, format=RdfFormat.TURTLE, base_iri="http://example.org/"))
            case "trig":
                list(parse(block.text, format=RdfFormat.TRIG))
            case "xml":
                ElementTree.fromstring(block.text)
            case "yaml":
                yaml.safe_load(block.text)
            case "toml":
                tomllib.loads(block.text)
            case "ini":
                configparser.ConfigParser(interpolation=None).read_string(block.text)
            case "kpl":
                parse_kpl(block.text)
            case "ssl":
                parse_ssl(block.text)
            case "chronicle":
                # Refused texts are compared by tests/languages/chronicle/test_chronicles_page.py.
                assert is_chronicle(block.text)
            case "sase":
                # Refused texts are compared by tests/languages/test_sase_page.py.
                assert is_sase(block.text)
            case "mtl":
                # Refused texts are compared by tests/languages/test_formulas_page.py.
                if is_formula_template(block.text):
                    parse_formula_template(block.text)
                else:
                    assert block.file == "refused" or parse_monitor(block.text)
            case other:
                assert other in UNCHECKED, other


@lru_cache
def routes() -> list[tuple[str, re.Pattern[str]]]:
    """The routes of the service: a method and the paths that it answers."""
    paths = create_app(Engine(epoch="e1"), Settings(), lambda: 0).openapi()["paths"]
    return [
        (method.upper(), re.compile(re.sub(r"\\{\w+\\}", "[^/?]+", re.escape(path)) + "$"))
        for path, methods in paths.items()
        for method in methods
    ]


@pytest.mark.parametrize("page", PAGES, ids=by_name)
def test_commands_are_known(page: Path) -> None:
    """Commands of `dyknow` have these options, `make` these targets, the service these routes."""
    for words in commands(page):
        while words and re.match(r"\w+=", words[0]):
            words = words[1:]
        match words:
            case ["dyknow", *rest]:
                check_command(rest)
            case ["make", target, *_]:
                assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(), re.MULTILINE)
            case ["python" | ".venv/bin/python", file, *_]:
                assert (ROOT / file).exists() or file in {block.file for block in blocks(page)}
            case ["curl", *rest]:
                check_request(rest)


def check_command(words: list[str]) -> None:
    name, *rest = words
    assert name in COMMANDS, name
    found: Any = command(name)
    if hasattr(found, "commands"):
        found, rest = found.commands[rest[0]], rest[1:]
    context = found.context_class(found, info_name=name)
    parameters, left, _ = found.make_parser(context).parse_args(args=rest)
    assert not left, words
    needed = [one for one in found.params if one.required and one.param_type_name == "argument"]
    assert all(parameters.get(one.name) is not None for one in needed), words


def check_request(words: list[str]) -> None:
    body = {"-d", "--data-binary", "-T"} & set(words) and "-G" not in words
    method = words[words.index("-X") + 1] if "-X" in words else "POST" if body else "GET"
    (url,) = (word for word in words if word.startswith(("$URL", "http://")))
    path = re.sub(r"^\$URL|^http://[^/]+", "", url).partition("?")[0]
    if not path.startswith("$"):
        assert any(method == known and each.match(path) for known, each in routes()), (method, path)


def test_the_checks_see_something() -> None:
    found = [words[0] for page in PAGES for words in commands(page) if words]
    assert found.count("dyknow") > 60
    assert found.count("curl") > 60
    assert sum(len(links(page)) for page in PAGES) > 200
    assert sum(len(blocks(page)) for page in PAGES) > 150
