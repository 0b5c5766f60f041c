"""Lights and materials."""

from typing import Literal

from caster.description import fields
from caster.description.fields import RGB, Description, Reflectance, UnitVec3, Vec3
from caster.kernels.surface.lighting import DirectionalLight, PointLight

__all__ = [
    "Ambient",
    "Diffuse",
    "Point",
]


class Point(fields.Light):
    """An isotropic point light. `intensity` in power per solid angle (W/sr)."""

    type: Literal["point"] = "point"
    position: Vec3
    intensity: RGB

    def pack(self) -> PointLight:
        return PointLight(self.position, self.intensity)


class Directional(fields.Light):
    """Parallel light along `direction`; a perpendicular surface receives `irradiance` (W/m^2)."""

    type: Literal["directional"] = "directional"
    direction: UnitVec3
    irradiance: RGB

    def pack(self) -> DirectionalLight:
        x, y, z = self.direction
        return DirectionalLight((0.0 - x, 0.0 - y, 0.0 - z), self.irradiance)


class Ambient(fields.Light):
    """Constant `radiance` from all directions (W/(m^2 sr)), without shadows."""

    type: Literal["ambient"] = "ambient"
    radiance: RGB


Light = Point | Directional | Ambient
LIGHTS = (Point, Directional, Ambient)


class Diffuse(Description):
    """A Lambertian surface that reflects the fraction `reflectance` of incident light.

    A one-sided surface is black where its shading normal points away from the viewer.
    """

    type: Literal["diffuse"] = "diffuse"
    reflectance: Reflectance = (0.5, 0.5, 0.5)
    two_sided: bool = False


DEFAULT = Diffuse()
