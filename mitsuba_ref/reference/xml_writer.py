"""Writer of Mitsuba scenes: XML elements and binary PLY files, in the float32 numbers that both sides trace."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias
from xml.etree.ElementTree import Comment, Element, SubElement, indent, tostring

import numpy as np

from caster.description.errors import SceneError
from caster.description.fields import Shape
from caster.scene.appearance import Diffuse
from caster.scene.model import Scene
from caster.system.atomic_files import check_folder, write_bytes, write_text


class MissingReferenceError(SceneError, LookupError):
    """A scene with a shape or a camera that has no reference."""


def missing_reference(name: str, kind: str) -> str:
    return (
        f"{name} has no reference: write mitsuba_ref/{kind}/{name.lower()}.py and add its line to "
        f"mitsuba_ref/{kind}/__init__.py (docs/adding-a-shape.md)"
    )


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


# In typeshed, elements and comments differ by the type of their tag; a document holds both.
if TYPE_CHECKING:
    XmlElement: TypeAlias = Element[Any]
else:
    XmlElement = Element


@dataclass(frozen=True)
class SceneExport:
    """A scene for Mitsuba: XML and mesh files next to it. notes: what differs from the scene."""

    xml: str
    meshes: dict[str, bytes]
    shape_ids: list[str]
    notes: list[str]

    def write(self, folder: Path, name: str = "scene.xml") -> Path:
        """Write everything into a folder, which is made; return the path of the XML. Raises OutputError."""
        check_folder(folder)
        for file, content in self.meshes.items():
            check_folder((folder / file).parent)
            write_bytes(folder / file, content)
        write_text(folder / name, self.xml)
        return folder / name


@dataclass
class ShapeWriter:
    """Elements of the scene's shapes, and the mesh files they name."""

    scene: Scene
    name: str = ""  # id of the shape that is being written
    meshes: dict[str, bytes] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def native(self, shape: Shape, plugin: str, center: np.ndarray, linear: np.ndarray) -> XmlElement:
        """A plugin of Mitsuba's own under one matrix."""
        element = Element("shape", type=plugin, id=self.name)
        element.append(matrix_element(center, linear))
        element.append(self.material(shape))
        return element

    def instance(self, shape: Shape, plugin: str, part: Any) -> list[XmlElement]:
        """A plugin that takes no stretching, stretched all the same: an instance of a group of one."""
        group = Element("shape", type="shapegroup", id=f"{self.name}.group")
        unit = SubElement(group, "shape", type=plugin, id=f"{self.name}.unit")
        unit.append(self.material(shape))
        element = Element("shape", type="instance", id=self.name)
        SubElement(element, "ref", id=f"{self.name}.group")
        element.append(matrix_element(part.center[0], part.to_world[0]))
        self.notes.append(f"{self.name}: an instance of a {plugin}, which Mitsuba itself does not stretch")
        return [group, element]

    def mesh(self, shape: Shape, part: Any) -> XmlElement:
        """Triangles as a PLY file with its corners in world space."""
        file = f"meshes/{len(self.meshes):04d}-{safe_name(self.name)}.ply"
        self.meshes[file] = ply_bytes(part)
        element = Element("shape", type="ply", id=self.name)
        SubElement(element, "string", name="filename", value=file)
        if not part.smooth.any():
            SubElement(element, "boolean", name="face_normals", value="true")
        element.append(self.material(shape))
        return element

    def material(self, shape: Shape) -> XmlElement:
        return bsdf_element(self.scene.material_of(shape))


