"""The worked pixel of docs/method.md and its figure: python docs/method_pixel.py

The formulas of the page, one after the other, and nothing of the judge's; a test compares the result with its bounds.
"""

import re
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import numpy as np

import caster
from mitsuba_ref.reference.shared_input import shared_rays

ROOT = Path(__file__).resolve().parents[1]
PAGE, FIGURE = ROOT / "docs/method.md", ROOT / "docs/method/pixel.svg"
SCENE, PIXEL, SHAPE = "scenes/triangles.toml", (160, 120), 1
BLOCK = re.compile(r"(?<=<!-- python docs/method_pixel.py -->\n\n```\n).*?(?=```)", re.DOTALL)
MITSUBA = re.compile(r"^Mitsuba +t ([\d.]+)", re.MULTILINE)

U, K = 2.0**-24, 4  # (1)
KU = K * U


class Bound(NamedTuple):
    """The bound of t of one triangle and one ray, and what it is made of."""

    t: float  # exact, rounded once
    cosine: float  # |n.d|
    displacement: float
    lever: float
    rho: float
    t_error: float


def ray_and_corners() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """o (3,), d (3,) and the corners (3, 3) of the triangle that the pixel shows, as both sides trace them."""
    x, y = PIXEL
    scene = caster.load_scene(ROOT / SCENE)
    rays = shared_rays(scene.with_film(crop=[x, y, x + 1, y + 1]))
    corners = np.float32(scene.shapes[SHAPE].vertices).astype(np.float64)
    return rays.o[0].astype(np.float64), rays.d[0].astype(np.float64), corners


def perm(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """The cross product of magnitudes, with additions in place of subtractions."""
    p, q = np.abs(p), np.abs(q)
    return np.roll(p, -1) * np.roll(q, -2) + np.roll(p, -2) * np.roll(q, -1)


def exact_t(o: np.ndarray, d: np.ndarray, corners: np.ndarray) -> float:
    """N.a / N.d in fractions."""

    def minus(p: list[Fraction], q: list[Fraction]) -> list[Fraction]:
        return [x - y for x, y in zip(p, q, strict=True)]

    def dot(p: list[Fraction], q: list[Fraction]) -> Fraction:
        return sum((x * y for x, y in zip(p, q, strict=True)), Fraction(0))

    origin, along, a, b, c = ([Fraction(float(x)) for x in row] for row in (o, d, *corners))
    (x, y, z), (u, v, w) = minus(b, a), minus(c, a)
    normal = [y * w - z * v, z * u - x * w, x * v - y * u]
    return float(dot(normal, minus(a, origin)) / dot(normal, along))


def bound(o: np.ndarray, d: np.ndarray, corners: np.ndarray) -> Bound:
    """Formulas (4) to (8)."""
    a, b, c = corners - o
    normal = np.cross(b - a, c - a)
    n, spread = normal / np.linalg.norm(normal), perm(b - a, c - a) / np.linalg.norm(normal)
    t, cosine = exact_t(o, d, corners), abs(n @ d)
    w = np.array([d @ np.cross(c, b), d @ np.cross(a, c), d @ np.cross(b, a)])
    w /= w.sum()
    displacement = np.abs(n) @ (np.abs(w) @ np.abs([a, b, c]) + np.abs(a) + np.abs(t * d))
    lever = np.abs(t * d - a) @ spread
    opposite = ((a, b - c), (b, c - a), (c, a - b))
    tilt = sum(np.abs(corner) @ np.abs(np.cross(edge, d)) for corner, edge in opposite)
    rho = (KU * (np.abs(n) @ np.abs(d) + np.abs(d) @ spread) + U * tilt / np.linalg.norm(normal)) / cosine
    t_error = KU * ((displacement + lever) / cosine + abs(t)) / (1 - rho)
    return Bound(t, cosine, displacement, lever, rho, t_error)


def block(it: Bound, mitsuba: float) -> str:
    """The lines of the page."""
    error = mitsuba - it.t
    x, y = PIXEL
    return (
        f"pixel         ({x}, {y}) of {SCENE}: triangle `smooth`, |n.d| {it.cosine:.3f}\n"
        f"exact         t {it.t!r}\n"
        f"Mitsuba       t {mitsuba!r}, off by {error:.2e}\n"
        f"displacement  {it.displacement:.2f}   lever {it.lever:.2f}   rho {it.rho:.1e}\n"
        f"t_error       {KU:.2e} (({it.displacement:.2f} + {it.lever:.2f}) / {it.cosine:.3f} + {it.t:.2f})"
        f" = {it.t_error:.2e}\n"
        f"used          {abs(error):.2e} / {it.t_error:.2e} = {abs(error) / it.t_error:.3f} of the bound: agree\n"
    )


FIGURE_TEXT = """\
<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 600 190" font-family="sans-serif" font-size="13">
<title>The bound of t at one pixel, and what it is made of</title>
<rect width="600" height="190" fill="#ffffff"/>
<text x="20" y="22" font-weight="bold">bound of t: {bound:.2e}</text>
<rect x="{left[0]:.1f}" y="32" width="{width[0]:.1f}" height="26" fill="#0072B2"/>
<rect x="20" y="106" width="12" height="12" fill="#0072B2"/>
<text x="40" y="116">rounded corners move the plane: {part[0]:.2e}</text>
<rect x="{left[1]:.1f}" y="32" width="{width[1]:.1f}" height="26" fill="#56B4E9"/>
<rect x="20" y="126" width="12" height="12" fill="#56B4E9"/>
<text x="40" y="136">the rounded normal tilts it: {part[1]:.2e}</text>
<rect x="{left[2]:.1f}" y="32" width="{width[2]:.1f}" height="26" fill="#E69F00"/>
<rect x="20" y="146" width="12" height="12" fill="#E69F00"/>
<text x="40" y="156">t itself is rounded: {part[2]:.2e}</text>
<path d="M{left[3]:.1f} 26V92" stroke="#000000" stroke-dasharray="4 3"/>
<text x="480" y="83" text-anchor="end">beyond: exact arithmetic decides</text>
<rect x="20" y="68" width="{width[3]:.1f}" height="20" fill="#009E73"/>
<text x="47" y="83">error of Mitsuba: {part[3]:.2e}</text>
<text x="20" y="180" fill="#555555">The bound of t in float64 is 2^28 times narrower.</text>
</svg>
"""


def figure(it: Bound, mitsuba: float) -> str:
    """The bound as a bar of its three parts, above the error of Mitsuba."""
    parts = [KU * it.displacement / it.cosine, KU * it.lever / it.cosine, KU * abs(it.t), abs(mitsuba - it.t)]
    widths = [560.0 / (1.2 * it.t_error) * part for part in parts]
    lefts = [20.0 + sum(widths[:i]) for i in range(4)]
    return FIGURE_TEXT.format(bound=it.t_error, part=parts, width=widths, left=lefts)


def with_block(page: str) -> str:
    """The page with the block of today; Mitsuba's t, whose last bits depend on the processor, is that of the page."""
    (old,) = BLOCK.findall(page)
    new = block(bound(*ray_and_corners()), mitsuba_t(page))
    return page.replace(old, new)


def mitsuba_t(page: str) -> float:
    return float(MITSUBA.findall(page)[0])


def main() -> None:
    page = with_block(PAGE.read_text(encoding="utf-8"))
    PAGE.write_text(page, encoding="utf-8")
    FIGURE.parent.mkdir(exist_ok=True)
    FIGURE.write_text(figure(bound(*ray_and_corners()), mitsuba_t(page)), encoding="utf-8")


if __name__ == "__main__":
    main()
