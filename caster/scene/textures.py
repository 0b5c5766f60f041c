"""Textures: reflectances that depend on uv, their pictures, and the arrays of them that kernels read."""

import io
from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Discriminator, Tag

from caster.description.errors import SceneError, child_of
from caster.description.fields import ArrayOf, Description, Flag, Reflectance, Shape, Transform, exactly_one, matrix_of
from caster.description.input_files import read_input
from caster.description.transform import Floats, dot_rows, power
from caster.geometry.mesh_files import load_once, readable
from caster.kernels.surface.texturing import (
    BILINEAR,
    CLAMP,
    MIRROR,
    NEAREST,
    NO_TEXTURE,
    OF_MESH,
    REPEAT,
    ROWS_PER_FACE,
    Textures,
)

__all__ = ["Bitmap", "MeshColors"]

MAX_TEXELS = 2**24  # 4096 x 4096; 24 bytes each
FLOAT32_DECODING = 1e-6  # levels of sRGB that were decoded in float32 are up to 3.4e-7 off; two levels differ by 3e-4
PNG_BITS = 24  # where a PNG file has the number of bits a channel
FILTERS = {"nearest": NEAREST, "bilinear": BILINEAR}
WRAPS = {"repeat": REPEAT, "mirror": MIRROR, "clamp": CLAMP}


class Texture(Description):
    """Base of textures."""

    type: str

    def misfit(self, shape: Shape) -> str:
        """Why a shape cannot have the texture; "" if it can."""
        return shape.without_uv()


class Picture(Texture):
    """Base of pictures: (h, w, 3) linear `texels` over the unit square of its uv; row 0 begins at v = 0.

    `to_uv` maps (u, v, 0) of the surface to the uv of the picture.
    """

    to_uv: Transform = ()

    @cached_property
    def uv_matrix(self) -> Floats:
        """(2, 3): uv of the texture are its product with (u, v, 1)."""
        return matrix_of(self.to_uv)[:2, [0, 1, 3]]


class Checkerboard(Picture):
    """Squares of side 1/2 in uv; the one at uv = 0 has `color0`."""

    type: Literal["checkerboard"] = "checkerboard"
    filter: ClassVar[str] = "nearest"
    wrap: ClassVar[str] = "repeat"
    color0: Reflectance = (0.4, 0.4, 0.4)
    color1: Reflectance = (0.2, 0.2, 0.2)

    @cached_property
    def texels(self) -> Floats:
        return np.array([[self.color0, self.color1], [self.color1, self.color0]])


def _few_enough(texels: Floats) -> Floats:
    if not 0 < texels.size <= 3 * MAX_TEXELS:
        raise ValueError(f"must have 1 to {MAX_TEXELS:,} pixels, got {texels.shape[1]} x {texels.shape[0]}")
    return texels


Rows = ArrayOf(list[Reflectance])
Texels = Annotated[Floats, Rows, AfterValidator(_few_enough)]  # (h, w, 3) float64


def read_picture(path: str) -> NDArray[np.uint8]:
    """The pixels (h, w, 3) of a PNG file with 8 bits a channel; grey becomes three channels, alpha is ignored.

    Raises FileMissing for a file that cannot be read, SceneError for any other format and beyond MAX_TEXELS.
    """
    from PIL import Image  # deferred: most scenes have no picture

    data = read_input(path, "picture")
    try:
        with Image.open(io.BytesIO(data), formats=("PNG",)) as image:
            deep = data[PNG_BITS] == 16
            if image.width * image.height > MAX_TEXELS or deep:
                got = f"{image.width} x {image.height}{' of 16 bits' if deep else ''}"
                raise SceneError(f"{path}: expected at most {MAX_TEXELS:,} pixels, of 8 bits a channel, got {got}")
            return np.asarray(image.convert("RGB"))
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError):
        raise SceneError(f"{path}: expected a PNG picture that is complete; convert or export it again") from None


class Bitmap(Picture):
    """A picture: a PNG `file` with 8 bits a channel, in sRGB unless `raw`, or `data`, rows of linear [r, g, b]."""

    type: Literal["bitmap"] = "bitmap"
    file: Annotated[str | None, readable(read_picture)] = None
    data: Texels | None = None
    filter: Literal["bilinear", "nearest"] = "bilinear"
    wrap: Literal["repeat", "mirror", "clamp"] = "repeat"
    raw: Flag = False

    _has_one_source = exactly_one("file", "data")

    @cached_property
    def texels(self) -> Floats:
        if self.file is None:
            return np.asarray(self.data)
        picture = load_once(read_picture, self.file)
        return picture / 255.0 if self.raw else LINEAR_OF_SRGB[picture]

    def as_png(self) -> tuple[bytes, bool] | None:
        """(a PNG file with 8 bits a channel of the same texels, up to float32; whether it is raw), if there is one."""
        from PIL import Image  # deferred: most scenes have no picture

        for raw, levels in ((False, LINEAR_OF_SRGB), (True, np.arange(256) / 255.0)):
            middles = (levels[1:] + levels[:-1]) / 2.0
            bytes_of = np.searchsorted(middles, self.texels)
            if np.abs(levels[bytes_of] - self.texels).max() <= FLOAT32_DECODING:
                content = io.BytesIO()
                Image.fromarray(bytes_of.astype(np.uint8)).save(content, "PNG")
                return content.getvalue(), raw
        return None


