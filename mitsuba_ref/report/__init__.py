"""Verdicts as a page: what was judged, pixel by pixel, to be opened from a file. It judges nothing itself."""
