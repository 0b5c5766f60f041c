"""A user's Mitsuba file, opened in the child process: its geometry and its sensor's rays as Mitsuba holds them.

`mi.parser` reads the file with its includes, parameters, references and older versions. Nodes that do not concern
geometry are replaced or dropped before anything is instantiated, so that their files need not exist; each is reported.
"""

import math
import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import mitsuba
import numpy as np

from mitsuba_ref.error_model.intersections import Array
from mitsuba_ref.reference.messages import OpenRefusal, OpenRequest, OpenResponse
from mitsuba_ref.shapes.shape_reference import Fields

mi: Any = mitsuba
PLUGIN_FOLDER = str(list(mi.file_resolver())[-1]) if hasattr(mi, "file_resolver") else ""  # of 3.7 and later

DIFFUSE_LIGHTS = {"point": "intensity", "directional": "irradiance", "constant": "radiance"}
CHECKERBOARD = {"color0": 0.4, "color1": 0.2}  # Mitsuba's defaults
FILM_SIZES = {"width": 768, "height": 576}  # Mitsuba's defaults
# class in Mitsuba -> shape type of the caster
HELD = {
    "Sphere": "sphere",
    "Cylinder": "cylinder",
    "Disk": "disk",
    "LinearCurve": "linear_curve",
    "Ellipsoids": "ellipsoids",
}
MESH_COLORS = {"vertex_color": "vertices", "face_color": "faces"}  # attribute -> field of the caster's mesh_colors
MESHES = {"ply", "obj", "serialized", "rectangle", "cube", "merge"}  # plugins
VIEW, VIEW_FROM, VIEW_FOV, VIEW_SIZE = "no sensor", np.array([0.4417, 0.3571, 0.8231]), 41.3, (256, 256)
ROBUST = "embree_use_robust_intersections"
MAX_TEXELS = 2**24  # of a bitmap, 12 bytes each
EXACT_TEXELS = {"format": "variant", "accel": False}  # not of 8 or 16 bits, nor filtered by the hardware of a GPU


class Parsed(NamedTuple):
    """A parsed file without whatever does not concern geometry."""

    config: Any
    state: Any
    dropped: Counter[str]  # what was dropped or replaced
    unlit: list[str]  # why diffuse cannot be compared
    names: dict[int, str]  # ids in the file, by node
    refers: dict[int, list[int]]  # nodes that a node refers to, in their order; instantiation removes them
    materials: dict[int, Fields | None]  # of each bsdf that a shape has, as the caster has it
    textures: dict[int, Fields]  # of these materials, by node: without colours, but with their place
    colored: dict[str, Fields]  # materials of shapes by name, with the colours of their textures

    def instantiate(self) -> Any:
        loaded = mi.parser.instantiate(self.config, self.state)
        return loaded[0] if isinstance(loaded, list) else loaded

    def nodes(self, *kinds: Any) -> Iterator[tuple[int, Any]]:
        """(number, properties) of the nodes of these kinds."""
        return ((i, node.props) for i, node in enumerate(self.state.nodes) if node.type in kinds)

    def place(self, number: int) -> str:
        """FILE:LINE:COLUMN of a node."""
        where = str(mi.parser.file_location(self.state, self.state.nodes[number]))
        return where.replace(" (line ", ":").replace(", col ", ":").removesuffix(")")

    def children(self, number: int, *kinds: Any) -> list[int]:
        """Numbers of the nodes of these kinds that a node refers to, in their order."""
        return [to for to in self.refers[number] if self.state.nodes[to].type in kinds]


# ---- parsing, and what does not concern geometry


