"""User-written units, sources and sinks: how they are registered, loaded and called.

Programs that embed an engine take `PROCESSES` from here (docs/how-to/write-a-process.md).
"""

from .registry import PROCESSES, Processes

__all__ = ["PROCESSES", "Processes"]
