"""The values of terms: numbers, booleans, exact decimals; the standard functions."""
