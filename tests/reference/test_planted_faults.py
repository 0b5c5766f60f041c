"""The judge fails when it should: faults planted one at a time, as edits of a copy of the caster or of an EXR file.

Each scene passes in an unedited copy, so it is the fault that fails it. All of them by `make faults` (FAULTS=all);
without it, of each check the first.
"""

import os
import re
import shlex
from typing import NamedTuple

import numpy as np
import pytest
from edited_tree import ROOT, copy_tree, edit, said_beside_progress
from intersection_faults import LEAF_OF_PACKET

from caster.image.exr import read_exr, write_exr
from mitsuba_ref.__main__ import main
from mitsuba_ref.judge.checks import thorough_names

WIDTH, HEIGHT = "7", "6"  # the fewer pixels, the harder is a fault to see


class Fault(NamedTuple):
    """What somebody might get wrong, the scene that shows it, and the check that has to say so."""

    what: str
    scene: str
    check: str
    file: str
    old: str
    new: str
    size: tuple[str, str] = (WIDTH, HEIGHT)


ONE_NAN = """
        if {aov!r} in images:
            images[{aov!r}].reshape(window.height * WIDTH, -1)[np.flatnonzero(self.hit)[7:8]] = np.nan
"""


def one_nan(aov: str) -> Fault:
    """A single pixel that is not a number."""
    old = "            parallel_for_tiles(begin, rows, self.threads)\n"
    return Fault(f"one NaN in {aov}", "one-sphere", aov, HITS, old, old + ONE_NAN.format(aov=aov)[1:])


AOVS, HITS, IMAGES = "caster/aovs", "caster/rendering/hits.py", "caster/rendering/images.py"
ROOTS, TRIANGLES = "caster/kernels/math/quadric_roots.py", "caster/kernels/triangles.py"
SPHERE, CYLINDER, DISK, PLANE = (f"caster/shapes/{name}.py" for name in ("sphere", "cylinder", "disk", "plane"))
PINHOLE, ORTHOGRAPHIC = "caster/cameras/pinhole.py", "caster/cameras/orthographic.py"
UV = f"{AOVS}/uv.py"
LIGHTS, TILES = "caster/scene/model.py", "caster/rendering/shading.py"
LIGHT = "caster/kernels/surface/lighting.py"
SCREEN, TREE, PLACING = (
    "caster/kernels/raster/tile_casting.py",
    "caster/kernels/bvh/traversal.py",
    "caster/geometry/world_space.py",
)
TILE, BUNDLE = "caster/kernels/raster/tile.py", "caster/kernels/bvh/traversal.py"

ANGLES, WHOLE_TURN = (
    "caster/kernels/math/angles.py",
    "return min((whole + sense * 0.125 * eighths) + sense * TURNS_PER_RADIAN * rest, LAST_BELOW_ONE)",
)

