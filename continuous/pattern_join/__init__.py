"""Joins of triple patterns over a window in compiled loops, and the rows that these store."""
