"""Exact ray-primitive intersections in integer arithmetic."""