ODD = "15", "15"  # pixel centres on the edges that faces share
SEAMS = "33", "3"  # those of the middle row, on the seams
FAULTS = (
    # ---- which hit ----
    Fault(
        "far root for near",
        "one-sphere",
        "normal",
        ROOTS,
        "near = certain_in_range(roots.near, roots.near_error, t_min, t_max)",
        "near = certain_in_range(roots.far, roots.far_error, t_min, t_max)",
    ),
    Fault(
        "t_min ignored by spheres",
        "inside-sphere",
        "shape_id",
        ROOTS,
        "roots.near_error, t_min, t_max",
        "roots.near_error, -math.inf, t_max",
    ),
    Fault(
        "t_min ignored by triangles",
        "shared-edges-cube",
        "culling",
        TRIANGLES,
        "t, error = certain_in_range(t, error, t_min, t_max)",
        "t, error = certain_in_range(t, error, -1e300, t_max)",
    ),
    Fault(
        "t_min ignored by planes",
        "spheres-on-plane",
        "diffuse",
        PLANE,
        "t, error = certain_in_range(t, error, t_min, t_max)",
        "t, error = certain_in_range(t, error, -1e300, t_max)",
    ),
    Fault(
        "the farther of two hits",
        "closest-of-several",
        "shape_id",
        TILE,
        "nearer = ahead > margin",
        "nearer = (t < math.inf) & ((tile[PRIM + i] < 0.0) | (-ahead > margin))",
    ),
    Fault(
        "triangle edge excluded",
        "shared-edges-cube",
        "mask",
        TRIANGLES,
        "filter_result(inside & steep, outside, t, error)",
        "filter_result(inside & steep, not inside, t, error)",
        ODD,
    ),
    Fault(
        "triangles seen from one side",
        "triangles",
        "shape_id",
        TRIANGLES,
        "return (least > error) | (most < -error), (most > error) & (least < -error) & bounded, bounded",
        "return least > error, (most > error) & (least < -error) | (most < -error), bounded",
    ),
    Fault(
        "square disks",
        "flat-shapes",
        "mask",
        DISK,
        "beyond = x * x + y * y - 1.0",
        "beyond = max(abs(x), abs(y)) - 1.0",
    ),
    Fault(
        "disks a twentieth too small",
        "flat-shapes",
        "mask",
        DISK,
        "beyond = x * x + y * y - 1.0",
        "beyond = x * x + y * y - 0.9",
    ),
    Fault(
        "tubes without far wall",
        "cylinders",
        "mask",
        CYLINDER,
        "far = clip_to_height(certain_in_range(roots.far, roots.far_error, t_min, t_max), axis)",
        "far = math.inf, 0.0",
    ),
    Fault(
        "tubes without ends",
        "cylinders",
        "mask",
        CYLINDER,
        "near = clip_to_height(certain_in_range(roots.near, roots.near_error, t_min, t_max), axis)",
        "near = certain_in_range(roots.near, roots.near_error, t_min, t_max)",
    ),
    Fault(
        "edges with an epsilon",
        "shared-edges-cube",
        "mask",
        TRIANGLES,
        "(most > error) & (least < -error)",
        "(least < 1e-9) & (most > -1e-9)",
        ODD,
    ),
    Fault(
        "float32 inside",
        "one-sphere",
        "on_surface",
        TILE,
        "tile[T + i] = t if nearer",
        "tile[T + i] = float(np.float32(t)) if nearer",
    ),
    Fault(
        "a discriminant that cancels",
        "far-small-spheres",
        "on_surface",
        ROOTS,
        "within = setup.rr - gg",
        "within = (b * b - a * setup.c) * over_a",
    ),
    # ---- how far, and what surface ----
    Fault(
        "a radius off by 3e-6 of itself",
        "one-sphere",
        "on_surface",
        SPHERE,
        "def _load(prims: Any, k: int) -> Any:\n    return row(prims.center, k), prims.radius[k]",
        "def _load(prims: Any, k: int) -> Any:\n    return row(prims.center, k), prims.radius[k] * 1.000003",
    ),
    Fault("depth as z", "one-sphere", "depth", f"{AOVS}/depth.py", "hit.t * length(hit.d)", "hit.t * abs(hit.d[2])"),
    Fault("depth from the near plane", "near-far-clip", "depth", f"{AOVS}/depth.py", "hit.start + ", ""),
    Fault(
        "flipped normal of triangles",
        "triangles",
        "normal",
        TRIANGLES,
        "    e1, e2 = sub(b, a), sub(c, a)\n",
        "    e1, e2 = sub(c, a), sub(b, a)\n",
    ),
    Fault(
        "flipped normal of spheres",
        "one-sphere",
        "normal",
        ROOTS,
        "out = point_at(closest, side * half_chord, d)",
        "out = point_at(closest, -side * half_chord, d)",
    ),
    Fault(
        "normal turned to the viewer",
        "inside-sphere",
        "normal",
        f"{AOVS}/normal.py",
        "return hit.normal",
        "return tuple(-float(np.sign(np.dot(hit.normal, hit.d))) * x for x in hit.normal)",
    ),
    Fault(
        "unnormalised normal",
        "triangles",
        "normal",
        TRIANGLES,
        "known, unit = fast_normalize(n)",
        "known, unit = True, n",
    ),
    Fault(
        "vertex normals not renormalised",
        "coarse-silhouettes",
        "shading_normal",
        TRIANGLES,
        "return fast_normalize(add(",
        "return True, (add(",
    ),
    Fault(
        "vertex normals in the wrong order",
        "coarse-silhouettes",
        "shading_normal",
        TRIANGLES,
        "add(scaled(weights[0], n0), add(scaled(weights[1], n1)",
        "add(scaled(weights[1], n0), add(scaled(weights[0], n1)",
    ),
    Fault(
        "normals of ellipsoids by the plain matrix",
        "ellipsoids",
        "normal",
        SPHERE,
        "n = normalize(transposed_mat_vec(prims.to_object, k, q))",
        "n = normalize(mat_vec(prims.to_world, k, q))",
    ),
    Fault(
        "position off the sphere by 1e-4 of its radius",
        "one-sphere",
        "position",
        SPHERE,
        "return point_at(center, r, n)",
        "return point_at(center, 1.0001 * r, n)",
    ),
    Fault(
        "shapes numbered from the back",
        "closest-of-several",
        "shape_id",
        f"{AOVS}/shape_id.py",
        "return hit.shape_id",
        "return 2 - hit.shape_id",
    ),
    *(one_nan(aov) for aov in ("depth", "normal", "shading_normal", "position", "uv", "diffuse")),
    Fault("depth 0 on a miss", "one-sphere", "depth", f"{AOVS}/depth.py", "np.float64, math.inf", "np.float64, 0.0"),
    Fault("light on a miss", "one-sphere", "diffuse", f"{AOVS}/diffuse.py", "np.float64, 0.0", "np.float64, 0.1"),
    # ---- uv ----
    Fault("u and v exchanged", "one-sphere", "uv", UV, "return hit.uv", "return hit.uv[1], hit.uv[0]"),
    Fault("u mirrored", "one-sphere", "uv", UV, "return hit.uv", "return 1.0 - hit.uv[0], hit.uv[1]"),
    Fault("u off by 1e-6", "flat-shapes", "uv", UV, "return hit.uv", "return hit.uv[0] + 1e-6, hit.uv[1]"),
    Fault("u off by one turn", "one-sphere", "uv", UV, "return hit.uv", "return hit.uv[0] + 1.0, hit.uv[1]"),
    Fault("uv on a miss", "one-sphere", "uv", UV, "np.float64, 0.0", "np.float64, 0.5"),
    Fault(
        "uv of vertices in the wrong order",
        "flat-shapes",
        "uv",
        TRIANGLES,
        "weights[0] * a[0] + (weights[1] * b[0]",
        "weights[1] * a[0] + (weights[0] * b[0]",
    ),
    Fault(
        "v from the top", "flat-shapes", "uv", TRIANGLES, "        weights[0] * a[1]", "        1.0 - weights[0] * a[1]"
    ),
    Fault(
        "barycentrics for the second triangle of a rectangle",
        "flat-shapes",
        "uv",
        TRIANGLES,
        "return prims.textured[k]",
        "return prims.textured[k] and k % 2 == 0",
    ),
    Fault(
        "barycentrics exchanged",
        "triangles",
        "uv",
        TRIANGLES,
        "return weights[1], weights[2]",
        "return weights[2], weights[1]",
    ),
    Fault(
        "a sphere's u off by half a turn",
        "one-sphere",
        "uv",
        SPHERE,
        "turn_fraction(q[1], q[0])",
        "turn_fraction(-q[1], -q[0])",
    ),
    Fault(
        "a sphere's v linear in its height",
        "one-sphere",
        "uv",
        SPHERE,
        "polar_fraction(min(max(q[2], -1.0), 1.0))",
        "0.5 - 0.5 * q[2]",
    ),
    Fault(
        "uv of ellipsoids by the normal",
        "ellipsoids",
        "uv",
        SPHERE,
        "spherical_uv(q) if wants_uv",
        "spherical_uv(n) if wants_uv",
    ),
    Fault(
        "uv of spheres by world axes",
        "overlapping",
        "uv",
        SPHERE,
        "spherical_uv(mat_vec(prims.turn, k, n))",
        "spherical_uv(n)",
    ),
    Fault(
        "a sphere's turn turned round",
        "overlapping",
        "geometry",
        SPHERE,
        "rounded(linear.T / scale)",
        "rounded(linear / scale)",
    ),
    Fault(
        "a cylinder's v not divided by its length",
        "cylinders",
        "uv",
        CYLINDER,
        "if wants_uv else 0.0, z\n",
        "if wants_uv else 0.0, z * math.hypot(*prims.to_world[k, :, 2])\n",
    ),
    Fault(
        "a disk's angle from -1/2 to 1/2",
        "flat-shapes",
        "uv",
        DISK,
        "turn_fraction(y, x) if",
        "math.atan2(y, x) / (2.0 * math.pi) if",
    ),
    Fault("a disk's distance squared", "flat-shapes", "uv", DISK, "math.sqrt(x * x + y * y)", "x * x + y * y"),
    Fault(
        "a plane's second axis the other way",
        "spheres-on-plane",
        "uv",
        PLANE,
        "return right, cross(n, right)",
        "return right, cross(right, n)",
    ),
    Fault("u of 1 in place of 0 on seams", "uv-seams", "uv", ANGLES, WHOLE_TURN, f"{WHOLE_TURN} or 1.0", SEAMS),
    Fault(
        "u of 1 less than a rounding beside seams",
        "uv-seams",
        "uv",
        ANGLES,
        WHOLE_TURN,
        "return (whole + sense * 0.125 * eighths) + sense * TURNS_PER_RADIAN * rest",
        SEAMS,
    ),
    Fault(
        "a disk's v of 1 on its seam",
        "uv-seams",
        "uv",
        DISK,
        "turn_fraction(y, x) if wants_uv",
        "(turn_fraction(y, x) or 1.0) if wants_uv",
        SEAMS,
    ),
    Fault(
        "a cylinder's u of 1 on its seam",
        "uv-seams",
        "uv",
        CYLINDER,
        "turn_fraction(y, x) if wants_uv",
        "1.0 - turn_fraction(-y, x) if wants_uv",
        SEAMS,
    ),
    Fault(
        "a sphere's turn by a remainder",
        "uv-seams",
        "uv",
        SPHERE,
        "return turn_fraction(q[1], q[0])",
        "return np.arctan2(q[1], q[0]) / (2.0 * np.pi) % 1.0",
        SEAMS,
    ),
    Fault(
        "a whole turn as it is stored",
        "uv-seams",
        "uv",
        UV,
        "return hit.uv",
        "return hit.uv[0] or 1.0, hit.uv[1]",
        SEAMS,
    ),
    # ---- where shapes stand ----
    Fault(
        "face_normals ignored",
        "ply-normals",
        "geometry",
        PLACING,
        "np.full(len(faces), not face_normals)",
        "np.full(len(faces), True)",
    ),
    Fault(
        "steps of to_world the other way round",
        "transforms",
        "placement",
        "caster/description/transform.py",
        "product(np.asarray(step, np.float64), total)",
        "product(total, np.asarray(step, np.float64))",
    ),
    Fault(
        "turns the other way",
        "transforms",
        "placement",
        "caster/description/fields.py",
        "self.rotate.axis, self.rotate.degrees",
        "self.rotate.axis, -self.rotate.degrees",
    ),
    Fault(
        "faces of mirrored meshes not turned round",
        "transforms",
        "geometry",
        PLACING,
        "mesh.faces[:, [0, 2, 1]] if is_mirrored(matrix[:3, :3]) else mesh.faces",
        "mesh.faces",
    ),
    Fault(
        "vertex normals by the plain matrix",
        "transforms",
        "geometry",
        PLACING,
        "transform_vectors(inverse(matrix[:3, :3]).T, mesh.normals)",
        "transform_vectors(matrix[:3, :3], mesh.normals)",
    ),
    Fault(
        "generated normals not weighted by angles",
        "ply-normals",
        "geometry",
        "caster/geometry/triangle_mesh.py",
        "unit * (0.25 * math.pi * eighths + rest)",
        "unit * (eighths + rest > 0.0)",
    ),
    Fault(
        "a sphere's centre not placed",
        "ellipsoids",
        "geometry",
        SPHERE,
        "rounded(transform_points(matrix, centers))",
        "rounded(centers + matrix[:3, 3])",
    ),
    Fault(
        "a packed radius off by 3e-6 of itself",
        "one-sphere",
        "geometry",
        SPHERE,
        "rounded(scale * radii)",
        "rounded(1.000003 * scale * radii)",
    ),
    Fault(
        "a plane's normal by the plain matrix",
        "transforms",
        "geometry",
        PLANE,
        "transform_vectors(inverse(self.matrix[:3, :3]).T, n)",
        "transform_vectors(self.matrix[:3, :3], n)",
    ),
    Fault(
        "a plane's offset with the wrong sign",
        "spheres-on-plane",
        "geometry",
        PLANE,
        "self.offset * n if",
        "-self.offset * n if",
    ),
    Fault(
        "a tube's radius taken for its diameter",
        "cylinders",
        "geometry",
        CYLINDER,
        "self.radius * first, self.radius * np.cross",
        "0.5 * self.radius * first, 0.5 * self.radius * np.cross",
    ),
    Fault(
        "meshes not moved",
        "ply-normals",
        "geometry",
        PLACING,
        "rounded(transform_points(matrix, mesh.vertices))",
        "rounded(transform_vectors(matrix[:3, :3], mesh.vertices))",
    ),
    # ---- cameras ----
    Fault(
        "half a pixel to the left and up",
        "one-sphere",
        "camera",
        PINHOLE,
        "def _camera_ray(camera: Any, x: float, y: float) -> Any:\n",
        "def _camera_ray(camera: Any, x: float, y: float) -> Any:\n    x, y = x - 0.5, y - 0.5\n",
    ),
    Fault("swapped aspect", "one-sphere", "camera", PINHOLE, "return x, x / aspect", "return x, x * aspect"),
    Fault(
        "y flipped",
        "one-sphere",
        "camera",
        PINHOLE,
        "above = (1.0 - 2.0 * (y / camera.size[1] + camera.shift[1]))",
        "above = (2.0 * (y / camera.size[1] + camera.shift[1]) - 1.0)",
    ),
    Fault(
        "x mirrored",
        "one-sphere",
        "camera",
        PINHOLE,
        "across = (2.0 * (x / camera.size[0] + camera.shift[0]) - 1.0)",
        "across = (1.0 - 2.0 * (x / camera.size[0] + camera.shift[0]))",
    ),
    Fault(
        "principal point to the other side",
        "shifted-view",
        "camera",
        PINHOLE,
        "x / camera.size[0] + camera.shift[0]",
        "x / camera.size[0] - camera.shift[0]",
    ),
    Fault("fov_axis ignored", "shifted-view", "camera", PINHOLE, "x = tan * aspect", "x = tan"),
    Fault("near plane ignored", "near-far-clip", "camera", PINHOLE, "d, camera.near * length,", "d, 0.0,"),
    Fault(
        "near as a distance, not a plane",
        "near-far-clip",
        "camera",
        PINHOLE,
        "d, camera.near * length,",
        "d, camera.near,",
    ),
    Fault("far plane ignored", "near-far-clip", "camera", PINHOLE, "camera.far * length", "math.inf"),
    Fault(
        "clip planes ignored by what is hit",
        "near-far-clip",
        "render",
        ROOTS,
        "roots.near_error, t_min, t_max",
        "roots.near_error, 0.0, t_max",
    ),
    Fault(
        "a square window",
        "orthographic",
        "camera",
        ORTHOGRAPHIC,
        "0.5 * self.width * height / width)",
        "0.5 * self.width)",
    ),
    Fault(
        "an equisolid fisheye",
        "fisheye",
        "camera",
        "caster/cameras/fisheye.py",
        "d = combine_axes(camera, sideways * across, sideways * above, 1.0 - 2.0 * h_square * sine * sine)",
        "sine = square * math.sin(half) ** 2\n    sideways = 2.0 * math.sin(half) * math.sqrt(max(1.0 - sine, 0.0))\n"
        "    d = combine_axes(camera, sideways * across, sideways * above, 1.0 - 2.0 * sine)",
    ),
    Fault("a panorama inside out", "panorama", "camera", "caster/cameras/panorama.py", "level * east", "-level * east"),
    Fault(
        "a spherical mirror for a parabolic one",
        "parabolic",
        "camera",
        "caster/cameras/parabolic.py",
        "1.0 - square)\n",
        "math.sqrt(max(1.0 - square, 0.0)))\n",
    ),
    # ---- light ----
    Fault(
        "no 1/pi", "one-sphere", "diffuse", LIGHT, "albedo[0] / math.pi * irradiance[0]", "albedo[0] * irradiance[0]"
    ),
    Fault(
        "light without shadows on the dark side",
        "no-shadows",
        "diffuse",
        LIGHT,
        "select(lit & hit, reflected_radiance",
        "select(hit, reflected_radiance",
    ),
    Fault(
        "the first material for all",
        "cornell-box",
        "diffuse",
        LIGHT,
        "number = lane(materials[lane(prim if prim >= 0.0 else 0.0)])",
        "number = lane(0)",
    ),
    Fault(
        "light that does not fall off",
        "one-sphere",
        "diffuse",
        LIGHT,
        "near = r / safe if apart else 0.0, g / safe if apart else 0.0, b / safe if apart else 0.0",
        "near = r, g, b",
    ),
    Fault(
        "light that falls off with the distance",
        "one-sphere",
        "diffuse",
        LIGHT,
        "near = r / safe if apart else 0.0, g / safe if apart else 0.0, b / safe if apart else 0.0",
        "near = r / math.sqrt(safe), g / math.sqrt(safe), b / math.sqrt(safe)",
    ),
    Fault(
        "one-sided surfaces lit from behind",
        "two-sided",
        "diffuse",
        LIGHT,
        "(cosine > 0.0) & (facing > 0.0)",
        "cosine * facing > 0.0",
    ),
    Fault(
        "two-sided surfaces dark from behind",
        "two-sided",
        "diffuse",
        LIGHT,
        "if two_sided else (cosine",
        "if False else (cosine",
    ),
    Fault("ambient light twice", "fisheye", "diffuse", LIGHT, "sum_ += buffer", "sum_ += 2.0 * buffer"),
    Fault(
        "the sun from the other side",
        "lights-and-shadows",
        "diffuse",
        LIGHTS,
        "(0.0 - x, 0.0 - y, 0.0 - z)",
        "(x, y, z)",
    ),
    Fault(
        "shadows cast by what is behind the light",
        "inside-sphere",
        "diffuse",
        LIGHT,
        "sub(light.position, p), 1.0",
        "sub(light.position, p), math.inf",
    ),
    Fault("no shadows", "spheres-on-plane", "diffuse", TILES, "if not plan.shadows.runs:", "if plan.shadows.runs:"),
    Fault(
        "surfaces that shadow themselves",
        "spheres-on-plane",
        "diffuse",
        LIGHT,
        "SHADOW_OFFSET = 4 *",
        "SHADOW_OFFSET = 0 *",
    ),
    Fault(
        "shadow rays that start too far out",
        "lights-and-shadows",
        "diffuse",
        LIGHT,
        "SHADOW_OFFSET = 4 *",
        "SHADOW_OFFSET = 2.0**49 *",
    ),
    Fault(
        "cosine of the geometric normal",
        "coarse-silhouettes",
        "diffuse",
        LIGHT,
        "get(buffer, SH_N + i), NOWHERE",
        "get(buffer, N + i), NOWHERE",
    ),
    Fault(
        "only some kinds of shape cast shadows",
        "lights-and-shadows",
        "diffuse",
        "caster/rendering/ray_tiles.py",
        "offsets = list(zip(packed.kinds, prim_offsets(packed), strict=True))\n        most",
        "offsets = list(zip(packed.kinds, prim_offsets(packed), strict=True))[:1]\n        most",
    ),
    Fault(
        "blue for red",
        "one-sphere",
        "diffuse",
        LIGHT,
        "(reflectance[0, 0], reflectance[0, 1], reflectance[0, 2])",
        "(reflectance[0, 2], reflectance[0, 1], reflectance[0, 0])",
    ),
    Fault(
        "blue for red among several materials",
        "cornell-box",
        "diffuse",
        LIGHT,
        "reflectance[number, 0], reflectance[number, 1], reflectance[number, 2]",
        "reflectance[number, 2], reflectance[number, 1], reflectance[number, 0]",
    ),
    Fault(
        "the first material for every shape",
        "cornell-box",
        "materials",
        "caster/scene/model.py",
        "self.materials[shape.material] if shape.material else DEFAULT_MATERIAL",
        "next(iter(self.materials.values()))",
    ),
    # ---- cullings ----
    Fault(
        "the tree forgets a leaf",
        "coarse-silhouettes",
        "culling",
        BUNDLE,
        f"start + number):{LEAF_OF_PACKET}",
        f"start + (0 if start + number == len(tree.order) else number)):{LEAF_OF_PACKET}",
    ),
    Fault(
        "depth in render from a unit beyond the eye",
        "one-sphere",
        "culling",
        IMAGES,
        "plan, self.images, reach=reach",
        "plan, self.images, reach=reach, start=np.ones((window.height, window.width))",
    ),
    Fault(
        "one NaN in the depth of render",
        "one-sphere",
        "culling",
        IMAGES,
        "        decided = self._decide_uncertain()\n",
        "        decided = self._decide_uncertain()\n"
        "        if 'depth' in self.images:\n            self.images['depth'][5:6, 6:7] = np.nan\n",
    ),
    Fault(
        "one NaN in the normals of render",
        "one-sphere",
        "culling",
        IMAGES,
        "        decided = self._decide_uncertain()\n",
        "        decided = self._decide_uncertain()\n"
        "        if 'normal' in self.images:\n            self.images['normal'][5:6, 6:7, 1] = np.nan\n",
    ),
    Fault(
        "one NaN in the light of render",
        "one-sphere",
        "culling",
        LIGHT,
        "add(get(buffer, RADIANCE + i), select(lit, reflected, NOWHERE)))",
        "add(get(buffer, RADIANCE + i), select(lit, reflected, NOWHERE)))\n"
        "                buffer[RADIANCE + ONE + i] = math.nan if i == 5 * WIDTH + 6 else buffer[RADIANCE + ONE + i]",
        ("12", "10"),  # the pixel is a hit
    ),
    Fault(
        "a camera's rays cast without their near plane",
        "near-far-clip",
        "culling",
        SCREEN,
        "intersect(prims, pre, d, tile[T_MIN + i], tile[T_MAX + i])",
        "intersect(prims, pre, d, 0.0, tile[T_MAX + i])",
    ),
    Fault(
        "far counted from the near plane, so that nothing is hit",
        "near-far-clip",
        "render",
        SCREEN,
        "intersect(prims, pre, d, tile[T_MIN + i], tile[T_MAX + i])",
        "intersect(prims, pre, d, tile[T_MIN + i], tile[T_MAX + i] - tile[T_MIN + i])",
    ),
    Fault(
        "render without lights",
        "one-sphere",
        "culling",
        IMAGES,
        "TileShader(scene, packed",
        "TileShader(scene.model_copy(update={'lights': ()}), packed",
    ),
    Fault("triangles reversed", "triangles", "geometry", "caster/shapes/triangle.py", "[[0, 1, 2]]", "[[0, 2, 1]]"),
    Fault(
        "a rectangle half as large",
        "flat-shapes",
        "geometry",
        "caster/shapes/rectangle.py",
        "return Mesh(CORNERS,",
        "return Mesh(0.5 * CORNERS,",
    ),
    Fault(
        "a cube inside out",
        "closest-of-several",
        "geometry",
        "caster/shapes/cube.py",
        "faces.reshape(-1, 3), None",
        "faces.reshape(-1, 3)[:, ::-1], None",
    ),
    Fault(
        "uv of one side of a cube turned",
        "shared-edges-cube",
        "geometry",
        "caster/shapes/cube.py",
        "    return Mesh(corners, faces",
        "    uv[4:8] = np.roll(uv[4:8], 1, axis=0)\n    return Mesh(corners, faces",
    ),
    Fault(
        "u of a rectangle mirrored",
        "flat-shapes",
        "geometry",
        "caster/shapes/rectangle.py",
        "0.5 * CORNERS[:, :2] + 0.5",
        "CORNERS[:, :2] * (-0.5, 0.5) + 0.5",
    ),
    Fault(
        "described uv in the order of the other winding",
        "triangles",
        "geometry",
        "caster/shapes/triangle.py",
        "np.array(self.uv, np.float64)",
        "np.array(self.uv, np.float64)[[0, 2, 1]]",
    ),
    Fault(
        "normals in float32",
        "one-sphere",
        "normal",
        f"{AOVS}/normal.py",
        "return hit.normal",
        "return tuple(np.array(hit.normal, np.float32).tolist())",
    ),
    Fault("a mask turned round", "one-sphere", "mask", f"{AOVS}/hit.py", "return 1.0", "return 0.0"),
    Fault(
        "prim_id that counts from one",
        "cornell-box",
        "shape_id",
        f"{AOVS}/prim_id.py",
        "return hit.prim_id",
        "return hit.prim_id + 1",
    ),
    Fault(
        "screen bounds of primitives too narrow",
        "triangles",
        "culling",
        "caster/kernels/raster/screen_bounds.py",
        "MARGIN = 2.0**-10",
        "MARGIN = -2.0",
    ),
)

