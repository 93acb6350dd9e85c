"""The command line ``dyknow``: a module for each group of commands
(docs/reference/command-line.md)."""

from .main import app, main

__all__ = ["app", "main"]
