"""The input of both sides: the caster's camera rays in float32, from the near plane on, and scenes as Mitsuba's XML."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree.ElementTree import Comment, Element, fromstring, indent, tostring

import numpy as np

from caster.description.input_files import read_input
from caster.description.transform import row_lengths
from caster.geometry.packing import Packed, concatenate_parts, packed
from caster.geometry.world_space import as_float32
from caster.rendering.images import camera_rays
from caster.scene.model import Material, Scene
from caster.scene.textures import Bitmap, MeshColors
from caster.system.atomic_files import check_folder, write_bytes, write_text
from mitsuba_ref.cameras import ClipRange, reference_of_camera
from mitsuba_ref.error_model.intersections import Array, ceil_log2
from mitsuba_ref.error_model.scene_model import InstancedModel, SceneModel
from mitsuba_ref.reference.originals import original_of
from mitsuba_ref.scene_xml.elements import ShapeWriter, XmlElement, format_floats, matrix_element
from mitsuba_ref.shapes import kind_of, reference_of

# ---- shared rays ----

# Error of the length of a direction that was normalised in float32: some roundings of 2^-24.
UNIT_LENGTH_ATOL = 2.0**-20


class SharedRays(NamedTuple):
    """One ray per pixel, row by row. Camera rays hold float32 values, so neither side rounds them again.

    Rays of a list (mitsuba_ref/subjects/ray_files.py) are laid out as a film and may hold float64 values.
    """

    o: Array  # (n, 3) float32; float64 for a list
    d: Array  # (n, 3)
    t_max: Array  # (n,) lengths of d; negative: no ray
    start: Array  # (n,) float64, distance from the eye to o
    t_min: Array | float = 0.0  # (n,) float64 of a list; a hit has t_min < t <= t_max

    @property
    def is_list(self) -> bool:
        """Whether the rays come from a list, not from a camera."""
        return isinstance(self.t_min, np.ndarray)

    def rows(self, rows: Array | slice) -> "SharedRays":
        """Some of them."""
        arrays: dict[str, Any] = {name: a[rows] for name, a in self._asdict().items() if isinstance(a, np.ndarray)}
        return self._replace(**arrays)

    @property
    def reference_exponent(self) -> Array:
        """(n,) int. Mitsuba gets directions d / 2^exponent, no longer than 1, and its t counts in their lengths.

        Its spheres and ellipsoids use the distance to the centre as t, and lose digits where d is longer than 1.
        """
        length = row_lengths(self.d.astype(np.float64))
        return np.where(np.abs(length - 1.0) <= UNIT_LENGTH_ATOL, 0, ceil_log2(length))

    def for_reference(self) -> "SharedRays":
        """The rays as Mitsuba traces them: float32, starting at t_min, which it lacks. Camera rays are so already."""
        if not isinstance(self.t_min, np.ndarray):
            return self
        o = _float32(self.o + self.t_min[:, None] * self.d)
        with np.errstate(invalid="ignore"):
            left = np.where(self.t_max < 0.0, -1.0, np.ldexp(self.t_max - self.t_min, self.reference_exponent))
        d = np.ldexp(self.d, -self.reference_exponent[:, None])
        return SharedRays(o, _float32(d), _float32(left), self.start)

    def t_of_reference(self, t: Array) -> Array:
        """(n,) Mitsuba's t converted to t along these rays."""
        return t if not self.is_list else np.ldexp(t, -self.reference_exponent) + self.t_min


def endless_rays(o: Array, d: Array) -> SharedRays:
    """Rays from o (n, 3) along d without limits, in float32."""
    return SharedRays(_float32(o), _float32(d), np.full(len(o), np.inf, np.float32), np.zeros(len(o)))


