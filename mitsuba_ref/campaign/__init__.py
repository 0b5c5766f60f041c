"""Campaigns: many units of work by a file, kept in a history of runs, and what changed between them."""
