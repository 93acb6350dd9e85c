"""The command line ``dyknow``: one module a group of commands (docs/reference/command-line.md)."""

from .main import app, main

__all__ = ["app", "main"]
