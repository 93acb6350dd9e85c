"""Estimated costs of operators: cardinalities, rates, sizes."""
