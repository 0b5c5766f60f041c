"""Surfaces, normals and lighting at hits."""
