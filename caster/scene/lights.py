"""Lights: how much arrives at a point, and from where."""

from typing import Literal

from caster.description import fields
from caster.description.fields import RGB, UnitVec3, Vec3
from caster.kernels.surface.lighting import DirectionalLight, PointLight

__all__ = ["Ambient", "Point"]


class Point(fields.Light):
    """A point that shines evenly in all directions. `intensity` in power per solid angle (W/sr)."""

    type: Literal["point"] = "point"
    position: Vec3
    intensity: RGB

    def pack(self) -> PointLight:
        return PointLight(self.position, self.intensity)


class Directional(fields.Light):
    """Parallel light that travels along `direction`; a surface across it receives `irradiance` (W/m^2)."""

    type: Literal["directional"] = "directional"
    direction: UnitVec3
    irradiance: RGB

    def pack(self) -> DirectionalLight:
        x, y, z = self.direction
        return DirectionalLight((0.0 - x, 0.0 - y, 0.0 - z), self.irradiance)


class Ambient(fields.Light):
    """The same `radiance` from everywhere (W/(m^2 sr)); it casts no shadow."""

    type: Literal["ambient"] = "ambient"
    radiance: RGB


Light = Point | Directional | Ambient
LIGHTS = (Point, Directional, Ambient)
