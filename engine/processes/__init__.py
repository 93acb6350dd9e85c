"""User-written units, sources and sinks: how they are registered, loaded and called."""
