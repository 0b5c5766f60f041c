"""Disk: Mitsuba's disk, which takes any matrix; and its error model."""

from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from caster.shapes.disk import Disk
from mitsuba_ref.meeting import KU, Meetings, norm
from mitsuba_ref.shapes.quadric import in_object_space, turned_normal
from mitsuba_ref.shapes.triangles import UNRESOLVABLE
from mitsuba_ref.xml import Writer


def to_xml(out: Writer, shape: Disk, part: Any) -> list[Element]:
    return [out.native(shape, "disk", part.center[0], part.to_world[0])]


def meet(prims: Any, k: np.ndarray, o: np.ndarray, d: np.ndarray) -> tuple[Meetings, ...]:
    """Ray i with disk k[i]: the plane z = 0 of object space, then the rim."""
    to_object = prims.to_object[k]
    rays = in_object_space(prims.center[k], to_object, o, d)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = -rays.o[:, 2] / rays.d[:, 2]
        components, slope = rays.components(t), np.abs(rays.d[:, 2])
        rho = KU * rays.rows[:, 2] * rays.d_size / slope
        resolvable = rho < UNRESOLVABLE
        t_error = KU * (components[:, 2] / slope + np.abs(t)) / (1.0 - np.minimum(rho, UNRESOLVABLE))
        q = rays.o + t[:, None] * rays.d
        rim = np.hypot(q[:, 0], q[:, 1])
        rim_error = KU * (components[:, 0] + components[:, 1]) + t_error * norm(rays.d[:, :2])
        possible, certain = rim - 1.0 <= rim_error, (1.0 - rim > rim_error) & resolvable
    up = np.tile([0.0, 0.0, 1.0], (len(k), 1))
    n, n_error = turned_normal(to_object, up, np.zeros(len(k)))
    return (Meetings(t, np.where(resolvable, t_error, np.inf), n, n_error, n, n_error, possible, certain),)
