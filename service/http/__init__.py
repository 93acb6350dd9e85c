"""HTTP: errors, content negotiation, and the limits of bodies, answers and connections."""
