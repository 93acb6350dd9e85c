"""Continuous queries over windows of timed triples ([Events14 §III-IV], SPEC §5).

Text → AST (languages/csparql) → logical plan → operators on columns, or Oxigraph a window where
the plan cannot say it. Semantics: docs/explanation/semantics.md.
"""
