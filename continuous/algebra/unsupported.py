"""What the columns have no word for: found when a query is planned, never later."""


class Unsupported(Exception):
    """A part of SPARQL that goes to Oxigraph; the message names it."""
