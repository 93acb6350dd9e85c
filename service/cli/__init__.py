"""The command line ``dyknow``: one module a group of commands (docs/api.md)."""

import gc

# Of what modules make when they are imported nothing is garbage, and looking for it again and again
# takes a sixth of the time.
_WAS_ENABLED = gc.isenabled()
gc.disable()
try:
    from .main import app, main
finally:
    if _WAS_ENABLED:
        gc.enable()

__all__ = ["app", "main"]
