"""axe-core on a page of the console."""

from __future__ import annotations

from importlib.resources import files

from chromium import Page

_AXE = files("axe_core_python").joinpath("axe.min.js").read_text()
_FOUND = """axe.run().then(({violations}) => violations.flatMap(({id, nodes}) =>
  nodes.map((node) => id + ': ' + node.html.slice(0, 200) + ' ' + node.failureSummary)))"""


def violations(page: Page) -> list[str]:
    """What axe-core finds wrong with the page, each with its rule first."""
    page.run(_AXE)
    found: list[str] = page.run(_FOUND)
    return found
