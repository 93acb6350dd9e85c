"""Commands that play recordings."""
