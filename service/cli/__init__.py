"""The command line ``dyknow``: one module a group of commands (docs/api.md)."""

from .main import app, main

__all__ = ["app", "main"]
