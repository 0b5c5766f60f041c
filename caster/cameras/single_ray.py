"""A single ray for every pixel, exact to the bit, for reproducers."""

import math
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import Field, field_validator

from caster.description.errors import expectation_error
from caster.description.fields import Description, Positive, SignedVec3
from caster.jit.decorators import implement
from caster.kernels.protocol import Vec3, camera_ray

__all__ = ["Ray"]

# Directions with exponents up to this have finite, nonzero squares, and so have their products with t.
MAX_DIRECTION_EXPONENT = 100


class SingleRay(NamedTuple):
    """Parameters of the ray camera for kernels."""

    o: Vec3  # float64
    d: Vec3  # float64, of any length
    t_max: float


class Ray(Description):
    """The ray origin + t direction, 0 < t <= t_max, cast by every pixel.

    Numbers are used unchanged: the direction is not normalized, and zeros keep their signs, which 1 / direction
    depends on. Depth is the distance from the origin.
    """

    type: Literal["ray"] = "ray"
    origin: SignedVec3  # scene units
    direction: SignedVec3
    t_max: Annotated[Positive | None, Field(description="None: no limit")] = None  # lengths of direction

    shares_origin: ClassVar[bool] = True
    look_at: ClassVar[None] = None
    MINIMAL: ClassVar[Mapping[str, Any]] = {"origin": (0.0, 0.0, 9.0), "direction": (0.0, 0.0, -1.0)}

    @field_validator("direction")
    @classmethod
    def _has_a_direction(cls, direction: Any) -> Any:
        if not any(direction):
            raise expectation_error("a direction, so not all zero", direction)
        return direction

    @property
    def eye(self) -> Vec3:
        """The origin, under the name that other cameras use."""
        return self.origin

    @property
    def up(self) -> Vec3:
        """The coordinate axis most perpendicular to the ray."""
        least = min(range(3), key=lambda axis: abs(self.direction[axis]))
        x, y, z = (float(axis == least) for axis in range(3))
        return x, y, z

    def pack(self, width: int, height: int) -> SingleRay:
        """Unchanged, but directions beyond MAX_DIRECTION_EXPONENT are scaled by a power of two, and t_max with them."""
        t_max, d = math.inf if self.t_max is None else self.t_max, np.array(self.direction)
        exponent = int(np.frexp(np.abs(d).max())[1])
        if abs(exponent) > MAX_DIRECTION_EXPONENT:
            with np.errstate(over="ignore", under="ignore"):
                d, t_max = np.ldexp(d, -exponent), float(np.ldexp(t_max, exponent))
        x, y, z = d.tolist()
        return SingleRay(self.origin, (x, y, z), t_max)


@implement(camera_ray, SingleRay)
def _camera_ray(camera: Any, x: float, y: float) -> Any:
    return camera.o, camera.d, 0.0, camera.t_max
