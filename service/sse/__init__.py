"""Server-sent events: feeds, clients, messages."""
