"""Commands that look into a data directory."""
