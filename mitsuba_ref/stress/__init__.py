"""Numerical stability: sweeps of scenes in which one quantity gets extreme, through all witnesses."""
