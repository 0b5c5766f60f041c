"""Make docs/every-shape.png, the picture of the README: python docs/readme_images.py"""

import tempfile
from pathlib import Path

from caster import load_scene
from caster.image.image_files import write_image
from caster.image.previews import exr_images, sheet
from mitsuba_ref.report.validation import validate_scene

DOCS = Path(__file__).parent
NAME = "every-shape"


def main() -> None:
    """Validate the scene and lay out what became of it: what was seen, and the class of each pixel."""
    scene = load_scene(DOCS.parent / "scenes" / f"{NAME}.toml")
    with tempfile.TemporaryDirectory() as folder:
        verdict = validate_scene(scene, NAME, folder=Path(folder))
        pictures = [
            *exr_images(Path(folder) / f"{NAME}.ours.exr", ["diffuse", "shading_normal", "depth"]),
            *exr_images(Path(folder) / f"{NAME}.verdict.exr", ["class"]),
        ]
    write_image(str(DOCS / f"{NAME}.png"), sheet(pictures, columns=2))
    for picture in pictures:
        print(f"{picture.name}: {picture.legend}")
    print(verdict.counts)


if __name__ == "__main__":
    main()
