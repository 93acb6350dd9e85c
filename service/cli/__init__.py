"""The command line ``dyknow``: one module a group of commands (docs/api.md)."""

from .commands import app, main

__all__ = ["app", "main"]
