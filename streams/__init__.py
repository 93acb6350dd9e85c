"""Streams ([DyKnow10 §4-5]): time, samples in columns, fluent streams, generators.

The ground floor: it knows nothing of RDF, languages or the service, and reads no clock.
"""
