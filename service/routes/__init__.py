"""The routes, one module a resource; docs/api.md lists them all."""
