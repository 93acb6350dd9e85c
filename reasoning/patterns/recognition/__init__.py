"""Patterns over samples: rows in order, plans put together, answers about matches."""
