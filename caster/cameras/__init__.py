"""The registry of cameras: what a scene file may say in `[camera] type`."""

from caster.cameras.fisheye import Fisheye
from caster.cameras.orthographic import Orthographic
from caster.cameras.panorama import Panorama
from caster.cameras.parabolic import Parabolic
from caster.cameras.pinhole import Pinhole
from caster.cameras.ray import Ray

__all__ = ["CAMERAS", "Fisheye", "Orthographic", "Panorama", "Parabolic", "Pinhole", "Ray"]

CAMERAS = (Pinhole, Orthographic, Fisheye, Panorama, Parabolic, Ray)
