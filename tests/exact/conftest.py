"""Exact arithmetic is registered with each kind of shape, which no test of this folder need import."""

import mitsuba_ref.shapes  # noqa: F401 - registers the exact arithmetic of all kinds
