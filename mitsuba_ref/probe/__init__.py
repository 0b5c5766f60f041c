"""One pixel: every witness's answer, the bounds there, and the verdict."""
