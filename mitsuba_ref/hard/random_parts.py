"""Random frames, transforms, shapes and views of hard scenes; their options: films, crops, lights, materials."""

import copy
import typing
from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np

from caster.cameras import CAMERAS
from mitsuba_ref.error_model.intersections import Array
from mitsuba_ref.hard.rays import Frame
from mitsuba_ref.shapes import REFERENCES
from mitsuba_ref.shapes.shape_reference import Fields
from mitsuba_ref.shapes.targets import LATTICE_STEPS, Rng, coin_flip, random_directions


def log_uniform(rng: Rng, low: float, high: float) -> float:
    """Random number between low and high, uniform in its logarithm."""
    return float(10.0 ** rng.uniform(np.log10(low), np.log10(high)))


def random_rotation(rng: Rng) -> Array:
    """(3, 3) rotation, uniformly distributed."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


def random_frame(rng: Rng, *, condition: float = 1e3, decades_of_size: float = 3.0) -> Frame:
    """On a lattice around the origin half of the time; else of any size, and up to 1e6 sizes from the origin."""
    if rng.random() < 0.5:
        return random_lattice_frame(rng)
    size = log_uniform(rng, 10.0**-decades_of_size, 10.0**decades_of_size) if rng.random() < 0.5 else 1.0
    away = size * log_uniform(rng, 1.0, 1e6) if rng.random() < 0.4 else 0.0
    return Frame(size, away * rng.normal(size=3), condition)


def random_lattice_frame(rng: Rng) -> Frame:
    """A frame in which every coordinate is a small multiple of a power of two."""
    size = float(2.0 ** rng.integers(-3, 4))
    center = size * rng.integers(-4, 5, 3) if rng.random() < 0.3 else np.zeros(3)
    return Frame(size, center, 1.0, lattice=True)


def shape_types(group: str = "") -> tuple[str, ...]:
    """Types of all registered shapes, or of one group; "bounded": those of finite extent."""
    return tuple(
        each.type_name
        for each in REFERENCES.values()
        if group in ("", *each.groups) or (group == "bounded" and "unbounded" not in each.groups)
    )


def random_shape(rng: Rng, frame: Frame, kinds: Sequence[str]) -> Fields:
    """A shape of one of these types as a scene file describes it, with a random to_world."""
    kind = str(rng.choice(kinds))
    (reference,) = (each for each in REFERENCES.values() if each.type_name == kind)
    steps = random_to_world(rng, frame)
    fields = reference.random_fields(rng, frame.lattice)
    more = copy.deepcopy(rng)  # so that all other draws stay the same
    for each in REFERENCES.values():
        if each.drawn_for == kind and more.random() < 0.25:
            kind, fields = each.type_name, each.random_fields(more, frame.lattice)
    return {"type": kind, **fields} | ({"to_world": steps} if steps else {})


def random_shapes(rng: Rng, frame: Frame, kinds: Sequence[str], most: int, least: int = 1) -> list[Fields]:
    return [random_shape(rng, frame, kinds) for _ in range(rng.integers(least, most + 1))]


def triangle_of(corners: Array) -> Fields:
    """A triangle with these corners (3, 3), in scene units."""
    return {"type": "triangle", "vertices": corners}


def random_view(rng: Rng, frame: Frame) -> Fields:
    """A view of the frame's centre, from within it up to far away; on the lattice along an axis."""
    if frame.lattice:
        away = np.eye(3)[rng.integers(3)] * rng.choice([-1.0, 1.0])
        shift = rng.integers(-8, 9, 3) / 8.0
        eye = frame.center + frame.size * (rng.integers(0, 9) * away + shift)
    else:
        away = random_directions(rng, 1)[0]
        eye = frame.center + frame.size * log_uniform(rng, 0.1, 1e4 if rng.random() < 0.2 else 10.0) * away
    up = np.eye(3)[np.argmin(np.abs(away))]  # an axis that is not along the view
    return {"eye": eye, "direction": -away, "up": up}


def random_to_world(rng: Rng, frame: Frame) -> list[Fields]:
    """Random steps that place a shape of about unit size near the centre of the frame."""
    if frame.lattice:
        return _lattice_steps(rng, frame)
    if frame.condition == 1.0 or rng.random() < 0.3:
        turn = {"axis": rng.normal(size=3), "degrees": rng.uniform(0.0, 360.0)}
        scale = frame.size * log_uniform(rng, 0.1, 1.0) * rng.choice([1.0, 1.0, -1.0])
        return [{"scale": scale}, {"rotate": turn}, {"translate": frame.near(rng, 1.5)}]
    # singular values from 1 / condition to 1; sheared, and mirrored half of the time
    condition = log_uniform(rng, 1.0, frame.condition)
    values = rng.permutation([1.0, condition ** -rng.random(), 1.0 / condition]) * rng.choice([-1.0, 1.0], 3)
    linear = frame.size * random_rotation(rng) @ np.diag(values) @ random_rotation(rng)
    return [matrix_step(linear, frame.near(rng, 1.5))]


