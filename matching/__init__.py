"""Semantic matching: which streams and units give a wanted feature ([Introspection15 §4.3])."""
