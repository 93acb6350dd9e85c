"""Windows: their grid, their panes, their contents, and when they close."""
