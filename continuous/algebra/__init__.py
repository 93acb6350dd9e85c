"""The logical plan of a query: translated from the SPARQL tree, rewritten, printed."""
