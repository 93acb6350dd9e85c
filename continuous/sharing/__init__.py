"""Queries that differ in constants only, evaluated as one."""
