"""Texts of ontologies and of SPARQL queries, before a store has them: checked, and read."""
