"""What the engine speaks of: status, changes, errors, views, the schemas of results."""
