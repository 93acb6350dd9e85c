"""The service: HTTP, server-sent events, client and command line ([Events14 §V.C],
docs/reference/http.md).

The only room that reads a clock. A route parses, calls the engine, returns a model.
"""