FIRST_OF_CHECK = {fault.check: fault.what for fault in reversed(FAULTS)}
CHOSEN = [each for each in FAULTS if FIRST_OF_CHECK[each.check] == each.what or os.environ.get("FAULTS") == "all"]
CASES = sorted({(fault.scene, *fault.size) for fault in CHOSEN})


@pytest.fixture
def tree(unedited, tmp_path):
    """A copy to plant a fault in."""
    return copy_tree(tmp_path, unedited)


# Most of the time of `validate` in plain Python; each is made where it is the check that a fault offends.
LONG_CHECKS = (*thorough_names(), "knife_edges", "culling")


def validate(forks, tree, scene, size, check=None):
    """What `validate` says, with its exit code; an internal error is no verdict. check: the long one to run."""
    without = [name for name in LONG_CHECKS if check not in (None, name)]
    thorough = ["--thorough"] if check in thorough_names() else []
    found = forks.run(tree, "validate", str(scene), *thorough, "--size", *size, "-j", "1", without=without)
    assert found.returncode in (0, 1), found.stderr
    return found


@pytest.mark.parametrize(("scene", "width", "height"), CASES)
@pytest.mark.slow("each judges in plain Python", keep=2)
def test_without_a_fault_the_scene_passes(forks, unedited, coarse_scenes, scene, width, height):
    found = validate(forks, unedited, coarse_scenes / f"{scene}.toml", (width, height), check="any other")
    assert (found.returncode, said_beside_progress(found)) == (0, []), found.stdout
    assert f"PASS  {scene} " in found.stdout and "FAIL" not in found.stdout


