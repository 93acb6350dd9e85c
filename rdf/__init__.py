"""RDF for streams: terms, their dictionary, and timed triples in columns ([Events14 §V.A])."""
