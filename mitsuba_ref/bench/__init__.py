"""Run time against error: ours, Mitsuba and a candidate on the same scenes, in turns. `mitsuba-ref bench` runs it.

To add a ray caster, derive a class from drivers.Driver, and add a line to casters.CASTERS and a colour to
benchmarks/performance_page.py. A scene is a line in scenes.SCENES.
"""
