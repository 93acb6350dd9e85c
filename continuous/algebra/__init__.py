"""The query as a plan: from the SPARQL tree to operators of an algebra, rewritten and printed."""
