"""Units of formulas and patterns: verdicts and matches of samples."""
