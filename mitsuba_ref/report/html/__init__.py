"""The HTML report: per-pixel records and the page that shows them, opened from a file."""
