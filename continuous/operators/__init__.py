"""The operators of a plan over columns: scans, joins, groups, paths, result forms."""
