"""How results, histories and explanations are written as answers."""
