"""Rewrites the trees of the languages, whose nodes are frozen dataclasses."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from .errors import Span


def rewritten(node: Any, change: Callable[[Any], Any]) -> Any:
    """A tree with other nodes for those that ``change`` replaces."""
    if isinstance(node, tuple):
        return tuple(rewritten(each, change) for each in node)
    if isinstance(node, Span) or not dataclasses.is_dataclass(node):
        return node
    if (changed := change(node)) is not node:
        return changed
    fields = {f.name: getattr(node, f.name) for f in dataclasses.fields(node)}
    new = {name: rewritten(old, change) for name, old in fields.items()}
    return replace(node, **new)
