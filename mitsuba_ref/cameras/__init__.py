"""The registry of references: one for every camera of caster.cameras.CAMERAS (a test demands it)."""

from mitsuba_ref.cameras import orthographic, pinhole, without_sensor

REFERENCES = (
    pinhole.REFERENCE,
    orthographic.REFERENCE,
    without_sensor.FISHEYE,
    without_sensor.PANORAMA,
    without_sensor.PARABOLIC,
    without_sensor.RAY,
)
