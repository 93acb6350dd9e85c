"""Relations in columns: expressions over them, order, sums, and the compiled loops beneath."""
