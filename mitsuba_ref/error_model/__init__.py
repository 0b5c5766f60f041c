"""Error bounds and every other tolerance of the judge."""
