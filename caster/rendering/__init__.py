"""The render pipeline: plan, rays, nearest hits, surfaces, AOVs."""
