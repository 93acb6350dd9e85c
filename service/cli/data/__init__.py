"""Commands that read a data directory."""
