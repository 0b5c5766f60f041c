"""The registry of references: one for every camera of caster.cameras.CAMERAS (a test demands it)."""

from mitsuba_ref.cameras import fisheye, orthographic, panorama, parabolic, pinhole, ray

REFERENCES = (
    pinhole.REFERENCE,
    orthographic.REFERENCE,
    fisheye.REFERENCE,
    panorama.REFERENCE,
    parabolic.REFERENCE,
    ray.REFERENCE,
)
