"""The registry of cameras on the judge's side: one entry for every camera of caster.cameras.CAMERAS."""

from mitsuba_ref.cameras import orthographic, pinhole, without_sensor

REFERENCES = (
    pinhole.REFERENCE,
    orthographic.REFERENCE,
    without_sensor.FISHEYE,
    without_sensor.PANORAMA,
    without_sensor.PARABOLIC,
    without_sensor.RAY,
)
