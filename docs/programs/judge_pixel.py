# Explain one pixel: every answer to the bit, exact arithmetic among them.
from mine import trace

import mitsuba_ref

found = mitsuba_ref.probe_pixel("scene.toml", 12, 9, candidate=trace)
print(found)
print(found.verdict, found.ours["t"], found.reference["t"], found.exact["t"])
