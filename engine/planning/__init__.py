"""Starts the units of plans and queries, and shares equal ones."""
