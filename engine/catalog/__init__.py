"""What is known of streams and transformations, and its mirror in the ontology."""
