"""What an operator will cost: cardinalities, rates, sizes."""
