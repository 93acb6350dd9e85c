"""Plans of least weight and of best quality in a hypergraph of goals."""
