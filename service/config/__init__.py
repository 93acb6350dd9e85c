"""Settings, logs, media types, limits of texts and files."""
