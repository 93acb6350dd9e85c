"""Specifications in XML: applied, inserted, removed, written."""
