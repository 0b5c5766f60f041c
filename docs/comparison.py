"""The table of docs/comparison.md: faults of one image, and the answers of other tools.

    python docs/comparison.py FOLDER      # with idiff on the path, flip-evaluator and matplotlib installed

Images: cornell-box, 128 x 96, by `caster render`; the first row is Mitsuba's own image of it.
"""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

import caster
from caster.image.channels import aovs_to_channels
from caster.image.exr import read_exr, write_exr
from mitsuba_ref import render_reference
from mitsuba_ref.exr_compare.comparison_page import flip
from mitsuba_ref.exr_compare.two_files import compare_exr
from mitsuba_ref.report.output import plural

ROOT = Path(__file__).resolve().parents[1]
AOVS = ("depth", "normal", "position", "diffuse")
Channels = dict[str, np.ndarray]
AT = (40, 60)  # row, column of a pixel on a wall


def at(name: str, value: float) -> Callable[[Channels], None]:
    return lambda image: image[name].__setitem__(AT, value)


def scaled(names: str, factor: float) -> Callable[[Channels], None]:
    return lambda image: image.update({name: image[name] * np.float32(factor) for name in names.split()})


def all_nan(image: Channels) -> None:
    image.update({name: np.full_like(values, np.nan) for name, values in image.items()})


def renamed(image: Channels) -> None:
    for axis in "XYZ":
        image[f"facing.{axis}"] = image.pop(f"normal.{axis}")


def missed(image: Channels) -> None:
    for name, values in image.items():
        values[AT] = np.inf if name == "depth.Z" else 0.0


def noise(image: Channels) -> None:
    rng = np.random.default_rng(0)
    for name in "RGB":
        image[name] *= (1.0 + 0.05 * rng.normal(size=image[name].shape)).astype(np.float32)


FAULTS: dict[str, Callable[[Channels], None]] = {
    "all values NaN": all_nan,
    "one NaN in a colour": at("G", np.nan),
    "one depth inf": at("depth.Z", np.inf),
    "normals under another name": renamed,
    "one pixel missed": missed,
    "depths longer by a millionth": scaled("depth.Z", 1.0 + 1e-6),
    "depths longer by a hundred-thousandth": scaled("depth.Z", 1.0 + 1e-5),
    "colours brighter by 0.1 %": scaled("R G B", 1.001),
    "5 % noise in colours": noise,
}


def verdicts(folder: Path, a: Path, b: Path) -> list[str]:
    """The answer of each tool: compare, idiff, FLIP of the colours, RMS of matplotlib's comparison."""
    ours = compare_exr(a, b)
    idiff = subprocess.run(["idiff", str(a), str(b)], capture_output=True, check=False).returncode
    images = [read_exr(path).channels for path in (a, b)]
    colors = [np.stack([image[c].astype(np.float64) for c in "RGB"], -1) for image in images]
    return [
        {0: "pass", 1: f"**fail**, {plural(ours.differing_pixels, 'pixel')}", 3: "**not comparable**"}[ours.exit_code],
        {0: "pass", 1: "pass, warns", 2: "**fail**", 3: "**fail**"}.get(idiff, f"exit {idiff}"),
        flip(*colors).partition(":")[0],
        root_mean_square(folder, *colors),
    ]


def root_mean_square(folder: Path, *colors: np.ndarray) -> str:
    """As pytest-mpl compares: 8 bits a channel, which fail from 2 on."""
    from matplotlib import pyplot
    from matplotlib.testing.compare import compare_images

    paths = [str(folder / name) for name in ("a.png", "b.png")]
    for path, image in zip(paths, colors, strict=True):
        pyplot.imsave(path, np.clip(np.nan_to_num(image), 0.0, 1.0))
    found = compare_images(paths[1], paths[0], tol=2.0, in_decorator=True)
    return f"**fail**, {found['rms']:.2f}" if found else "pass"


def main(folder: Path) -> None:
    scene = caster.load_scene(ROOT / "scenes/cornell-box.toml").with_film(width=128, height=96)
    right = {name: values.astype(np.float32) for name, values in aovs_to_channels(caster.render(scene, AOVS)).items()}
    images, _ = render_reference(scene, AOVS)
    rows = {"rounding: Mitsuba against `caster`": {n: np.array(v) for n, v in aovs_to_channels(images).items()}}
    for what, change in FAULTS.items():
        rows[what] = {name: values.copy() for name, values in right.items()}
        change(rows[what])
    about = {"caster/scene_json": scene.canonical_json()}
    write_exr(folder / "right.exr", right, about)
    print("| image | `compare` | idiff | FLIP, mean | RMS of 8 bits |\n|---|---|---|---|---|")
    for what, image in rows.items():
        write_exr(folder / "image.exr", {n: v.astype(np.float32) for n, v in image.items()}, about)
        found = verdicts(folder, folder / "image.exr", folder / "right.exr")
        print(f"| {' | '.join([what, *found])} |", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
