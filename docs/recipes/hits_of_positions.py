"""Positions and normals of an image as the files of rays and hits that `mitsuba-ref judge` reads."""

import numpy as np


def write(rays_file, hits_file, eye, position, normal, hit):
    """position, normal: (h, w, 3); hit: (h, w) bool. Each ray leads from the eye to a position, where t is 1."""
    eye = np.float32(eye)
    d = position[hit] - eye
    limits = np.tile(np.float32([0, np.inf]), (len(d), 1))
    np.savez(rays_file, rays=np.hstack([np.tile(eye, (len(d), 1)), d, limits]))
    np.savez(hits_file, t=np.ones(len(d), np.float32), n=normal[hit])
    print(f"{len(d)} hits in {hit.shape[1]} x {hit.shape[0]} pixels")
