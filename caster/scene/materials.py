"""Materials: how surfaces send light back."""

from typing import Literal

from caster.description.fields import Description, Reflectance

__all__ = ["Diffuse"]


class Diffuse(Description):
    """Lambert's law: the same radiance in all directions, `reflectance` of what arrives.

    A one-sided surface is black from behind, that is where its shading normal points away.
    """

    type: Literal["diffuse"] = "diffuse"
    reflectance: Reflectance = (0.5, 0.5, 0.5)
    two_sided: bool = False


DEFAULT = Diffuse()
