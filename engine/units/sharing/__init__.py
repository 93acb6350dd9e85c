"""Units that evaluate several requests or queries as one, and the instances of these."""
