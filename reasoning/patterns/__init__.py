"""Patterns of events: one plan for chronicles, EP-SPARQL and SASE+ (SPEC §8)."""
