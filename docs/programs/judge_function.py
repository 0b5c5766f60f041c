# Judge a ray caster that is a Python function, on the built-in scenes of triangles.
from mine import trace  # trace(scene, o, d) -> (t, normals)

import mitsuba_ref

verdict = mitsuba_ref.validate(builtin="triangles", candidate=trace, size=(32, 32))
print(verdict)
if not verdict.ok:
    print(verdict.write_html("report"))
