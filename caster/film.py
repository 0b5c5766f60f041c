"""What a scene holds apart from its geometry: the film, how to shade, and how closely to check."""

from collections.abc import Sequence
from typing import Annotated, Any, Self

from pydantic import BeforeValidator, Field, field_validator

from caster.description import Description
from caster.quantities import PositiveNumber, row
from caster.wording import complain, show

LARGEST_SIDE = 65536  # pixels; one float32 channel of such a square takes 16 GiB


Pixels = Annotated[int, Field(ge=1, le=LARGEST_SIDE)]
Index = Annotated[int, Field(ge=0)]
_corners = row(4, "4 pixel indices [x0, y0, x1, y1]")
Window = Annotated[tuple[Index, Index, Index, Index], BeforeValidator(_corners)]


class Film(Description):
    """The picture in pixels. `crop` = [x0, y0, x1, y1] is the part to render; x1, y1 are just outside."""

    width: Pixels = 256
    height: Pixels = 256
    crop: Window | None = None

    @field_validator("crop")
    @classmethod
    def _is_inside(cls, crop: Any, info: Any) -> Any:
        if crop is None:
            return crop
        x0, y0, x1, y1 = crop
        if not (x0 < x1 and y0 < y1):
            raise complain(f"must hold at least one pixel, x0 < x1 and y0 < y1, got {show(crop)}")
        width, height = info.data.get("width", x1), info.data.get("height", y1)
        if x1 > width or y1 > height:
            raise complain(f"must lie inside the film, x1 <= {width} and y1 <= {height}, got {show(crop)}")
        return crop

    @property
    def window(self) -> tuple[int, int, int, int]:
        """The part to render, x0, y0, x1, y1: the crop, or all of the film."""
        return self.crop or (0, 0, self.width, self.height)

    def resized(self, width: int, height: int) -> Self:
        """The same picture in other pixels; the crop goes along, outwards to whole pixels."""
        crop = self.crop and (
            self.crop[0] * width // self.width,
            self.crop[1] * height // self.height,
            -(-self.crop[2] * width // self.width),
            -(-self.crop[3] * height // self.height),
        )
        return type(self)(width=width, height=height, crop=crop)

    def cropped(self, crop: Sequence[int]) -> Self:
        """The same film with this part of it to render."""
        return type(self)(width=self.width, height=self.height, crop=tuple(crop))


class Shading(Description):
    """How `diffuse` is computed."""

    shadows: bool = True


class Check(Description):
    """How much of the derived bound a comparison may use: 1 is all of it and no more."""

    ratio: PositiveNumber = 1.0