def matrix_step(linear: Array, move: Array) -> Fields:
    """A step of to_world from a (3, 3) matrix and a translation."""
    return {"matrix": [*np.column_stack([linear, move]), [0.0, 0.0, 0.0, 1.0]]}


def _lattice_steps(rng: Rng, frame: Frame) -> list[Fields]:
    """Quarter turns, mirror images and powers of two, all without rounding."""
    steps: list[Fields] = []
    if rng.random() < 0.4:
        axis = np.eye(3)[rng.integers(3)]
        steps.append({"rotate": {"axis": axis, "degrees": 90.0 * rng.integers(1, 4)}})
    factors = frame.size * rng.choice([1.0, 1.0, 1.0, -1.0], 3)
    factors *= 2.0 ** rng.integers(-2, 3, 3) if rng.random() < 0.3 else 1.0
    if not np.all(factors == 1.0):
        steps.append({"scale": factors})
    move = frame.center + frame.size * rng.integers(-2 * LATTICE_STEPS, 2 * LATTICE_STEPS + 1, 3) / LATTICE_STEPS
    return [*steps, {"translate": move}] if move.any() else steps


# ---- options: everything that a scene file can say ----


FILMS = ((5, 3), (3, 5), (4, 4), (8, 2), (2, 8), (6, 5))  # pixels: landscape, portrait, square
MATERIALS = ("first", "second")
MAX_LIGHTS_OF_A_KIND = 5
SPECULAR: dict[str, Fields] = {
    "mirror": {"type": "mirror"},
    "steel": {"type": "mirror"},
    "glass": {"type": "glass"},
    "water": {"type": "glass", "ior": 1.33},
}
SPECULAR_SHAPES = 0.1  # fraction of the shapes that are of these materials
TEXTURED = ("rectangle", "disk", "sphere", "cylinder")  # kinds that have uv, whatever their fields
TEXTURED_SHAPES = 0.3  # fraction of these that have a texture
CHECKED = ("depth", "diffuse")  # AOVs that a table `check` names
LIGHT_FIELDS: dict[str, Callable[[Rng, Frame], Fields]] = {
    "point": lambda rng, frame: {
        "position": frame.near(rng, 4.0),
        "intensity": frame.size**2 * rng.uniform(1.0, 30.0, 3),
    },
    "directional": lambda rng, frame: {
        "direction": random_directions(rng, 1)[0],
        "irradiance": rng.uniform(0.1, 2.0, 3),
    },
    "ambient": lambda rng, frame: {"radiance": rng.uniform(0.01, 0.5, 3)},
}


def with_options(rng: Rng, frame: Frame, data: Fields) -> Fields:
    """The scene with a random choice of everything that a scene file can say."""
    materials: Fields = {
        name: {"reflectance": rng.random(3)} | _sometimes(rng, {"two_sided": True})
        for name in MATERIALS[: rng.integers(3)]
    }
    scene: Fields = {
        "film": _film(rng),
        "camera": _camera(rng, frame, data["camera"]),
        "shape": [_shape(rng, frame, i, shape, list(materials)) for i, shape in enumerate(data["shape"])],
        "light": _lights(rng, frame, data["camera"]),
        "material": materials,
        "check": {name: _sometimes(rng, {"ratio": 2.0}, 0.3) for name in CHECKED[: rng.integers(3)]},
    }
    scene |= _sometimes(rng, {"shading": {"shadows": coin_flip(rng)}})
    more, textures, colors = rng.spawn(3)
    for shape in scene["shape"]:  # half of those of the first material get a copy of it with the other two_sided
        if shape.get("material") == MATERIALS[0] and coin_flip(more):
            first = materials[MATERIALS[0]]
            materials["twin"] = {**first, "two_sided": not first.get("two_sided", False)}
            shape["material"] = "twin"
    for shape in scene["shape"]:
        if more.random() < SPECULAR_SHAPES:
            shape["material"] = str(more.choice(list(SPECULAR)))
            materials[shape["material"]] = SPECULAR[shape["material"]]
    for i, shape in enumerate(scene["shape"]):
        if shape["type"] in TEXTURED and textures.random() < TEXTURED_SHAPES:
            shape["material"] = f"texture-{i}"
            materials[shape["material"]] = {"reflectance": _texture(textures)}
        if shape["type"] in ("sphere", "cylinder"):
            shape |= _sometimes(textures, {"flip_normals": True})
        if shape["type"] in ("triangle", "mesh"):
            shape |= _sometimes(colors, {"flip_normals": True}, 0.2)
        if "vertices" in shape and colors.random() < TEXTURED_SHAPES:
            shape["material"] = f"colors-{i}"
            of = "faces" if "faces" in shape and coin_flip(colors) else "vertices"
            drawn = {"type": "mesh_colors", of: colors.random((len(shape[of]), 3))}
            materials[shape["material"]] = {"reflectance": drawn, "two_sided": coin_flip(colors)}
    return scene


