"""Descriptions: base classes of scene elements, checked fields, transforms and diagnostics."""
