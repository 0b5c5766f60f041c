"""The render pipeline: rays, nearest hits, surfaces, AOVs."""