def parse(request: OpenRequest, variant: str) -> Parsed:
    """Parse a file. Raises RuntimeError with Mitsuba's message where it is refused."""
    mi.set_variant(variant)
    if not hasattr(mi, "parser"):
        raise RuntimeError(f"Mitsuba {mi.__version__} has no mi.parser: Mitsuba files need 3.7 or later")
    resolver = mi.FileResolver()  # of this file alone: <path> adds folders to it
    resolver.clear()
    for folder in (os.path.dirname(request.file), *request.folders, PLUGIN_FOLDER):
        resolver.append(folder)
    mi.set_file_resolver(resolver)
    config = mi.parser.ParserConfig(variant)
    config.merge_meshes = config.merge_equivalent = False  # would lose ids
    state = mi.parser.parse_file(config, request.file, **request.parameters)
    mi.parser.transform_upgrade(config, state)
    mi.parser.transform_resolve(config, state)
    names = {i: node.props.id() for i, node in enumerate(state.nodes)}
    refers = {i: [to for _, to in _references(node.props)] for i, node in enumerate(state.nodes)}
    parsed = Parsed(config, state, Counter(), [], names, refers, {}, {}, {})
    _keep_geometry(parsed, request)
    return parsed


def _references(props: Any) -> list[tuple[str, int]]:
    """(name, number of the node) of what a node refers to."""
    kind = mi.Properties.Type.ResolvedReference
    return [(name, props[name].index()) for name in props.keys() if props.type(name) == kind]  # noqa: SIM118


def _keep_geometry(parsed: Parsed, request: OpenRequest) -> None:
    kind = mi.ObjectType
    kept = {
        kind.Scene: (kind.Shape, kind.Sensor, kind.Emitter),
        kind.Shape: (kind.Shape, kind.Sensor, kind.BSDF),
        kind.Sensor: (kind.Shape, kind.Sensor, kind.Film, kind.Sampler),
        kind.BSDF: (kind.BSDF, kind.Texture),
    }
    nodes = parsed.state.nodes
    used = {bsdf for i, _ in parsed.nodes(kind.Shape) for bsdf in parsed.children(i, kind.BSDF)}
    parsed.materials.update((i, material(parsed, i)) for i in sorted(used))
    for i in range(len(nodes)):
        node, props = nodes[i], nodes[i].props
        if node.type == kind.Film:
            parsed.dropped.update([] if props.plugin_name() == "hdrfilm" else [f"film {props.plugin_name()}"])
            node.props = _film(props, request.size)
            continue
        for name, to in _references(props):
            if nodes[to].type not in kept.get(node.type, ()) or not _is_kept(parsed, to):
                props.remove_property(name)
                parsed.refers[i].remove(to)
                if node.type != kind.Scene or nodes[to].type not in (kind.BSDF, kind.Texture):  # definitions
                    what = str(nodes[to].type).rpartition(".")[2].lower()
                    parsed.dropped[f"{what} {nodes[to].props.plugin_name()}"] += 1
        if node.type == kind.Sensor and request.size and not parsed.children(i, kind.Film):
            film = mi.parser.SceneNode()
            film.type, film.props = kind.Film, _film(mi.Properties("hdrfilm"), request.size)
            props["film"] = mi.Properties.ResolvedReference(len(nodes))
            node.props = props
            nodes.append(film)
            node, props = nodes[i], nodes[i].props  # where they lie now
        if node.type == kind.Scene and request.robust:
            props.remove_property(ROBUST)
            props[ROBUST] = True
        if node.type == kind.Texture and props.plugin_name() == "bitmap":
            for name, value in EXACT_TEXELS.items():
                props.remove_property(name)
                props[name] = value
        if node.type in (kind.Shape, kind.Emitter, kind.Sensor):
            props.set_id(str(i))  # one each, by which loaded objects are found again
        node.props = props
    for i in (i for i, found in parsed.materials.items() if found is None):
        plugin = nodes[i].props.plugin_name()
        parsed.dropped[f"bsdf {plugin}"] += 1
        parsed.unlit.append(f"{plugin} at {parsed.place(i)}")
        nodes[i].props = mi.Properties("diffuse")


def _is_kept(parsed: Parsed, number: int) -> bool:
    """Whether a node stays: lights and textures only where the judge has them; ambient light is added apart."""
    node = parsed.state.nodes[number]
    if node.type == mi.ObjectType.Texture:
        return number in parsed.textures
    if node.type != mi.ObjectType.Emitter:
        return True
    if found := light(node.props):
        return bool(found["type"] != "ambient")
    if color(node.props, "radiance") != [0.0] * 3:
        parsed.unlit.append(f"{node.props.plugin_name()} at {parsed.place(number)}")
    return False


