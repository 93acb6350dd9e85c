"""Reasoning over streams: formulas (`mtl`); patterns are to come (SPEC §8)."""
