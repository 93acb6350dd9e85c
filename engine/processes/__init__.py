"""User-written units, sources and sinks: registration, loading, calls and failures.

Programs that embed an engine import `PROCESSES` from here (docs/how-to/write-a-process.md).
"""

from .registry import PROCESSES, Processes

__all__ = ["PROCESSES", "Processes"]