def shared_rays(scene: Scene) -> SharedRays:
    """Camera rays of a scene, from the near plane on, since Mitsuba has no t_min; of a Mitsuba file, its sensor's."""
    if original := original_of(scene):
        rows = original.rows(scene.film)
        numbers = np.ascontiguousarray(original.opened.rays[rows])
        return SharedRays(numbers[:, :3], numbers[:, 3:6], numbers[:, 6], original.start[rows])
    rays = camera_rays(scene)
    o = rays.o + rays.t_min[:, None] * rays.d
    left = np.where(rays.t_max < 0.0, -1.0, rays.t_max - rays.t_min)
    return SharedRays(_float32(o), _float32(rays.d), _float32(left), rays.t_min)


def _float32(a: Array) -> Array:
    with np.errstate(over="ignore"):  # values beyond float32 become inf, which the caster refuses
        return np.ascontiguousarray(a, np.float32)


def pixel_of(scene: Scene, row: int) -> tuple[int, int]:
    """Film coordinates x, y of the window's pixel number `row`."""
    x0, y0, x1, _y1 = scene.film.window
    return x0 + row % (x1 - x0), y0 + row // (x1 - x0)


def pixel_centers(scene: Scene) -> tuple[Array, Array]:
    """x and y of the window's pixel centres, row by row."""
    x0, y0, x1, y1 = scene.film.window
    y, x = np.meshgrid(np.arange(y0, y1) + 0.5, np.arange(x0, x1) + 0.5, indexing="ij")
    return x.ravel(), y.ravel()


# ---- scenes for Mitsuba ----

# Clip planes for cameras without any, in units of the scene's extent from the origin.
NEAR_PER_REACH, FAR_PER_REACH = 2.0**-20, 2.0**10


def packed_float32(scene: Scene) -> Packed:
    """The packed scene that is judged against the reference, cached with the scene."""
    return packed(scene, as_float32)


def model_of(scene: Scene, rays: SharedRays, packed: Packed | None = None) -> SceneModel:
    """The judge's model of packed geometry, float32 unless given; patches in place of planes are cut to these rays."""
    packed = packed_float32(scene) if packed is None else packed
    references = [reference_of(shape) for shape in scene.shapes]
    real = rays.t_max >= 0.0
    o, d = rays.o[real].astype(np.float64), rays.d[real].astype(np.float64)
    parts = tuple(reference.stand_in(part, o, d) for reference, part in zip(references, packed.parts, strict=True))
    like = [
        [part for part, own in zip(parts, packed.parts, strict=True) if type(own) is type(kind.prims)]
        for kind in packed.kinds
    ]
    kinds = tuple(map(concatenate_parts, like))
    model = replace(own_model(packed), parts=parts, kinds=kinds)
    if original := original_of(scene):
        models = tuple(
            each._replace(uv=each.uv._replace(reference=each.uv.loaded or each.uv.reference)) for each in model.models
        )
        return InstancedModel(packed, parts, kinds, models, original.condition)
    return model


def described_model(scene: Scene) -> SceneModel | None:
    """The model with the scene's float64 values and real planes; None if all its values are float32 values."""
    described, rounded = packed(scene), packed_float32(scene)
    if all(
        np.array_equal(a, b)
        for ours, theirs in zip(described.parts, rounded.parts, strict=True)
        for a, b in zip(ours, theirs, strict=True)
    ):
        return None
    return own_model(described)


def own_model(packed: Packed) -> SceneModel:
    """The model of the primitives themselves, without stand-ins."""
    kinds = tuple(kind.prims for kind in packed.kinds)
    return SceneModel(packed, packed.parts, kinds, tuple(kind_of(prims).model for prims in kinds))


@dataclass(frozen=True)
class SceneExport:
    """A scene for Mitsuba: XML, and files of meshes and pictures beside it. notes: differences from the scene."""

    xml: str
    meshes: dict[str, bytes]
    notes: list[str]

    def write(self, folder: Path) -> Path:
        """Write everything into a folder, creating it; returns the path of the XML. Raises OutputError."""
        check_folder(folder)
        for file, content in self.meshes.items():
            check_folder((folder / file).parent)
            write_bytes(folder / file, content)
        path = folder / "scene.xml"
        write_text(path, self.xml)
        return path


