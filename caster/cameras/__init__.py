"""Registry of cameras, by the `type` of `[camera]` in scene files. `CAMERAS.register` adds one from elsewhere."""

from typing import Any

from caster.cameras.fisheye import Fisheye
from caster.cameras.orthographic import Orthographic
from caster.cameras.panorama import Panorama
from caster.cameras.pinhole import Pinhole
from caster.cameras.single_ray import Ray
from caster.description.registry import Registry

__all__ = ["CAMERAS", "Fisheye", "Orthographic", "Panorama", "Pinhole", "Ray"]

CAMERAS: Registry[Any] = Registry(Pinhole, Orthographic, Fisheye, Panorama, Ray)