def _film(props: Any, size: Sequence[int] | None) -> Any:
    """A film of the same pixels; of another size, with its crop scaled and rounded outwards."""
    film = mi.Properties("hdrfilm")
    old = {name: props.get(name, default) for name, default in FILM_SIZES.items()}
    new = dict(zip(FILM_SIZES, size, strict=True)) if size else old
    for name in FILM_SIZES:
        film[name] = new[name]
    for axis, side in (("x", "width"), ("y", "height")):
        offset, crop = f"crop_offset_{axis}", f"crop_{side}"
        if props.has_property(offset) or props.has_property(crop):
            low = props.get(offset, 0)
            high = low + props.get(crop, old[side] - low)
            start, end = low * new[side] // old[side], -(-high * new[side] // old[side])
            film[offset], film[crop] = start, end - start
    return film


def color(props: Any, name: str, default: float = 1.0) -> list[float] | None:
    """r, g, b of a constant colour; None for a texture or a spectrum."""
    if not props.has_property(name):
        return [default] * 3
    kind, value = props.type(name), props[name]
    if kind == mi.Properties.Type.Float:
        return [float(value)] * 3
    if kind == mi.Properties.Type.Color:
        return [float(each) for each in value]
    return None


def material(parsed: Parsed, number: int) -> Fields | None:
    """A material as the caster has it; None for any other."""
    props = parsed.state.nodes[number].props
    plugin = props.plugin_name()
    if plugin == "twosided":
        inner = parsed.children(number, mi.ObjectType.BSDF)
        found = material(parsed, inner[0]) if len(inner) == 1 else None
        return found | {"two_sided": True} if found and "reflectance" in found else None
    if plugin == "diffuse":
        pictures = parsed.children(number, mi.ObjectType.Texture)
        reflectance = texture(parsed, pictures[0]) if pictures else color(props, "reflectance", 0.5)
        return {"reflectance": reflectance} if reflectance else None
    if plugin == "conductor" and props.get("material", "") == "none":
        return {"type": "mirror"}
    if plugin == "dielectric":
        indices = {name: props[name] for name in ("int_ior", "ext_ior") if props.has_property(name)}
        return {"type": "glass", "ior": _number(mi.traverse(mi.load_dict({"type": plugin, **indices}))["eta"])}
    return None


def texture(parsed: Parsed, number: int) -> Fields | None:
    """A texture as the caster has it; None, with a reason in `unlit`, for any other.

    Colours are named by the field that they are for and the parameter that Mitsuba has them in.
    """
    props = parsed.state.nodes[number].props
    plugin, matrix = props.plugin_name(), np.eye(4)
    found: Fields | None = None
    if plugin == "checkerboard":
        colors = {name: color(props, name, default) for name, default in CHECKERBOARD.items()}
        found = colors if all(colors.values()) else None
    elif plugin == "mesh_attribute" and (name := props["name"]) in MESH_COLORS and props.get("scale", 1.0) == 1.0:
        return parsed.textures.setdefault(number, {"type": "mesh_colors", "colors": (MESH_COLORS[name], name)})
    elif plugin == "bitmap" and _is_picture(_path(props)):
        found = {"filter": props.get("filter_type", "bilinear"), "wrap": props.get("wrap_mode", "repeat")}
        found["colors"] = "data", "reflectance.data"
    if props.has_property("to_uv"):  # of which Mitsuba, too, takes no more than u and v
        matrix[:2, [0, 1, 3]] = np.array(_matrix(props["to_uv"]))[:2, [0, 1, 3]]
    if found and matrix[0, 0] * matrix[1, 1] != matrix[0, 1] * matrix[1, 0]:
        return parsed.textures.setdefault(number, {"type": plugin, **found, "to_uv": [{"matrix": matrix.tolist()}]})
    unread = f"cannot read {props.get('filename', 'the file')} of " if plugin == "bitmap" and found is None else ""
    parsed.unlit.append(f"{unread}texture {plugin} at {parsed.place(number)}")
    return None


def _is_picture(path: str) -> bool:
    try:
        return os.path.isfile(path) and bool(mi.Bitmap(path))
    except RuntimeError:
        return False