def export_scene(scene: Scene) -> SceneExport:
    """XML and meshes of a scene, for use with plain Mitsuba."""
    return export(scene, model_of(scene, shared_rays(scene)))


def export(scene: Scene, model: SceneModel, *, robust: bool = True) -> SceneExport:
    """XML and meshes of packed geometry. robust: use Embree's mode that keeps meshes closed."""
    out = ShapeWriter(
        lambda shape: bsdf_element(scene.material_of(shape), out.meshes), lambda shape: scene.material_of(shape).texture
    )
    shapes = []
    for name, shape, part in zip(shape_ids(scene), scene.shapes, model.parts, strict=True):
        out.name = name
        shapes += reference_of(shape).to_xml(out, shape, part)
    sensor = reference_of_camera(scene.camera).to_xml(scene.camera, scene.film, clip_range(scene, model))
    if sensor is None:
        out.notes.append(f"no sensor: Mitsuba has no {scene.camera.type} camera, so rays are handed over")
    root: XmlElement = fromstring(DOCUMENT)
    if not robust:
        root[0].set("value", "false")
    root[:0] = [Comment(f" {note.replace('--', '- -')} ") for note in out.notes]
    if sensor is not None:
        sensor.extend([film_element(scene), fromstring(SAMPLER)])
        root.append(sensor)
    root.extend([*map(light_element, scene.lights), *shapes])
    indent(root, "    ")
    return SceneExport(tostring(root, encoding="unicode") + "\n", out.meshes, out.notes)


def shape_ids(scene: Scene) -> list[str]:
    """One id per shape: its name, unless Mitsuba would read it as a parameter or this program as a part."""
    return [f"shapes[{i}]" if "$" in name or name.endswith("}") else name for i, name in enumerate(scene.shape_names())]


def clip_range(scene: Scene, model: SceneModel) -> ClipRange:
    """Clip planes that cut nothing off, from the farthest corner of bounded primitives and the eye."""
    reach = float(np.abs(scene.camera.eye).max())
    for corners in model.boxes:
        reach = max(reach, float(np.abs(corners).max(initial=0.0, where=np.isfinite(corners))))
    reach = reach or 1.0  # everything is at the origin
    return ClipRange(NEAR_PER_REACH * reach, FAR_PER_REACH * reach)


# ---- the document ----

# Without Embree's robust mode, rays slip through edges of meshes. The integrator is for plain Mitsuba: radiance, and
# the quantities that are compared.
DOCUMENT = """<scene version="3.0.0">
    <boolean name="embree_use_robust_intersections" value="true"/>
    <integrator type="aov">
        <string name="aovs" value="depth:depth,normal:geo_normal,shading_normal:sh_normal,position:position"/>
        <integrator type="direct" name="radiance">
            <integer name="emitter_samples" value="1"/>
            <integer name="bsdf_samples" value="0"/>
        </integrator>
    </integrator>
</scene>"""

# One unfiltered float32 sample at each pixel's centre.
FILM = """<film type="hdrfilm">{sizes}
    <string name="pixel_format" value="rgba"/>
    <string name="component_format" value="float32"/>
    <rfilter type="box"/>
</film>"""
SAMPLER = """<sampler type="stratified">
    <integer name="sample_count" value="1"/>
    <boolean name="jitter" value="false"/>
</sampler>"""
LIGHT = """<emitter type="{type}">
    <{tag} name="{place}" value="{where}"/>
    <rgb name="{strength}" value="{rgb}"/>
</emitter>"""
LIGHT_FIELDS = {"point": ("point", "position", "intensity"), "directional": ("vector", "direction", "irradiance")}


