"""Textures: reflectances that depend on uv, their pictures, and the arrays of them that kernels read."""

import io
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Discriminator, Tag, field_validator, model_validator
from pydantic_core import CoreSchema

from caster.description.errors import SceneError, child_of, expectation_error
from caster.description.fields import Description, FixedArray, Flag, NumberList, Reflectance, Transform, matrix_of
from caster.description.input_files import read_input
from caster.geometry.mesh_files import load_once
from caster.kernels.surface.texturing import BILINEAR, CHECKERBOARD, NEAREST, NO_TEXTURE, Textures

__all__ = ["Bitmap", "Checkerboard", "Texture", "read_picture"]

MAX_TEXELS = 2**24  # 4096 x 4096; 24 bytes each


class Texture(Description):
    """Base of textures. `to_uv` maps (u, v, 0) of the surface to the uv of the texture."""

    type: str
    to_uv: Transform = ()

    @property
    def texels(self) -> NDArray[np.float64]:
        """(h, w, 3) linear reflectances; row 0 begins at v = 0."""
        raise NotImplementedError

    @property
    def sampling(self) -> tuple[int, int]:
        """How kernels read the texels: a filter, and an index into WRAPS."""
        raise NotImplementedError

    @cached_property
    def uv_matrix(self) -> NDArray[np.float64]:
        """(2, 3): uv of the texture are its product with (u, v, 1)."""
        return matrix_of(self.to_uv)[:2, [0, 1, 3]]


class Checkerboard(Texture):
    """Squares of side 1/2 in uv: `color0` where both or neither of the fractions of u and v exceed 1/2."""

    type: Literal["checkerboard"] = "checkerboard"
    color0: Reflectance = (0.4, 0.4, 0.4)
    color1: Reflectance = (0.2, 0.2, 0.2)

    @property
    def texels(self) -> NDArray[np.float64]:
        return np.array([[self.color0, self.color1], [self.color1, self.color0]])

    @property
    def sampling(self) -> tuple[int, int]:
        return CHECKERBOARD, 0


class _Pixels(NumberList):
    """Rows of pixels [r, g, b], kept as one array (h, w, 3)."""

    def read(self, value: Any) -> FixedArray:
        try:
            array = np.array(value, np.float64) + 0.0
        except (TypeError, ValueError):  # rows of different lengths, words
            array = np.zeros(0)
        if array.ndim != 3 or array.shape[2] != 3 or not array.size or not ((array >= 0.0) & (array <= 1.0)).all():
            raise expectation_error(self.what, value)
        array.flags.writeable = False
        return array.view(FixedArray)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: Any) -> dict[str, Any]:
        return {"type": "array", "items": super().__get_pydantic_json_schema__(schema, handler), "minItems": 1}


Pixels = Annotated[NDArray[np.float64], _Pixels("rows of pixels [r, g, b], each from 0 to 1", width=3)]
WRAPS = ("repeat", "mirror", "clamp")


class Bitmap(Texture):
    """A picture over the unit square of uv: a PNG `file`, or linear `data` (h, w, 3). Row 0 begins at v = 0."""

    type: Literal["bitmap"] = "bitmap"
    ARRAYS: ClassVar[tuple[str, ...]] = ("data",)
    file: str | None = None
    data: Pixels | None = None
    filter: Literal["bilinear", "nearest"] = "bilinear"
    wrap: Literal["repeat", "mirror", "clamp"] = "repeat"
    raw: Flag = False

    @field_validator("file")
    @classmethod
    def _is_usable(cls, file: str | None, info: Any) -> str | None:
        return info.context.resolve(file, _load_picture) if file is not None and info.context else file

    @model_validator(mode="after")
    def _has_one_source(self) -> Self:
        if (self.file is None) == (self.data is None):
            raise ValueError(f"needs file or data, exactly one of the two, got {'both' if self.file else 'neither'}")
        return self

    @property
    def texels(self) -> NDArray[np.float64]:
        if self.file is None:
            return np.asarray(self.data)
        values = _load_picture(self.file) / 255.0
        return values if self.raw else linear_of_srgb(values)

    @property
    def sampling(self) -> tuple[int, int]:
        return NEAREST if self.filter == "nearest" else BILINEAR, WRAPS.index(self.wrap)


def linear_of_srgb(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """sRGB values from 0 to 1 as linear ones. Source: IEC 61966-2-1."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def read_picture(path: str) -> NDArray[np.uint8]:
    """The pixels (h, w, 3) of a PNG file with 8 bits a channel; grey becomes three channels, alpha is ignored.

    Raises FileMissing for a file that cannot be read, SceneError for any other format and beyond MAX_TEXELS.
    """
    from PIL import Image, UnidentifiedImageError  # deferred: most scenes have no picture

    data = read_input(path, "picture")
    try:
        with Image.open(io.BytesIO(data), formats=("PNG",)) as image:
            if image.width * image.height > MAX_TEXELS:
                got = f"{image.width} x {image.height}"
                raise SceneError(
                    f"{path}: this picture is too large: expected at most {MAX_TEXELS:,} pixels, got {got}"
                )
            if image.mode.startswith("I"):
                raise SceneError(f"{path}: expected 8 bits a channel, got 16: convert it")
            return np.asarray(image.convert("RGB"))
    except UnidentifiedImageError:
        got = Path(path).suffix or "another format"
        raise SceneError(f"{path}: expected a PNG picture, got {got}: convert it") from None
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise SceneError(f"{path}: this picture is damaged: {error}") from None


def _load_picture(path: str) -> NDArray[np.uint8]:
    return load_once(read_picture, path)


def _kind_of_reflectance(value: Any) -> Any:
    is_texture = isinstance(value, (dict, Texture))
    return child_of(value, "type") if is_texture else "color"


if TYPE_CHECKING:
    AnyReflectance = tuple[float, float, float] | Checkerboard | Bitmap
else:
    AnyReflectance = Annotated[
        Annotated[Reflectance, Tag("color")]
        | Annotated[Checkerboard, Tag("checkerboard")]
        | Annotated[Bitmap, Tag("bitmap")],
        Discriminator(_kind_of_reflectance),
    ]


def texture_arrays(textures: list[Texture | None]) -> Textures:
    """The textures of all shapes as kernels read them; equal ones share their texels."""
    settings = np.zeros((len(textures), 5), np.int64)
    settings[:, 0] = NO_TEXTURE
    to_uv, texels, first = np.zeros((len(textures), 2, 3)), [np.zeros((0, 3))], dict[int, int]()
    for k, texture in enumerate(textures):
        if texture is not None:
            to_uv[k], picture = texture.uv_matrix, texture.texels
            if id(texture) not in first:
                first[id(texture)] = sum(map(len, texels))
                texels.append(picture.reshape(-1, 3))
            settings[k] = *texture.sampling, picture.shape[1], picture.shape[0], first[id(texture)]
    return Textures(settings, to_uv, np.concatenate(texels))
