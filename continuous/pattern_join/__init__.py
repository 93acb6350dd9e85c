"""Joins of triple patterns over a window by compiled loops, and the rows that they keep."""
