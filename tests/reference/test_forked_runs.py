"""Mitsuba is asked anew about anything that is new."""

from dataclasses import replace

import numpy as np
from forked_runs import everything_given
from mitsuba_scenes import job, shape, write


def test_whatever_mitsuba_is_given_counts(tmp_path):
    xml = write(tmp_path, shape("sphere", "ball", 0))
    (tmp_path / "meshes").mkdir()
    mesh = tmp_path / "meshes" / "some.ply"
    mesh.write_bytes(b"ply")
    first = job(xml, "scalar_rgb", [[0, 0, 5]], [[0, 0, -1]])
    ray = np.nextafter(first.o, np.float32(9))
    others = (replace(first, o=ray), replace(first, d=-first.d), replace(first, t_max=first.o[:, 2]))
    others += (replace(first, variant="llvm_ad_rgb"), replace(first, lights=False), replace(first, sensor=True))
    told = [everything_given(first, {}), everything_given(first, {"LIBRARY": "x"})]
    told += [everything_given(other, {}) for other in others]
    mesh.write_bytes(b"ply ")
    told.append(everything_given(first, {}))
    mesh.write_bytes(b"ply")
    write(tmp_path, shape("sphere", "ball", 1))
    told.append(everything_given(first, {}))
    assert len(set(told)) == len(told) == 10
    write(tmp_path, shape("sphere", "ball", 0))
    assert everything_given(first, {}) == told[0]