def light(props: Any) -> Fields | None:
    """A light as the caster has it; None for any other."""
    plugin = props.plugin_name()
    if plugin not in DIFFUSE_LIGHTS or (strength := color(props, DIFFUSE_LIGHTS[plugin])) is None:
        return None
    if plugin == "constant":
        return {"type": "ambient", "radiance": strength}
    matrix = np.array(_matrix(props["to_world"])) if props.has_property("to_world") else np.eye(4)
    place, column = ("position", 3) if plugin == "point" else ("direction", 2)
    where = [float(x) for x in props[place]] if props.has_property(place) else matrix[:3, column].tolist()
    return {"type": plugin, place: where, DIFFUSE_LIGHTS[plugin]: strength}


# ---- what Mitsuba has loaded


def load(request: OpenRequest, variant: str) -> Any:
    """The scene of a file, for tracing."""
    parsed = parse(request, variant)
    instanced = any(props.plugin_name() == "instance" for _, props in parsed.nodes(mi.ObjectType.Shape))
    if instanced and variant != "scalar_rgb":
        raise RuntimeError("instances are traced by scalar_rgb alone: others do not name the shape of the group")
    return parsed.instantiate()


def open_file(request: OpenRequest, sensor_rays: Any) -> OpenResponse | OpenRefusal:
    """Geometry, sensor and lights of a file. Raises RuntimeError with Mitsuba's message where it refuses the file."""
    parsed, kind = parse(request, "scalar_rgb"), mi.ObjectType
    if missing := list(_missing_files(parsed)):
        return OpenRefusal(missing=missing)
    variant = "scalar_rgb"
    if {props.plugin_name() for _, props in parsed.nodes(kind.Shape)} <= MESHES:
        variant = request.variant
        parsed = parse(request, variant)
    scene = parsed.instantiate()
    sensors = scene.sensors()
    if request.sensor >= max(1, len(sensors)):
        return OpenRefusal(problem=f"sensor {request.sensor}: the file has {len(sensors)}, counted from 0")
    sensor = sensors[request.sensor] if sensors else _view_of_all(scene, request.size)
    loaded = {shape.id(): shape for shape in scene.shapes()} | _loaded_groups(parsed, request, variant)
    shapes: list[Fields] = []
    number_of: dict[int, int] = {}
    for i, props in parsed.nodes(kind.Shape):
        if (shape := loaded.get(str(i))) and props.plugin_name() != "instance":
            number_of[i] = len(shapes)
            about = {"plugin": props.plugin_name(), "place": parsed.place(i)}
            shapes.append(_shape(shape) | about | {"material": _material_of(parsed, i, shape)})
    paths = [path for _, _, path in _files(parsed, kind.Shape, kind.Texture)]
    (width, height), (x, y) = sensor.film().size(), sensor.film().crop_offset()
    across, down = sensor.film().crop_size()
    crop = None if (across, down) == (width, height) else [x, y, x + across, y + down]
    return OpenResponse(
        rays=sensor_rays(sensor, variant),
        shapes=shapes,
        placed=list(_placements(parsed, loaded, number_of)),
        materials=parsed.colored,
        film={"width": width, "height": height, "crop": crop},
        camera=_camera(parsed.state.nodes[int(sensor.id())].props if sensors else mi.Properties(VIEW), sensor),
        lights=[found for _, props in parsed.nodes(kind.Emitter) if (found := light(props))],
        unlit=parsed.unlit,
        dropped=dict(parsed.dropped),
        files=[*map(str, parsed.state.files), *(path for path in paths if os.path.isfile(path))],
        variant=variant,
        robust=bool(parsed.state.nodes[0].props.get(ROBUST, False)),
    )


def _view_of_all(scene: Any, size: Sequence[int] | None) -> Any:
    """A sensor that sees the whole scene, for a file without any."""
    box = scene.bbox() if scene.shapes() else mi.ScalarBoundingBox3f(0.0)
    center, radius = np.array(box.center()), math.hypot(*map(float, box.extents())) / 2.0 or 1.0
    to_world = mi.ScalarTransform4f().look_at(center + 3.0 * radius * VIEW_FROM, center, [0.0, 1.0, 0.0])
    film = dict(zip(FILM_SIZES, size or VIEW_SIZE, strict=True)) | {"type": "hdrfilm"}
    planes = {"near_clip": radius, "far_clip": 5.0 * radius}
    return mi.load_dict({"type": "perspective", "fov": VIEW_FOV, "to_world": to_world, "film": film, **planes})


