"""Run time against error: ours, Mitsuba and others on the same scenes, taking turns. `mitsuba-ref bench` runs it."""
