"""The registry of cameras: what a scene file may say in `[camera] type`."""

from caster.cameras.fisheye import Fisheye as Fisheye
from caster.cameras.orthographic import Orthographic as Orthographic
from caster.cameras.panorama import Panorama as Panorama
from caster.cameras.parabolic import Parabolic as Parabolic
from caster.cameras.pinhole import Pinhole as Pinhole
from caster.cameras.ray import Ray as Ray

CAMERAS = (Pinhole, Orthographic, Fisheye, Panorama, Parabolic, Ray)
