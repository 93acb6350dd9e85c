"""What every request passes, and what bodies and answers may be."""