def _texture(rng: Rng) -> Fields:
    """A checkerboard, or a bitmap of a few pixels, over some units of uv."""
    steps = [{"scale": [*rng.uniform(0.5, 5.0, 2), 1.0]}, {"translate": [*rng.random(2), 0.0]}]
    placed = {"to_uv": steps[: rng.integers(3)]}
    if coin_flip(rng):
        colors = (_sometimes(rng, {name: rng.random(3)}) for name in ("color0", "color1"))
        return {"type": "checkerboard"} | placed | next(colors) | next(colors)
    return {
        "type": "bitmap",
        "data": rng.random((*rng.integers(1, 4, 2), 3)),
        "filter": str(rng.choice(["bilinear", "nearest"])),
        "wrap": str(rng.choice(["repeat", "mirror", "clamp"])),
        "raw": coin_flip(rng),
    } | placed


def _lights(rng: Rng, frame: Frame, camera: Fields) -> list[Fields]:
    """Up to two lights of each kind or, rarely, MAX_LIGHTS_OF_A_KIND; the last shines from the viewer's side.

    Light from behind mostly falls on invisible surfaces, where a wrong colour would change no pixel.
    """
    lights, more = [], rng.spawn(1)[0]
    for kind, fields in LIGHT_FIELDS.items():
        drawn = [{"type": kind, **fields(rng, frame)} for _ in range(rng.integers(3))]
        if drawn and more.random() < 0.1:
            drawn[:0] = [{"type": kind, **fields(more, frame)} for _ in range(MAX_LIGHTS_OF_A_KIND - len(drawn))]
        lights += [*drawn[:-1], *(_from_the_viewer(light, frame, camera) for light in drawn[-1:])]
    return lights


def _from_the_viewer(light: Fields, frame: Frame, camera: Fields) -> Fields:
    """The light, or its mirror image through the centre, whichever shines along the camera's direction."""
    along = np.array(camera["direction"])
    if "direction" in light and np.dot(light["direction"], along) < 0.0:
        return light | {"direction": -light["direction"]}
    if "position" in light and np.dot(light["position"] - frame.center, along) > 0.0:
        return light | {"position": 2.0 * frame.center - light["position"]}
    return light


def _sometimes(rng: Rng, fields: Fields, share: float = 0.5) -> Fields:
    return fields if rng.random() < share else {}


def _film(rng: Rng) -> Fields:
    width, height = FILMS[rng.integers(len(FILMS))]
    x0, y0 = (rng.integers(2) for _ in range(2))
    x1, y1 = (max(first + 1, side - rng.integers(2)) for first, side in ((x0, width), (y0, height)))
    return {"width": width, "height": height} | _sometimes(rng, {"crop": [x0, y0, x1, y1]}, 0.6)


def _camera(rng: Rng, frame: Frame, camera: Fields) -> Fields:
    """Choose enumerated values at random, from the schema; give or omit optional fields."""
    (model,) = (each for each in CAMERAS if each.model_fields["type"].default == camera["type"])
    choices = {
        name: str(rng.choice(typing.get_args(field.annotation)))
        for name, field in model.model_fields.items()
        if typing.get_origin(field.annotation) is Literal and name != "type"
    }
    far, t_max = float(frame.size * rng.uniform(2.0, 20.0)), frame.size * log_uniform(rng, 1.0, 100.0)
    optional = {"principal_point": rng.uniform(-0.3, 0.3, 2), "far": far, "t_max": t_max}
    given = {name: value for name, value in optional.items() if name in model.model_fields and coin_flip(rng)}
    out = {**camera, **choices, **given}
    if "fov" in out and rng.random() < 0.3:
        del out["fov"]
    if "look_at" in model.model_fields and coin_flip(rng):
        way = np.array(out.pop("direction"))
        out["look_at"] = out["eye"] + frame.size * rng.uniform(1.0, 9.0) * way
    return out


def _shape(rng: Rng, frame: Frame, number: int, shape: Fields, materials: list[str]) -> Fields:
    out = dict(shape)
    if rng.random() < 0.3:
        out.pop("seed", None)
    if rng.random() < 0.4:
        out.pop("to_world", None)
        if rng.random() >= 0.4:  # a scale and a look_at, with or without its own up
            origin, target = frame.near(rng, 1.0), frame.size * rng.normal(size=3)
            view = {"origin": origin, "target": origin + target}
            view |= _sometimes(rng, {"up": rng.normal(size=3)})
            out["to_world"] = [{"scale": frame.size * rng.uniform(0.2, 1.0)}, {"look_at": view}]
    out |= _sometimes(rng, {"name": f"shape {number}"})
    return out | (_sometimes(rng, {"material": str(rng.choice(materials))}, 0.8) if materials else {})
