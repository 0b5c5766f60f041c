"""Checks of a scene beside its pixels: rays aimed at edges, other units of length, mesh files read again."""
