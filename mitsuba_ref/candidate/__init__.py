"""Anybody's ray caster in the place of ours: how it is asked, and how what it says is judged (docs/candidates.md)."""
