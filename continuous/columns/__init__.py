"""Relations in columns: expressions, order, exact sums, and the compiled loops that they use."""
