"""Which streams and units there are, and what is published to them."""
