"""How long one render takes from the command line: `caster render` beside the `mitsuba` command, in turns.

    python benchmarks/startup.py [--turns 9] [--size 1024]

Both cast depth and geometric normal of the same scene (Mitsuba reads what `mitsuba-ref export` wrote), caches are warm,
whole process, and write an EXR file. Prints medians, and the median of the ratios of each turn.
"""

import argparse
import os
import re
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from caster.shapes.heightfield import Heightfield

ROOT = Path(__file__).resolve().parents[1]
VARIANTS = ("scalar_rgb", "llvm_ad_rgb")
AOVS = "depth:depth,normal:geo_normal"

MESH_SCENE = """
[film]
width = 256
height = 256
[camera]
type = "pinhole"
eye = [0, -1.8, 1.2]
look_at = [0, 0, 0]
up = [0, 0, 1]
[[shape]]
type = "mesh"
file = "mesh.ply"
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--turns", type=int, default=9)
    parser.add_argument("--size", type=int, default=1024)
    args = parser.parse_args()
    print(f"{args.size} x {args.size}        caster" + "".join(f"  {name:>12}   ratio" for name in VARIANTS))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for scene in (ROOT / "scenes/one-sphere.toml", ROOT / "scenes/cornell-box.toml", mesh_scene(folder)):
            print_row(scene, folder, args.size, args.turns)


def print_row(scene: Path, folder: Path, size: int, turns: int) -> None:
    xml, out = exported(scene, folder, size), str(folder / "out.exr")
    film = ["--size", str(size), str(size)]
    ours = [sys.executable, "-m", "caster", "render", str(scene), *film, "--aov", "depth,normal", "-o", out]
    mitsuba = str(Path(sys.executable).parent / "mitsuba")
    commands = [ours, *([mitsuba, "-m", variant, str(xml), "-o", out] for variant in VARIANTS)]
    for command in commands:  # for the caches
        seconds(command)
    times = np.array([[seconds(command) for command in commands] for _ in range(turns)])
    cells = [f"{scene.stem:16} {statistics.median(times[:, 0]) * 1e3:5.0f} ms"]
    for k in range(len(VARIANTS)):
        theirs, ratio = statistics.median(times[:, k + 1]), statistics.median(times[:, 0] / times[:, k + 1])
        cells.append(f"  {theirs * 1e3:9.0f} ms  {ratio:6.2f}")
    print("".join(cells), flush=True)


def seconds(command: list[str]) -> float:
    start = time.perf_counter()
    run(command)
    return time.perf_counter() - start


def run(command: list[str]) -> None:
    env = os.environ | {"PYTHONPATH": str(ROOT)}
    subprocess.run(command, check=True, env=env, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)


def exported(scene: Path, folder: Path, size: int) -> Path:
    """Mitsuba's XML, with the same AOVs and nothing else: no light is worked out on either side."""
    target = folder / scene.stem
    film = ["--size", str(size), str(size)]
    run([sys.executable, "-m", "mitsuba_ref", "export", str(scene), *film, "-o", str(target)])
    xml = target / "scene.xml"
    text = re.sub(r'(name="aovs" value=)"[^"]*"', rf'\1"{AOVS}"', xml.read_text())
    xml.write_text(re.sub(r'<integrator type="direct".*?</integrator>', "", text, flags=re.DOTALL))
    return xml


def mesh_scene(folder: Path) -> Path:
    """A landscape of 70 thousand triangles as a binary PLY file."""
    mesh = Heightfield(size=2.0, resolution=187, amplitude=0.2, waves=8, seed=1).mesh()
    head = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(mesh.vertices)}\nproperty float x\n"
        f"property float y\nproperty float z\nelement face {len(mesh.faces)}\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    faces = np.empty(len(mesh.faces), [("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, mesh.faces
    (folder / "mesh.ply").write_bytes(head.encode() + mesh.vertices.astype("<f4").tobytes() + faces.tobytes())
    scene = folder / "mesh-70k.toml"
    scene.write_text("# A mesh of 70 thousand triangles." + MESH_SCENE)
    return scene


if __name__ == "__main__":
    main()
