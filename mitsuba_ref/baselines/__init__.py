"""Reference EXRs that are kept beside scenes: made, shown, approved, and refused when they are stale."""
