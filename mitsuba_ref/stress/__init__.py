"""Numerical stability: families of mitsuba_ref/hard, each with one parameter swept to its extreme."""