def scene_document(
    scene: Scene,
    shapes: Sequence[XmlElement],
    sensor: XmlElement | None,
    out: ShapeWriter,
    *,
    robust: bool = True,
) -> str:
    """The whole document. Without a sensor, rays have to be handed over. robust: Embree's mode of that name."""
    root = Element("scene", version="3.0.0")
    for note in out.notes:
        root.append(Comment(f" {note.replace('--', '- -')} "))
    # Without it, Embree lets rays slip through the edges of meshes.
    SubElement(root, "boolean", name="embree_use_robust_intersections", value="true" if robust else "false")
    root.append(integrator_element())
    if sensor is not None:
        sensor.append(film_element(scene))
        sensor.append(sampler_element())
        root.append(sensor)
    root.extend(emitter_elements(scene))
    root.extend(shapes)
    indent(root, "    ")
    return tostring(root, encoding="unicode") + "\n"


def integrator_element() -> XmlElement:
    """What plain Mitsuba renders of it: radiance, and the same quantities that are compared."""
    integrator = Element("integrator", type="aov")
    names = {"depth": "depth", "normal": "geo_normal", "shading_normal": "sh_normal", "position": "position"}
    SubElement(integrator, "string", name="aovs", value=",".join(f"{a}:{b}" for a, b in names.items()))
    direct = SubElement(integrator, "integrator", type="direct", name="radiance")
    SubElement(direct, "integer", name="emitter_samples", value="1")
    SubElement(direct, "integer", name="bsdf_samples", value="0")
    return integrator


def format_floats(values: Sequence[float] | np.ndarray) -> str:
    """Shortest decimals that read back as the same float64."""
    return " ".join(repr(float(value)) for value in values)


def safe_name(name: str) -> str:
    """A file name out of a shape's name."""
    return "".join(c if c.isascii() and c.isalnum() else "-" for c in name)[:40]


def matrix_element(center: np.ndarray, linear: np.ndarray) -> XmlElement:
    transform = Element("transform", name="to_world")
    rows = np.column_stack([linear, center])
    SubElement(transform, "matrix", value=f"{format_floats(rows.ravel())} 0 0 0 1")
    return transform


def bsdf_element(material: Diffuse) -> XmlElement:
    diffuse = Element("bsdf", type="diffuse")
    SubElement(diffuse, "rgb", name="reflectance", value=format_floats(material.reflectance))
    if not material.two_sided:
        return diffuse
    both = Element("bsdf", type="twosided")
    both.append(diffuse)
    return both


def emitter_elements(scene: Scene) -> list[XmlElement]:
    """Point and directional lights. Ambient light is added separately on both sides, so it is not exported."""
    elements: list[XmlElement] = []
    for light in scene.lights:
        if light.type == "ambient":
            elements.append(Comment(" ambient light is added apart, as reflectance times radiance "))
            continue
        emitter = Element("emitter", type=light.type)
        if light.type == "point":
            SubElement(emitter, "point", name="position", value=format_floats(light.position))
            SubElement(emitter, "rgb", name="intensity", value=format_floats(light.intensity))
        else:
            SubElement(emitter, "vector", name="direction", value=format_floats(light.direction))
            SubElement(emitter, "rgb", name="irradiance", value=format_floats(light.irradiance))
        elements.append(emitter)
    return elements


def film_element(scene: Scene) -> XmlElement:
    """A film that keeps one unblurred float32 sample in each pixel's centre."""
    film = Element("film", type="hdrfilm")
    x0, y0, x1, y1 = scene.film.window
    sizes = {"width": scene.film.width, "height": scene.film.height}
    if scene.film.crop is not None:
        sizes |= {"crop_offset_x": x0, "crop_offset_y": y0, "crop_width": x1 - x0, "crop_height": y1 - y0}
    for name, value in sizes.items():
        SubElement(film, "integer", name=name, value=str(value))
    SubElement(film, "string", name="pixel_format", value="rgba")
    SubElement(film, "string", name="component_format", value="float32")
    SubElement(film, "rfilter", type="box")
    return film


def sampler_element() -> XmlElement:
    sampler = Element("sampler", type="stratified")
    SubElement(sampler, "integer", name="sample_count", value="1")
    SubElement(sampler, "boolean", name="jitter", value="false")
    return sampler
