"""What follows from the ontologies: the closure of those that are loaded, and the consequences of
each triple of the live stream space."""