def test_every_fault_fits_the_source_of_today():
    for fault in FAULTS:
        assert (ROOT / fault.file).read_text(encoding="utf-8").count(fault.old) == 1, fault.what


@pytest.mark.parametrize("fault", CHOSEN, ids=lambda fault: fault.what)
@pytest.mark.slow("each judges in plain Python", keep=6)
def test_a_planted_fault_fails_by_the_check_it_offends(forks, tree, coarse_scenes, fault):
    edit(tree, fault.file, fault.old, fault.new)
    found = validate(forks, tree, coarse_scenes / f"{fault.scene}.toml", fault.size, fault.check)
    print(found.stdout)
    assert found.returncode == 1, f"this passes: {fault.what}\n{found.stdout}"
    # The check of a scene stands in its first line, that of a pixel in the next, below the cause.
    named = rf"^FAIL  {fault.scene}  (.*\n      )?{fault.check}: "
    assert re.search(named, found.stdout, re.MULTILINE), found.stdout
    again = re.findall(r"^      replay:    mitsuba-ref (.*)", found.stdout, re.MULTILINE)
    assert again and all(line.endswith(f" --size {' '.join(fault.size)}") for line in again)


CLASS_OF = {
    "far root for near": "wrong",
    "a radius off by 3e-6 of itself": "wrong",
    "no 1/pi": "wrong",
    "depth as z": "undecided",  # our picture contradicts our own hit
}


