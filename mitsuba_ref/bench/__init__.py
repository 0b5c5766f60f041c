"""Run time against error: ours, Mitsuba and others on the same scenes, taking turns. `mitsuba-ref bench` runs it.

Another contestant: a class of entries.py that implements Entry, a line in contestants.CONTESTANTS, and a
colour in benchmarks/performance_page.py. Another scene: a line in scenes.SCENES.
"""
