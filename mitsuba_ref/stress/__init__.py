"""Numerical stability: sweeps of the families of mitsuba_ref/hard in which one quantity gets extreme."""
