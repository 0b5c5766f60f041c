"""Validation of many scenes: selection, workers, resume, shards and the pytest plug-in."""
