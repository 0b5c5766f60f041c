"""Make docs/every-shape.png, the picture of the README: python docs/picture.py"""

import struct
import tempfile
import zlib
from pathlib import Path

import numpy as np

from caster import load_scene, read_exr
from mitsuba_ref.validation import validate_scene
from mitsuba_ref.verdict import CLASSES

DOCS = Path(__file__).parent
NAME = "every-shape"
GAP = 4  # white pixels between panels

COLOR = {
    "agree": (70, 120, 80),
    "explained": (255, 150, 0),
    "tie": (0, 200, 200),
    "reference_wrong": (200, 90, 255),
    "out_of_domain": (90, 90, 255),
    "ours_wrong": (255, 0, 0),
    "undecided": (255, 255, 0),
}  # black where neither side hits
COLORS = np.array([COLOR[name] for name in CLASSES], np.uint8)


def main() -> None:
    """Validate the scene and lay out what became of it."""
    scene = load_scene(DOCS.parent / "scenes" / f"{NAME}.toml")
    with tempfile.TemporaryDirectory() as folder:
        verdict = validate_scene(scene, NAME, folder=Path(folder))
        ours, classes = (
            read_exr(Path(folder) / f"{NAME}.{part}.exr").channels for part in ("ours", "verdict")
        )
    panels = [diffuse(ours), normals(ours), depth(ours), COLORS[classes["class.I"]] * hit(ours)]
    (DOCS / f"{NAME}.png").write_bytes(png(grid(panels)))
    print(verdict.counts)


def hit(ours: dict[str, np.ndarray]) -> np.ndarray:
    """(h, w, 1), 1 where something was hit."""
    return (ours["A"] > 0.0)[..., None].astype(np.uint8)


def diffuse(ours: dict[str, np.ndarray]) -> np.ndarray:
    """Radiance, brightest twentieth clipped, with a gamma for the screen."""
    rgb = np.stack([ours[c] for c in "RGB"], axis=-1)
    return to_bytes((rgb / np.quantile(rgb, 0.95)) ** (1.0 / 2.2))


def normals(ours: dict[str, np.ndarray]) -> np.ndarray:
    """x, y, z of the shading normal as red, green, blue."""
    n = np.stack([ours[f"shading_normal.{c}"] for c in "XYZ"], axis=-1)
    return to_bytes(0.5 + 0.5 * n) * hit(ours)


def depth(ours: dict[str, np.ndarray]) -> np.ndarray:
    """Near is bright; by the logarithm, since a plane goes far."""
    z = np.log(np.where(np.isfinite(ours["depth.Z"]), ours["depth.Z"], np.nan))
    near, far = np.nanquantile(z, [0.0, 0.95])
    return to_bytes(np.repeat((1.0 - (z - near) / (far - near))[..., None], 3, axis=-1)) * hit(ours)


def to_bytes(values: np.ndarray) -> np.ndarray:
    return np.round(255.0 * np.clip(np.nan_to_num(values), 0.0, 1.0)).astype(np.uint8)


def grid(panels: list[np.ndarray]) -> np.ndarray:
    """Four panels, two by two."""
    across = np.full((panels[0].shape[0], GAP, 3), 255, np.uint8)
    rows = [np.hstack([panels[i], across, panels[i + 1]]) for i in (0, 2)]
    return np.vstack([rows[0], np.full((GAP, rows[0].shape[1], 3), 255, np.uint8), rows[1]])


def png(image: np.ndarray) -> bytes:
    """(h, w, 3) uint8 as a PNG file."""
    height, width, _ = image.shape
    lines = np.concatenate([np.zeros((height, 1), np.uint8), image.reshape(height, -1)], axis=1)
    chunks = (
        (b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)),
        (b"IDAT", zlib.compress(lines.tobytes(), 9)),
        (b"IEND", b""),
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunk(kind, data) for kind, data in chunks)


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


if __name__ == "__main__":
    main()
