"""A scene of triangles for a program without this package: python scene_arrays.py SCENE OUT.npz

corners (m, 3, 3) float32, [triangle, corner, axis]; eye, ahead and up (3,) of a pinhole camera, half (2,) the half
width and height of its image at distance 1; size (2,), width and height in pixels.
"""

import sys

import numpy as np

import caster


def main(path, out):
    scene = caster.load_scene(path)
    camera, film = scene.camera, scene.film
    ahead = camera.direction or np.subtract(camera.look_at, camera.eye)
    half = camera.half_extent(film.width, film.height)
    np.savez(
        out,
        corners=np.float32(scene.triangles()),
        eye=np.float64(camera.eye),
        ahead=np.float64(ahead),
        up=np.float64(camera.up),
        half=half,
        size=(film.width, film.height),
    )


main(*sys.argv[1:])