Colors = Annotated[Floats, ArrayOf(Reflectance)]  # (n, 3) float64


class MeshColors(Texture):
    """Colours of the `vertices` of a mesh (n, 3), interpolated on each face, or of its `faces` (m, 3)."""

    type: Literal["mesh_colors"] = "mesh_colors"
    vertices: Colors | None = None
    faces: Colors | None = None

    _has_one_source = exactly_one("vertices", "faces")

    def misfit(self, shape: Shape) -> str:
        mesh = getattr(shape, "mesh", None)
        if mesh is None:
            return f"a {shape.type} has no vertices to be coloured"
        name = "vertices" if self.faces is None else "faces"
        given, count = len(getattr(self, name)), len(getattr(mesh(), name))
        return "" if given == count else f"that has {given} colours, and the mesh {count} {name}"

    def rows(self, triangles: Any) -> Floats:
        """(ROWS_PER_FACE m, 3): of each face a corner, its colour, and the gradients of red, green and blue."""
        a, b, c = triangles.vertices[triangles.faces].transpose(1, 0, 2)
        u, v = b - a, c - a
        uu, uv, vv = dot_rows(u, u), dot_rows(u, v), dot_rows(v, v)
        area = uu * vv - uv * uv  # squared, of the parallelogram
        scaled = [vv[:, None] * u - uv[:, None] * v, uu[:, None] * v - uv[:, None] * u]
        duals = scaled / np.where(area > 0.0, area, np.inf)[:, None]  # gradients of the barycentrics b1, b2
        if self.vertices is None:  # (m, 3, 3): the colours at the corners of each face
            colors = np.repeat(np.asarray(self.faces)[:, None], 3, axis=1)
        else:
            colors = np.asarray(self.vertices)[triangles.faces]
        changes = (colors[:, 1:] - colors[:, :1]).transpose(1, 0, 2)
        gradients = (changes[..., None] * duals[..., None, :]).sum(axis=0)
        return np.concatenate([a[:, None], colors[:, :1], gradients], axis=1).reshape(-1, 3)


# The linear value of each sRGB byte. Source: IEC 61966-2-1.
SRGB = [byte / 255.0 for byte in range(256)]
LINEAR_OF_SRGB = np.array([x / 12.92 if x <= 0.04045 else power((x + 0.055) / 1.055, 2.4) for x in SRGB])


if TYPE_CHECKING:
    AnyReflectance = tuple[float, float, float] | Checkerboard | Bitmap | MeshColors
else:
    AnyReflectance = Annotated[
        Annotated[Reflectance, Tag("color")]
        | Annotated[Checkerboard, Tag("checkerboard")]
        | Annotated[Bitmap, Tag("bitmap")]
        | Annotated[MeshColors, Tag("mesh_colors")],
        Discriminator(lambda value: child_of(value, "type") if isinstance(value, (dict, Texture)) else "color"),
    ]


def texture_arrays(textures: Sequence[Any], packed: Any) -> Textures:
    """The textures of all shapes, or None, as kernels read them; a picture of several shapes has its texels once."""
    settings, to_texels = np.full((len(textures), 5), NO_TEXTURE), np.zeros((len(textures), 2, 3))
    texels, first, count = [np.zeros((0, 3))], dict[int, int](), 0
    for k, texture in enumerate(textures):
        if texture is None:
            continue
        of_mesh = isinstance(texture, MeshColors)
        if of_mesh or id(texture) not in first:
            first[id(texture)] = count
            texels.append(texture.rows(packed.parts[k]) if of_mesh else texture.texels.reshape(-1, 3))
            count += len(texels[-1])
        if of_mesh:
            settings[k, ::4] = OF_MESH, first[id(texture)] - ROWS_PER_FACE * packed.places[packed.first[k]]
            continue
        height, width, _ = texture.texels.shape
        settings[k] = FILTERS[texture.filter], WRAPS[texture.wrap], width, height, first[id(texture)]
        to_texels[k] = texture.uv_matrix * [[width], [height]]
        to_texels[k, :, 2] -= 0.5 if texture.filter == "bilinear" else 0.0  # texels have their values at their centres
    return Textures(settings, to_texels, np.concatenate(texels))
