"""Validation of many scenes: selection, workers, shards, stored verdicts and the pytest plug-in."""