@pytest.mark.parametrize("what", CLASS_OF)
@pytest.mark.slow("each judges in plain Python", keep=1)
def test_the_replay_of_a_pixel_shows_its_failure_again(forks, tree, coarse_scenes, what):
    (fault,) = (fault for fault in FAULTS if fault.what == what)
    edit(tree, fault.file, fault.old, fault.new)
    found = validate(forks, tree, coarse_scenes / f"{fault.scene}.toml", fault.size, fault.check)
    (again,) = re.findall(r"^      replay:    mitsuba-ref (probe .*)", found.stdout, re.MULTILINE)
    shown = forks.run(tree, *shlex.split(again))
    assert (shown.returncode, said_beside_progress(shown)) == (1, [])
    assert shown.stdout.splitlines()[0].endswith(f": {CLASS_OF[what]}")


# ---- pictures ----

FILM = ("31", "24")


def picture(forks, tree, folder, module, name):
    """One sphere as an EXR file, by `caster` or by `mitsuba_ref`."""
    words = ["--aov", "hit,depth,normal,shading_normal,position,diffuse,shape_id"]
    found = forks.run(
        tree, "render", "scenes/one-sphere.toml", "--size", *FILM, "-o", str(folder / name), *words, module=module
    )
    assert found.returncode == 0, found.stderr
    return folder / name


