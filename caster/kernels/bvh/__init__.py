"""Bounding volume hierarchies: construction, single-ray and packet traversal."""
