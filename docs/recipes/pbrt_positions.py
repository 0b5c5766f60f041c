"""pbrt's positions of a scene as rays and hits: python pbrt_positions.py PBRT IN.npz OUT_RAYS OUT_HITS

PBRT is the program; IN.npz is what scene_arrays.py writes. The scene file and the image stay beside OUT_RAYS.
"""

import subprocess
import sys
from pathlib import Path

import hits_of_positions
import numpy as np
import OpenEXR

SCENE = """Scale -1 1 1
LookAt {view}
Camera "perspective" "float fov" {fov!r}
Sampler "independent" "integer pixelsamples" 1
PixelFilter "box"
Integrator "path" "integer maxdepth" 1
Film "gbuffer" "string filename" "{image}" "bool savefp16" false
    "string coordinatesystem" "world" "integer xresolution" {width} "integer yresolution" {height}
WorldBegin
LightSource "infinite"
Shape "trianglemesh" "point3 P" [{points}] "integer indices" [{indices}]
"""


def numbers(values):
    return " ".join(map(repr, np.ravel(values).tolist()))


def scene_text(scene, image):
    corners, eye = scene["corners"], scene["eye"]
    width, height = scene["size"].tolist()
    return SCENE.format(
        view=numbers([eye, eye + scene["ahead"], scene["up"]]),
        fov=float(np.degrees(2 * np.arctan(scene["half"].min()))),  # along the shorter side
        image=image,
        width=width,
        height=height,
        points=numbers(corners.astype(float)),
        indices=numbers(np.arange(3 * len(corners))),
    )


def main(pbrt, given, rays_file, hits_file):
    scene = np.load(given)
    image = Path(rays_file).with_name("pbrt.exr")
    text = image.with_suffix(".pbrt")
    text.write_text(scene_text(scene, image))
    subprocess.run([pbrt, "--quiet", "--render-coord-sys", "world", str(text)], check=True)
    channels = OpenEXR.File(str(image), separate_channels=True).channels()
    position, normal = (np.stack([channels[f"{name}.{axis}"].pixels for axis in "XYZ"], axis=-1) for name in "PN")
    hits_of_positions.write(rays_file, hits_file, scene["eye"], position, normal, normal.any(axis=2))


main(*sys.argv[1:])
