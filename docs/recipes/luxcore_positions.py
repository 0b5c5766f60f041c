"""LuxCore's positions of a scene as rays and hits: python luxcore_positions.py IN.npz OUT_RAYS OUT_HITS

IN.npz is what scene_arrays.py writes.
"""

import sys
import time

import hits_of_positions
import numpy as np
import pyluxcore

SETTINGS = {
    "renderengine.type": "PATHCPU",
    "sampler.type": "SOBOL",
    "film.filter.type": "NONE",
    "batch.haltspp": 1,
    "path.pathdepth.total": 1,
    "film.outputs.0.type": "POSITION",
    "film.outputs.0.filename": "position.exr",
    "film.outputs.1.type": "GEOMETRY_NORMAL",
    "film.outputs.1.filename": "normal.exr",
}
OUTPUTS = pyluxcore.FilmOutputType


def properties(values):
    found = pyluxcore.Properties()
    for key, value in values.items():
        found.Set(pyluxcore.Property(key, value))
    return found


def lux_scene(corners, eye, ahead, up, half):
    scene = pyluxcore.Scene()
    vertices, faces = corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)
    scene.DefineMesh("all", [*map(tuple, vertices.tolist())], [*map(tuple, faces.tolist())], None, None, None, None)
    settings = {
        "scene.camera.type": "perspective",
        "scene.camera.lookat.orig": eye.tolist(),
        "scene.camera.lookat.target": (eye + ahead).tolist(),
        "scene.camera.up": up.tolist(),
        "scene.camera.fieldofview": float(np.degrees(2 * np.arctan(half.min()))),  # along the shorter side
        "scene.camera.autofocus.enable": False,
        "scene.materials.grey.type": "matte",
        "scene.objects.all.shape": "all",
        "scene.objects.all.material": "grey",
        "scene.lights.sky.type": "constantinfinite",
    }
    scene.Parse(properties(settings))
    return scene


def render(scene, width, height):
    """Positions and normals, (height, width, 3) each."""
    settings = properties(SETTINGS | {"film.width": width, "film.height": height})
    session = pyluxcore.RenderSession(pyluxcore.RenderConfig(settings, scene))
    session.Start()
    while not session.HasDone():
        time.sleep(0.1)
        session.UpdateStats()
    images = [np.zeros((height, width, 3), np.float32) for _ in range(2)]
    for image, output in zip(images, (OUTPUTS.POSITION, OUTPUTS.GEOMETRY_NORMAL), strict=True):
        session.GetFilm().GetOutputFloat(output, image, 0)
    session.Stop()
    return images


def main(given, rays_file, hits_file):
    pyluxcore.Init(lambda message: None)
    scene = np.load(given)
    width, height = scene["size"].tolist()
    lux = lux_scene(*(scene[name] for name in ("corners", "eye", "ahead", "up", "half")))
    position, normal = render(lux, width, height)
    hit = np.isfinite(position).all(axis=2)
    hits_of_positions.write(rays_file, hits_file, scene["eye"], position, normal, hit)


main(*sys.argv[1:])
