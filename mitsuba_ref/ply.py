"""Triangles -> binary PLY, the way every reader agrees on: little endian, float32, triangles only."""

from typing import Any

import numpy as np


def ply_bytes(part: Any) -> bytes:
    """A PLY file of packed triangles: corners, and normals and uv where they are used.

    part: caster's Triangles whose numbers are float32 values; they go into the file without another rounding.
    """
    columns = {name: part.vertices[:, c] for c, name in enumerate("xyz")}
    if part.smooth.any():
        columns |= {f"n{name}": part.normals[:, c] for c, name in enumerate("xyz")}
    if part.textured.any():
        columns |= {name: part.uv[:, c] for c, name in enumerate("uv")}
    vertices = np.zeros(len(part.vertices), [(name, "<f4") for name in columns])
    for name, values in columns.items():
        vertices[name] = values
    faces = np.zeros(len(part.faces), [("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, part.faces
    properties = "".join(f"property float {name}\n" for name in columns)
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n{properties}"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    return header.encode("ascii") + vertices.tobytes() + faces.tobytes()
