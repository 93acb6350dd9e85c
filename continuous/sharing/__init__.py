"""Shared evaluation of queries that differ in constants only."""
