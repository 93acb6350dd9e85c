"""Windows: their grid, their panes, what they hold, and when each is due."""
