"""From checked texts to plans."""
