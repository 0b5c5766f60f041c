"""Numerical stability: sweeps of the families of mitsuba_ref/hard in which one quantity gets extreme."""

from mitsuba_ref.hard.swept_families import SWEPT as FAMILIES

__all__ = ["FAMILIES"]
