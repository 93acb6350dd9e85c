"""Evaluation of a window by an Oxigraph store, for queries that columns do not support."""
