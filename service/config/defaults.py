"""What the service, its client and the command line agree on."""

from __future__ import annotations

from typing import Final

URL: Final = "http://127.0.0.1:8000"
"""Where a service is, unless somebody says otherwise."""
TOKEN: Final = "DYKNOW_TOKEN"
"""The environment variable with the token of whoever runs this program."""
AHEAD: Final = "ahead of the clock"
"""The title of the problem of a sample too far in the future: a publisher may leave it out
(``latest``)."""
