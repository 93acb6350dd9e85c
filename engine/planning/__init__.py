"""From a plan of matching, or a query, to units that run and are shared."""
