"""Samples as an Arrow IPC stream."""
