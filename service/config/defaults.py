"""Names and defaults that the service, its client and the command line share."""

from __future__ import annotations

from typing import Final

URL: Final = "http://127.0.0.1:8000"
"""The default address of a service."""
ADDRESS: Final = "DYKNOW_URL"
"""The environment variable with another address."""
TOKEN: Final = "DYKNOW_TOKEN"
"""The environment variable with the user's token."""
AHEAD: Final = "ahead of the clock"
"""The title of the problem of a sample too far in the future: a publisher may omit such samples
(``latest``)."""
