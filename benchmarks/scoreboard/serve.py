"""Serve a caster in Python over stdin and stdout (docs/candidates.md): serve.py CASTER.py float32|float64.

CASTER.py has trace(v, f, o, d, t_min, t_max) -> (t, n): v (m, 3) float32, f (k, 3) int32, rays float64; n may be None.
"""

import os
import runpy
import sys

import numpy as np


def first_of(count, ray, t):
    """(count,) the smallest t of each ray, of hits given by the number of their ray and t; inf on a miss."""
    first = np.full(count, np.inf)
    np.minimum.at(first, ray, t)
    return first


def t_of_points(o, d, points):
    """t of points (n, 3) along their rays, in float64: (p - o) . d / d . d; inf where a point is NaN."""
    t = ((np.reshape(points, (-1, 3)) - o) * d).sum(1) / (d * d).sum(1)
    return np.where(np.isnan(t), np.inf, t)


def block(stream):
    head = stream.read(8)
    return stream.read(int.from_bytes(head, "little")) if head else b""


def main():
    path, precision = sys.argv[1:]
    number = {"float32": "<f4", "float64": "<f8"}[precision]
    replies = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints goes to stderr
    sys.path.append(os.path.dirname(path))  # for glue that imports other glue
    trace = runpy.run_path(path)["trace"]
    while mesh := block(sys.stdin.buffer):
        rays = np.frombuffer(block(sys.stdin.buffer), number).reshape(-1, 8).astype(np.float64)
        vertices = 3 * int.from_bytes(mesh[:8], "little")
        v = np.frombuffer(mesh, "<f4", vertices, 16).reshape(-1, 3)
        f = np.frombuffer(mesh, "<i4", offset=16 + 4 * vertices).reshape(-1, 3)
        t, n = trace(v, f, rays[:, :3], rays[:, 3:6], rays[:, 6], rays[:, 7])
        hits = np.column_stack([t] if n is None else [t, np.where(np.isfinite(t)[:, None], n, 0.0)]).astype(number)
        replies.write(hits.nbytes.to_bytes(8, "little") + hits.tobytes())
        replies.flush()


if __name__ == "__main__":
    sys.modules["serve"] = sys.modules["__main__"]
    main()
