"""Executes commands, waits until the log has them on disk, and writes checkpoints."""
