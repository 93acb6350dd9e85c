"""Computational units: one file a kind."""
