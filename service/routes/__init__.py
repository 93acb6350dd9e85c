"""The routes, one module a resource; docs/reference/http.md lists them all."""