def bsdf_element(material: Material, files: dict[str, bytes]) -> XmlElement:
    """The <bsdf> of a material; pictures are added to `files`."""
    if material.type == "mirror":
        return fromstring('<bsdf type="conductor"><string name="material" value="none"/></bsdf>')
    if material.type == "glass":
        inner = f'<float name="int_ior" value="{material.ior!r}"/>'
        return fromstring(f'<bsdf type="dielectric">{inner}<float name="ext_ior" value="1"/></bsdf>')
    diffuse = Element("bsdf", type="diffuse")
    texture = material.texture
    diffuse.append(texture_element(texture, files) if texture else rgb_element("reflectance", material.color))
    if not material.two_sided:
        return diffuse
    both = Element("bsdf", type="twosided")
    both.append(diffuse)
    return both


def rgb_element(name: str, color: Sequence[float]) -> XmlElement:
    return Element("rgb", name=name, value=format_floats(color))


# Stored as 8 bits or looked up by the hardware of a GPU, texels would have other values between their centres.
BITMAP = """<texture type="bitmap" name="reflectance">
    <string name="filename" value="{file}"/>
    <string name="filter_type" value="{filter}"/>
    <string name="wrap_mode" value="{wrap}"/>
    <boolean name="raw" value="{raw}"/>
    <string name="format" value="variant"/>
    <boolean name="accel" value="false"/>
</texture>"""
MESH_COLORS = """<texture type="mesh_attribute" name="reflectance">
    <string name="name" value="{name}"/>
</texture>"""


def texture_element(texture: Any, files: dict[str, bytes]) -> XmlElement:
    """A texture. A PNG file is handed over as it is, an array as a PFM file of float32 values."""
    if isinstance(texture, MeshColors):  # they are in the PLY file
        name = "face_color" if texture.vertices is None else "vertex_color"
        return fromstring(MESH_COLORS.format(name=name))
    if isinstance(texture, Bitmap):
        if texture.file is not None:
            content, suffix, raw = read_input(texture.file, "picture"), ".png", texture.raw
        else:
            height, width, _ = texture.texels.shape  # rows from the last one on
            head, rows = b"PF\n%d %d\n-1.0\n" % (width, height), texture.texels[::-1]
            content, suffix, raw = head + rows.astype("<f4").tobytes(), ".pfm", True
        file = f"textures/{hashlib.sha256(content).hexdigest()[:16]}{suffix}"
        files[file] = content
        text = BITMAP.format(file=file, filter=texture.filter, wrap=texture.wrap, raw=str(raw).lower())
        element: XmlElement = fromstring(text)
    else:
        element = Element("texture", type="checkerboard", name="reflectance")
        element.extend(rgb_element(name, getattr(texture, name)) for name in ("color0", "color1"))
    linear, move = np.eye(3), np.zeros(3)
    linear[:2, :2], move[:2] = texture.uv_matrix[:, :2], texture.uv_matrix[:, 2]
    transform = matrix_element(move, linear)
    transform.set("name", "to_uv")
    element.append(transform)
    return element


def light_element(light: Any) -> XmlElement:
    """A point or directional light. Ambient light is not exported: it is added separately on both sides."""
    if light.type == "ambient":
        return Comment(" ambient light is added apart, as reflectance times radiance ")
    tag, place, strength = LIGHT_FIELDS[light.type]
    where, rgb = (format_floats(getattr(light, name)) for name in (place, strength))
    return fromstring(LIGHT.format(type=light.type, tag=tag, place=place, where=where, strength=strength, rgb=rgb))


def film_element(scene: Scene) -> XmlElement:
    x0, y0, x1, y1 = scene.film.window
    sizes = {"width": scene.film.width, "height": scene.film.height}
    if scene.film.crop is not None:
        sizes |= {"crop_offset_x": x0, "crop_offset_y": y0, "crop_width": x1 - x0, "crop_height": y1 - y0}
    integers = "".join(f'<integer name="{name}" value="{value}"/>' for name, value in sizes.items())
    return fromstring(FILM.format(sizes=integers))
