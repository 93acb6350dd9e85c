"""The evaluator of one query: it chooses how each part is computed, and computes windows."""
