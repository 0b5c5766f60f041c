"""Contestants, a module each; a process of its own loads one of them (mitsuba_ref/bench/worker.py)."""
