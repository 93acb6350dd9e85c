"""Converters: samples <-> timed triples by annotation ([Events14 §V.A]), samples <-> bytes.

A conversion renames and masks columns. Python objects for single samples appear only where a wire
format makes them. docs/reference/formats.md shows every form by example.
"""

from .errors import ConversionError, WireError
from .results_to_samples import ResultConverter, result_schema
from .to_samples import TripleConverter
from .to_triples import SampleConverter
from .wire import Incoming

__all__ = [
    "ConversionError",
    "Incoming",
    "ResultConverter",
    "SampleConverter",
    "TripleConverter",
    "WireError",
    "result_schema",
]
