"""Continuous queries over windows of timed triples ([Events14 §III-IV], SPEC §5).

Text → AST (languages/csparql) → logical plan → operators on columns. Oxigraph evaluates the windows
of a query that the plan cannot express. Semantics: docs/explanation/semantics.md.
"""