@pytest.fixture(scope="session")
def pictures(forks, unedited, tmp_path_factory):
    """(ours, the reference's)"""
    folder = tmp_path_factory.mktemp("pictures")
    ours = picture(forks, unedited, folder, "caster", "ours.exr")
    return ours, picture(forks, unedited, folder, "mitsuba_ref", "reference.exr")


def compare(forks, tree, ours, reference):
    found = forks.run(tree, "compare", str(ours), str(reference))
    assert found.returncode in (0, 1), found.stdout + found.stderr
    return found


def test_without_a_fault_the_images_pass(forks, unedited, pictures):
    found = compare(forks, unedited, *pictures)
    assert found.returncode == 0 and "PASS" in found.stdout


SEEN_IN_PICTURES = (
    ("far root for near", "depth"),
    ("half a pixel to the left and up", "hit"),
    ("y flipped", "hit"),
    ("x mirrored", "hit"),
    ("swapped aspect", "hit"),
    ("depth in render from a unit beyond the eye", "depth"),
    ("flipped normal of spheres", "normal"),
    ("light that does not fall off", "diffuse"),
    ("one NaN in the depth of render", "depth"),
    ("one NaN in the normals of render", "normal"),
    ("one NaN in the light of render", "diffuse"),
)


@pytest.mark.parametrize(("what", "quantity"), SEEN_IN_PICTURES)
@pytest.mark.slow("each renders in plain Python", keep=2)
def test_compare_fails_on_what_a_faulty_caster_renders(forks, tree, tmp_path, pictures, what, quantity):
    (fault,) = (fault for fault in FAULTS if fault.what == what)
    edit(tree, fault.file, fault.old, fault.new)
    found = compare(forks, tree, picture(forks, tree, tmp_path, "caster", "faulty.exr"), pictures[1])
    assert found.returncode == 1, f"this passes: {what}\n{found.stdout}"
    assert f"FAIL  {quantity}: " in found.stdout and "replay: mitsuba-ref probe" in found.stdout


