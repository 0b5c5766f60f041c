"""POV-Ray's trace() at a mesh2: povray_trace.py MESH.raw RAYS.raw HITS.raw, in a process of its own."""

import subprocess
import sys
from pathlib import Path

import numpy as np

mesh, rays, hits = map(Path, sys.argv[1:])
count = 3 * int(np.fromfile(mesh, "<i8", 1)[0])
v = np.fromfile(mesh, "<f4", count, offset=16).reshape(-1, 3)
f = np.fromfile(mesh, "<i4", offset=16 + 4 * count).reshape(-1, 3)
rays = np.fromfile(rays, "<f4").reshape(-1, 8).astype(float)
given = (v, f, rays[:, :3], rays[:, 3:6])
v, f, o, d = ([f"<{','.join(map(repr, row))}>" for row in each.tolist()] for each in given)
vectors, faces = (f"{{ {len(each)}, {','.join(each)} }}" for each in (v, f))
lines = [f"#declare M = mesh2 {{ vertex_vectors {vectors} face_indices {faces} }}", f'#fopen F "{hits}.txt" write']
lines += ["#macro R(o, d) #local N = <0, 0, 0>; #local P = trace(M, o, d, N);"]
lines += ['#write(F, vstr(3, P, " ", 0, 17), " ", vstr(3, -N, " ", 0, 17), "\\n") #end']  # left-handed
scene = hits.with_suffix(".pov")
scene.write_text("\n".join(lines + [f"R({a}, {b})" for a, b in zip(o, d, strict=True)]))
subprocess.run(["povray", f"+I{scene}", "-D", "-F", "+W1", "+H1"], check=True, capture_output=True)
found = np.loadtxt(f"{hits}.txt").reshape(-1, 6)
t = ((found[:, :3] - rays[:, :3]) * rays[:, 3:6]).sum(1) / (rays[:, 3:6] ** 2).sum(1)
np.column_stack([np.where(found[:, 3:].any(1), t, np.inf), found[:, 3:]]).astype("<f4").tofile(hits)
