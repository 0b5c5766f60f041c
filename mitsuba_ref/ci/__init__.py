"""What continuous integration needs of a run: summaries, shards, and results kept for later."""
