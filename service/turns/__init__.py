"""Long work in turns, so that others are answered in between."""
