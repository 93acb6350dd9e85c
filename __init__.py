"""DyKnow: semantic stream reasoning.

People say what they want to know; the system finds or builds the streams that answer it.
The rooms and the way of a sample are described in ARCHITECTURE.md.
"""

__version__ = "0.1.0"
