"""Aggregates that follow a sliding window, and what they keep between windows."""
