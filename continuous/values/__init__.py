"""What terms are worth: numbers, booleans, exact decimals; the functions of the standard."""
