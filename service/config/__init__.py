"""Settings, logs, media types, and what the process asks of the system."""
