"""Declarations in KPL: checked, started, proved, printed."""
