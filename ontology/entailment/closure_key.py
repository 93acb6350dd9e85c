"""What closures that are stored are known by."""

from __future__ import annotations

import hashlib
import importlib.metadata
from collections.abc import Mapping

_FORM = "3"
"""The version of the closures' form. A new value makes stored closures invalid."""


def closure_key(hashes: Mapping[str, str]) -> str:
    """Return a key of the closure of these texts: graph IRI -> hash of its text."""
    digest = hashlib.sha256(f"{_FORM} owlrl {importlib.metadata.version('owlrl')}\n".encode())
    for graph, text_hash in sorted(hashes.items()):
        digest.update(f"{graph} {text_hash}\n".encode())
    return digest.hexdigest()
