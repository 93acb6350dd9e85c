"""Server-sent events: feeds of streams, their clients, and messages."""
