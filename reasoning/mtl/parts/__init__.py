"""Verdicts over states of each object's own: progression, in compiled loops."""
