"""Scenes: description, files, diagnostics and export."""