def spoilt(channel, value):
    """Another value in one hit pixel of a channel."""

    def spoil(channels):
        pixels = channels[channel].copy()
        pixels[tuple(np.argwhere(channels["A"] > 0.0)[50])] = value
        return {**channels, channel: pixels}

    return spoil


IN_DATA = {
    "y flipped": lambda channels: {name: pixels[::-1] for name, pixels in channels.items()},
    "half a pixel to the side": lambda channels: {
        name: (pixels if pixels.dtype == np.uint32 else 0.5 * (pixels + np.roll(pixels, 1, axis=1)))
        for name, pixels in channels.items()
    },
    "unnormalised normal": lambda channels: {**channels, "normal.Z": channels["normal.Z"] * np.float32(1.001)},
    **{
        f"one {value} in {channel}": spoilt(channel, value)
        for channel in ("R", "depth.Z", "normal.X", "shading_normal.Y", "position.Z")
        for value in (np.nan, np.inf)
    },
    "one NaN in the mask": spoilt("A", np.nan),
    "one pixel missed": spoilt("A", 0.0),
    "one pixel of another shape": spoilt("id.shape", 7),
}


@pytest.mark.parametrize("what", IN_DATA)
def test_compare_fails_on_a_image_with_a_fault(tmp_path, pictures, capsys, what):
    good = read_exr(pictures[0])
    faulty = tmp_path / "faulty.exr"
    with np.errstate(invalid="ignore"):  # inf where an average leaves the silhouette
        write_exr(faulty, IN_DATA[what](good.channels), good.provenance)
    assert main(["compare", str(faulty), str(pictures[1])]) == 1, f"this passes: {what}"
    assert re.search(r"^FAIL  \w+: ", capsys.readouterr().out, re.MULTILINE)
