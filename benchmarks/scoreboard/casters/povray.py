import subprocess
import tempfile
from pathlib import Path

import numpy as np
from serve import t_of_points


def rows(a):
    return [f"<{','.join(map(repr, row))}>" for row in a.tolist()]


def trace(v, f, o, d, t_min, t_max):
    lines = [f"#declare M = mesh2 {{ vertex_vectors {{ {len(v)}, {','.join(rows(v.astype(float)))} }}"]
    lines += [f'face_indices {{ {len(f)}, {",".join(rows(f))} }} }} #fopen F "hits" write']
    lines += ["#macro R(o, d) #local N = <0, 0, 0>; #local P = trace(M, o, d, N);"]
    lines += ['#write(F, vstr(3, P, " ", 0, 17), " ", vstr(3, -N, " ", 0, 17), "\\n") #end']  # left-handed
    with tempfile.TemporaryDirectory() as folder:
        calls = [f"R({p}, {q})" for p, q in zip(rows(o), rows(d), strict=True)]
        Path(folder, "scene.pov").write_text("\n".join(lines + calls))
        subprocess.run(["povray", "+Iscene.pov", "-D", "-F", "+W1", "+H1"], cwd=folder, check=True, capture_output=True)
        found = np.loadtxt(Path(folder, "hits")).reshape(-1, 6)
    hit = found[:, 3:].any(axis=1)[:, None]
    return t_of_points(o, d, np.where(hit, found[:, :3], np.nan)), found[:, 3:]