def _material_of(parsed: Parsed, number: int, shape: Any) -> str | None:
    """The name of a shape's material, which it adds to `colored`; None for the default and what the caster has not."""
    bsdfs = parsed.children(number, mi.ObjectType.BSDF)
    if not bsdfs or not (found := parsed.materials[bsdfs[0]]):
        return None
    bsdf, texture = bsdfs[0], found.get("reflectance")
    name = parsed.names[bsdf] or f"material-{bsdf}"
    if isinstance(texture, dict) and "colors" in texture:
        of_mesh = texture["type"] == "mesh_colors"
        name = f"{name} of shape {number}" if of_mesh else name  # each mesh has its own
        if name not in parsed.colored:
            texture = dict(texture)
            field, parameter = texture.pop("colors")
            colors = _colors(mi.traverse(shape if of_mesh else shape.bsdf()), parameter)
            if colors is None:
                parsed.materials[bsdf] = None
                parsed.unlit.append(f"colours that are missing, not from 0 to 1, or too many, in {parsed.place(bsdf)}")
                return None
            found = found | {"reflectance": texture | {field: colors}}
    parsed.colored.setdefault(name, found)
    return name


def _colors(loaded: Any, ending: str) -> Array | None:
    """Colours (..., 3) float32 of the parameter with this ending; None if unusable."""
    for name, value in loaded:
        if name.endswith(ending):
            data = np.array(value, np.float32)
            data = data.reshape(-1, 3) if data.ndim == 1 else np.broadcast_to(data, (*data.shape[:2], 3))
            if 0 < data.size <= 3 * MAX_TEXELS and data.min() >= 0.0 and data.max() <= 1.0:
                return data
    return None


def _path(props: Any) -> str:
    """Where the file of a node is, or its name if it is nowhere."""
    return str(mi.file_resolver().resolve(props.get("filename", "")))


def _files(parsed: Parsed, *kinds: Any) -> Iterator[tuple[int, str, str]]:
    """(node, name in the file, path) of the file of each shape and picture that has one."""
    for i, props in parsed.nodes(*kinds):
        if props.has_property("filename"):
            yield i, props["filename"], _path(props)


def _missing_files(parsed: Parsed) -> Iterator[str]:
    folders = [str(folder) for folder in mi.file_resolver()][:-1]
    for i, name, file in _files(parsed, mi.ObjectType.Shape):
        if not os.path.isfile(file):
            tried = ", ".join(dict.fromkeys(os.path.join(folder, name) for folder in folders))
            yield f"{parsed.place(i)}: cannot read {name} (tried {tried})"


def _loaded_groups(parsed: Parsed, request: OpenRequest, variant: str) -> dict[str, Any]:
    """The shapes of groups, which Mitsuba does not show, loaded by themselves."""
    shape = mi.ObjectType.Shape
    groups = [i for i, props in parsed.nodes(shape) if props.plugin_name() == "shapegroup"]
    if not groups:
        return {}
    again, alone = parse(request, variant), mi.Properties("scene")
    for child in dict.fromkeys(child for group in groups for child in parsed.children(group, shape)):
        alone[f"_arg_{child}"] = mi.Properties.ResolvedReference(child)
    again.state.nodes[0].props = alone
    return {each.id(): each for each in again.instantiate().shapes()}


def _leaves(parsed: Parsed, numbers: Iterable[int]) -> Iterator[int]:
    """Shapes by number, with the children of a `merge` in its place."""
    for number in numbers:
        merged = parsed.state.nodes[number].props.plugin_name() == "merge"
        yield from _leaves(parsed, parsed.children(number, mi.ObjectType.Shape)) if merged else [number]


# Key in Mitsuba's answers, number of the shape, name, matrix of the instance
Placement = tuple[str, int, str, list[list[float]] | None]


