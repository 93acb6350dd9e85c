"""Metric temporal logic over states (SPEC §8, docs/explanation/design/0011-formulas.md)."""
