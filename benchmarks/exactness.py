"""What exact decisions cost: renders by this caster, and by a copy of it that takes float64 at its word.

    python benchmarks/exactness.py [SCENE ...]

In the copy every error bound is 0, so that no bound is worked out and no ray is cast twice; all else is the same. Each
has a process of its own; they take turns, so that what else the machine does hits both, and the median of the ratios
counts. Time is the processor's, one thread.
"""

import argparse
import shutil
import statistics
import tempfile
from pathlib import Path

from alternating_runs import BY_DEFAULT, DEPTH, HERE, SCENES, seconds, worker

CAMERAS = ("orthographic", "fisheye")
TURNS = 15

# file, text in the caster, text in the copy
WITHOUT_BOUNDS = (
    (
        "caster/kernels/math/vec.py",
        "inside = (t - off > t_min) & (t + off <= t_max)",
        "inside = (t > t_min) & (t <= t_max)",
    ),
    ("caster/kernels/math/vec.py", "(t + off <= t_min) | (t - off > t_max), t, off)", "not inside, t, 0.0)"),
    ("caster/kernels/raster/tile.py", "tile[DOUBT + i] = 1.0 if abs(ahead) <= margin else tile[DOUBT + i]\n", "pass\n"),
    ("kernels/triangles.py", "error = pre[5] * size(d) + TINY", "error = 0.0"),
    ("kernels/triangles.py", "steep = (abs(slope) > 2.0 * slope_error) & bounded", "steep = slope != 0.0"),
    (
        "caster/kernels/math/quadric_roots.py",
        "steady & (within > 2.0 * within_off), steady & (within < -within_off)",
        "within > 0.0, within <= 0.0",
    ),
    ("caster/kernels/math/quadric_roots.py", "met &= 2.0 * q_off < abs(q)", "met &= abs(q) > 0.0"),
    ("shapes/plane.py", "steep = (abs(slope) > 2.0 * slope_off) & (abs(slope) < math.inf)", "steep = slope != 0.0"),
    ("shapes/disk.py", "steep = (abs(e[2]) > 2.0 * slope_off) & (abs(e[2]) < math.inf)", "steep = e[2] != 0.0"),
    (
        "shapes/disk.py",
        "steep & (beyond < -beyond_off), edge_on | (steep & (beyond > beyond_off))",
        "steep & (beyond <= 0.0), edge_on | (beyond > 0.0)",
    ),
    ("shapes/cylinder.py", "there & (z > z_off) & (z < 1.0 - z_off)", "there & (z >= 0.0) & (z <= 1.0)"),
    ("shapes/cylinder.py", "(z < -z_off) | (z > 1.0 + z_off) | (not there)", "not inside"),
)


def take_away_bounds(folder: Path) -> None:
    """A copy of the caster whose bounds are 0."""
    shutil.copytree(HERE / "caster", folder / "caster", ignore=shutil.ignore_patterns("__pycache__"))
    for name, exact, plain in WITHOUT_BOUNDS:
        path = folder / "caster" / name
        text = path.read_text()
        if text.count(exact) != 1:
            raise SystemExit(f"{path.name}: expected once, got {text.count(exact)} times: {exact}")
        path.write_text(text.replace(exact, plain))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*")
    args = parser.parse_args()
    scenes = args.scenes or [str(HERE / "scenes" / f"{name}.toml") for name in SCENES + CAMERAS]
    with tempfile.TemporaryDirectory() as folder:
        take_away_bounds(Path(folder))
        with worker(Path(folder)) as plain, worker(HERE) as exact:
            print(f"{'scene':<26}{'AOVs':<10}{'exact ms':>12}{'plain ms':>12}{'exact / plain':>16}")
            for scene in scenes:
                for what, aovs in (("default", BY_DEFAULT), ("depth", DEPTH)):
                    pairs = [(seconds(exact, scene, aovs), seconds(plain, scene, aovs)) for _ in range(TURNS)]
                    a, b = (1e3 * statistics.median(times) for times in zip(*pairs, strict=True))
                    ratio = statistics.median(a / b for a, b in pairs)
                    print(f"{Path(scene).stem:<26}{what:<10}{a:12.1f}{b:12.1f}{ratio:16.2f}", flush=True)


if __name__ == "__main__":
    main()
