"""The scenes of this repository as thumbnails with their names, docs/scenes.png: python docs/scenes.py"""

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw
from PIL.PngImagePlugin import PngInfo

import caster
from caster.image.previews import aov_view

ROOT = Path(__file__).resolve().parents[1]
SIDE, LABEL, GAP, COLUMNS = 160, 18, 4, 9  # pixels, and thumbnails of a row
DARK = 30, 30, 30


def thumbnail(path: Path) -> Image.Image:
    """A scene of at most SIDE x SIDE pixels, by its light or, without any, by its normals."""
    scene = caster.load_scene(path)
    share = min(1.0, SIDE / max(scene.film.width, scene.film.height))
    width, height = (max(1, round(share * side)) for side in (scene.film.width, scene.film.height))
    aov = "diffuse" if scene.lights else "normal"
    aovs = caster.render(scene.with_film(width=width, height=height), (aov,))
    pixels = aov_view(aov, aovs[aov], aovs.hit).pixels
    times = max(1, SIDE // max(pixels.shape))  # of a film that is smaller
    return Image.fromarray(pixels.repeat(times, axis=0).repeat(times, axis=1))


def main() -> None:
    paths = sorted((ROOT / "scenes").glob("*.toml"))
    step, rows = np.array([SIDE + GAP, SIDE + LABEL + GAP]), -(-len(paths) // COLUMNS)
    sheet = Image.new("RGB", (COLUMNS * int(step[0]) - GAP, rows * int(step[1]) - GAP), "white")
    draw = ImageDraw.Draw(sheet)
    for i, path in enumerate(paths):
        x, y = (int(side) for side in step * [i % COLUMNS, i // COLUMNS])
        image = thumbnail(path)
        sheet.paste(image, (x + (SIDE - image.width) // 2, y + (SIDE - image.height) // 2))
        draw.text((x + SIDE / 2, y + SIDE + LABEL / 2), path.stem, fill=DARK, font_size=12, anchor="mm")
    about = PngInfo()
    about.add_itxt("Description", ", ".join(path.stem for path in paths))
    sheet.save(ROOT / "docs/scenes.png", pnginfo=about, optimize=True)


if __name__ == "__main__":
    main()