def _placements(parsed: Parsed, loaded: Mapping[str, Any], number_of: dict[int, int]) -> Iterator[Placement]:
    """Every shape of the scene; an instance has those of its group."""
    shape = mi.ObjectType.Shape
    for i in dict.fromkeys(_leaves(parsed, parsed.children(0, shape))):
        if i in number_of:
            yield str(i), number_of[i], parsed.names[i], None
        elif parsed.state.nodes[i].props.plugin_name() == "instance":
            matrix = _matrix(mi.traverse(loaded[str(i)])["to_world"])
            for group in parsed.children(i, shape):
                for child in _leaves(parsed, parsed.children(group, shape)):
                    name = f"{parsed.names[i] or f'instance-{i}'}/{parsed.names[child] or child}"
                    yield f"{i}/{child}", number_of[child], name, matrix


def _matrix(transform: Any) -> list[list[float]]:
    return np.array(transform.matrix, np.float64).reshape(4, 4).tolist()


def _number(value: Any) -> float:
    """A number of Mitsuba, in any variant."""
    return float(np.array(value).ravel()[0])


def _shape(shape: Any) -> Fields:
    """The record of a loaded shape.

    rows, (n, columns) float32: vertices as vertices_of; control points with their radii; centres, scales and
    quaternions of ellipsoids. faces, (m, 3): of a mesh.
    """
    kind = "mesh" if shape.is_mesh() else HELD.get(shape.class_name(), "")
    record: Fields = {"kind": kind}
    if not kind:
        return record
    record["flipped"] = bool(shape.has_flipped_normals())
    if kind == "mesh":
        record["smooth"] = bool(shape.has_vertex_normals() and not shape.has_face_normals())
        record["textured"] = bool(shape.has_vertex_texcoords())
        return record | {"rows": vertices_of(shape), "faces": faces_of(shape)}
    numbers = mi.traverse(shape)
    if kind == "linear_curve":
        rows = np.array(numbers["control_points"], np.float32).reshape(-1, 4)
        ends = np.setdiff1d(np.arange(len(rows)), np.array(numbers["segment_indices"]))  # where no segment starts
        return record | {"rows": rows, "counts": np.diff(ends, prepend=-1).tolist()}
    if kind == "ellipsoids":
        record |= {"extent": _number(numbers["extent"]), "clamped": bool(numbers["extent_adaptive_clamping"])}
        return record | {"rows": np.array(numbers["data"], np.float32).reshape(-1, 10)}
    record["matrix"] = matrix = _matrix(numbers["to_world"])
    if kind == "sphere":  # from its centre to its surface
        ray = mi.Ray3f([row[3] for row in matrix[:3]], [1.0, 0.0, 0.0])
        record["radius"] = float(shape.ray_intersect_preliminary(ray).t)
    return record


def faces_of(mesh: Any) -> Array:
    """(m, 3) int32: numbers of vertices."""
    return np.array(mesh.faces_buffer(), np.int32).reshape(-1, 3)


def vertices_of(mesh: Any) -> Array:
    """(n, 8) float32: position, normal and uv of each vertex; missing ones are 0."""
    rows = np.zeros((mesh.vertex_count(), 8), np.float32)
    for name, columns in (("positions", slice(0, 3)), ("normals", slice(3, 6)), ("texcoords", slice(6, 8))):
        values = np.array(getattr(mesh, f"vertex_{name}_buffer")(), np.float32)
        if values.size:
            rows[:, columns] = values.reshape(len(rows), -1)
    return rows


def _camera(props: Any, sensor: Any) -> Fields:
    """Numbers of a sensor by name, beside its plugin, its matrix and the field of view that Mitsuba computed."""
    kinds = mi.Properties.Type
    plain = (kinds.Float, kinds.Integer, kinds.String)
    numbers = {name: props[name] for name in props.keys() if props.type(name) in plain}  # noqa: SIM118
    matrix = _matrix(props["to_world"]) if props.has_property("to_world") else np.eye(4).tolist()
    loaded = mi.traverse(sensor)
    computed = {"x_fov": _number(loaded["x_fov"])} if "x_fov" in loaded else {}
    return {**numbers, **computed, "plugin": props.plugin_name(), "to_world": matrix}
