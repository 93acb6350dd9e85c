"""Plans of patterns as data, and what their times imply."""
