"""The operators of a plan over columns: joins, groups, paths, the forms of results."""
