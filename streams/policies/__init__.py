"""Policies: their constraints, adaptation to them, and what satisfies them."""
