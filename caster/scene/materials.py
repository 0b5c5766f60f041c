"""Materials."""

from typing import Literal

from caster.description.fields import Description, Reflectance

__all__ = ["Diffuse"]


class Diffuse(Description):
    """A Lambertian surface that reflects the fraction `reflectance` of incident light.

    A one-sided surface is black where its shading normal points away from the viewer.
    """

    type: Literal["diffuse"] = "diffuse"
    reflectance: Reflectance = (0.5, 0.5, 0.5)
    two_sided: bool = False


DEFAULT = Diffuse()
