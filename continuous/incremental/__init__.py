"""Aggregates that follow a sliding window incrementally, and their state."""
