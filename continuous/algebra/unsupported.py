"""Reports SPARQL that columns cannot express. This happens when a query is planned, never later."""


class Unsupported(Exception):
    """A part of SPARQL that Oxigraph must evaluate; the message names it."""
