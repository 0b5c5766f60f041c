"""Plain text is read by kernels, with the bits of the slow readers; what is not plain is left to those."""

import random

import numpy as np
import pytest

from caster.geometry.mesh_files import obj as obj_files
from caster.geometry.mesh_files import plain_text, ply
from caster.geometry.mesh_files.obj import parse_any_obj, parse_obj
from caster.geometry.mesh_files.plain_text import (
    HASH,
    PARSE_FAILED,
    POWERS_OF_TEN,
    parse_real,
    read_keyword,
    read_plain_obj,
    read_plain_rows,
)
from caster.geometry.mesh_files.ply import _read_plain, parse_header, parse_ply, read_any_ascii
from caster.jit.kernel_cache import COMPILED

SHARE = 1 if COMPILED else 10  # of what is read; without the compiler, kernels are plain Python


@pytest.fixture(autouse=True)
def read_by_kernels(monkeypatch):
    """As with the compiler, without which plain text is left to the slow readers."""
    for module in (plain_text, ply):
        monkeypatch.setattr(module, "COMPILED", True)


def number(draw: random.Random) -> str:
    """Of any length and size, as people and programs write them; some near the middle of two float64."""
    kind = draw.randrange(7)
    if kind == 0:
        return repr(draw.uniform(-10, 10) * 10.0 ** draw.randint(-30, 30))
    if kind == 1:
        return f"{draw.uniform(-1000, 1000):.{draw.randint(0, 25)}f}"
    if kind == 2:
        return f"{draw.choice(['', '+', '-'])}{draw.randrange(10 ** draw.randint(1, 20))}"
    if kind == 3:
        return f"{draw.randrange(10**17, 10**18)}e{draw.randint(-25, 25)}"
    if kind == 4:  # a float64 of 53 bits and half a step: 2^53 + odd
        return f"{2**53 + 2 * draw.randrange(10**6) + 1}{draw.choice(['', '.0', 'E0', '.00000001'])}"
    if kind == 5:
        return draw.choice(["0", "-0", "-0.0", "1.", ".5", "-.25e1", "1e400", "5e-324", "0e999999999999", "00012.5"])
    return f"{draw.uniform(-1, 1):.9g}"


def same_bits(a: np.ndarray | None, b: np.ndarray | None) -> bool:
    if a is None or b is None:
        return a is b
    return a.shape == b.shape and a.dtype == b.dtype and a.tobytes() == b.tobytes()


def test_numbers_are_rounded_to_the_nearest():
    draw, sure = random.Random(7), 0
    for _ in range(20_000 // SHARE):
        text = number(draw)
        read = read_plain_rows(text.encode() + b"\n", 0, 1, 1)
        assert read is not None, text
        assert read[0].tobytes() == np.array([[float(text)]]).tobytes(), (text, read[0], float(text))
    for _ in range(200):  # and those of 17 digits, which programs write, are nearly all read in the fast way
        text = np.frombuffer(f"{draw.uniform(-1, 1):.17g}".encode(), np.uint8)
        sure += getattr(parse_real, "function", parse_real)(text, 0, POWERS_OF_TEN)[2]
    assert sure > 190


def nearly_halfway(draw: random.Random) -> str:
    """digits * 10^-power as near as can be to the middle M / 2^s of two float64, M odd and of 54 bits.

    digits * 2^t = M * 5^power + 1 or - 1, so that M is an inverse of 5^power modulo 2^t.
    """
    while True:
        power, t, side = draw.randint(18, 22), draw.randint(40, 50), draw.choice([-1, 1])
        inverse = side * pow(5**power, -1, 2**t) % 2**t
        middle = inverse + 2**t * draw.randrange(2 ** (53 - t), 2 ** (54 - t))
        digits = (middle * 5**power - side) // 2**t
        if 2**53 < digits < 10**18:
            return f"{digits}e-{power}"


def nearly_halfway_and_large(draw: random.Random) -> str:
    """The same of digits * 10^power, near to M 2^s: digits is an inverse of 5^power, or of its negative."""
    while True:
        power, t, side = draw.randint(15, 22), draw.randint(40, 58), draw.choice([-1, 1])
        digits = side * pow(5**power, -1, 2**t) % 2**t + 2**t * draw.randrange(2 ** max(60 - t, 1))
        middle = (digits * 5**power - side) // 2**t
        if 2**53 < digits < 10**18 and middle % 2 == 1 and middle.bit_length() == 54:
            return f"{digits}e{power}"


@pytest.mark.parametrize("drawn", [nearly_halfway, nearly_halfway_and_large])
def test_numbers_nearly_halfway_between_two_float64_are_rounded_to_the_nearest(drawn):
    draw = random.Random(17)
    for _ in range(2_000 // SHARE):
        text = drawn(draw)
        read = read_plain_rows(text.encode() + b"\n", 0, 1, 1)
        assert read is not None and read[0][0, 0] == float(text), text


def obj_file(draw: random.Random) -> bytes:
    """Vertices, some uv and normals, polygons; comments, blanks and names."""
    v, vt, vn = draw.randint(3, 12), draw.choice([0, 5]), draw.choice([0, 4])
    lines = [f"v {number(draw)} {number(draw)} {number(draw)}" for _ in range(v)]
    lines += [f"vt {number(draw)}" + (f" {number(draw)}" if draw.random() < 0.8 else "") for _ in range(vt)]
    lines += [f"vn 1 {number(draw)}  {number(draw)}\t" for _ in range(vn)]
    for _ in range(draw.randint(1, 10)):
        form = draw.choice(["{v}", "{v}/{t}", "{v}//{n}", "{v}/{t}/{n}"])
        if ("{t}" in form and not vt) or ("{n}" in form and not vn):
            form = "{v}"
        corners = [
            form.format(v=draw.randint(1, v), t=draw.randint(1, vt or 1), n=draw.randint(1, vn or 1))
            for _ in range(draw.randint(3, 6))
        ]
        lines.append("f " + " ".join(corners) + draw.choice(["", " ", " # a face"]))
    for extra in ("# made", "", "  ", "o ball", "g a b", "s off", "usemtl red", "mtllib x.mtl"):
        lines.insert(draw.randint(0, len(lines)), extra)
    return draw.choice(["\n", "\r\n"]).join(lines).encode() + draw.choice([b"", b"\n"])


def test_random_obj_files_give_the_same_bits_both_ways():
    draw, plain = random.Random(11), 0
    for _ in range(400 if COMPILED else 200):
        data = obj_file(draw)
        try:
            slow = parse_any_obj(data, "x.obj")
        except obj_files.SceneError:  # a number that is not finite, where it has to be
            assert read_plain_obj(data) is None, data
            continue
        plain += read_plain_obj(data) is not None
        assert all(same_bits(a, b) for a, b in zip(parse_obj(data, "x.obj"), slow, strict=True)), data
    assert plain > (200 if COMPILED else 100)


UNUSUAL = (
    *(b"f 1 2 -1", b"f 1 2 9", b"f 1 2", b"f 1/ 2 3", b"f 1/1/1/1 2 3", b"v 1 2", b"v 1 2 x", b"v 1 2 1_0"),
    *(b"v 1 2 inf", b"v 1 2 0x10", b"vp 1", b"face 1 2 3", b"f 1 2 \\\n3", b"\rv 1 2 3", b"\x0bf 1 2 3"),
    *(b"f 1.0 2 3", b"f 0 1 2", b"f 1 2 3/", b"v 1 2 3 x", b"f 1 2 +3", b"f 99999999999999999999 1 2"),
    *(b"\xef\xbb\xbfv 1 2 3",),
)


@pytest.mark.parametrize("spoilt", UNUSUAL)
def test_what_is_not_plain_is_left_to_the_slow_reader(spoilt):
    good = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    assert read_plain_obj(good) is not None
    assert read_plain_obj(good + spoilt) is None
    assert read_plain_obj(good + spoilt + b"\n" + good) is None


@pytest.mark.parametrize("corner", [b"/1", b"//1", b"/1/1", b"/", b"1/", b"1/1/", b"1//", b"1///1", b"1/1/1/"])
def test_a_corner_without_one_of_its_numbers_is_left_to_the_slow_reader(corner):
    tables = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\n"
    assert read_plain_obj(tables + b"f 1/1/1 2//1 3/1\n") is not None
    for face in (corner + b" 2 3", b"1 2 " + corner):
        assert read_plain_obj(tables + b"f " + face) is None
        assert read_plain_obj(tables + b"f " + face + b"#\n") is None


def ply_file(draw: random.Random) -> bytes:
    v, f = draw.randint(3, 9), draw.randint(1, 9)
    names = ["x", "y", "z", *draw.choice([[], ["nx", "ny", "nz"], ["u", "v"], ["quality"]])]
    head = ["ply", "format ascii 1.0", f"element vertex {v}", *(f"property float {name}" for name in names)]
    head += [f"element face {f}", "property list uchar int vertex_indices", "end_header"]
    rows = [" ".join(number(draw) for _ in names) for _ in range(v)]
    for _ in range(f):
        size = draw.randint(3, 5)
        rows.append(" ".join(str(n) for n in [size, *(draw.randrange(v) for _ in range(size))]))
    if draw.random() < 0.2:
        rows.insert(draw.randrange(len(rows)), draw.choice(["", "1 2", "x", "3 0 1 2 3"]))
    return ("\n".join([*head, *rows]) + draw.choice(["", "\n", "\n \n"])).encode()


def test_random_ply_files_give_the_same_bits_or_the_same_words_both_ways(monkeypatch):
    draw, plain = random.Random(13), 0
    for _ in range(400 if COMPILED else 200):
        data = ply_file(draw)
        header = parse_header(data, "x.ply")
        plain += _read_plain(data, header) is not None
        fast = outcome(data)
        with monkeypatch.context() as without:
            without.setattr("caster.geometry.mesh_files.ply.read_ascii", read_any_ascii)
            slow = outcome(data)
        assert fast == slow, data
    assert plain > (200 if COMPILED else 100)


def outcome(data: bytes) -> object:
    try:
        mesh = parse_ply(data, "x.ply")
    except obj_files.SceneError as error:
        return str(error)
    return [None if a is None else (a.shape, str(a.dtype), a.tobytes()) for a in mesh]


@pytest.mark.parametrize(
    ("text", "end"),
    [("v 1", 1), ("vt\n", 2), ("usemtl a", 6), ("seven77 ", 7), ("eightlet ", PARSE_FAILED), ("v#", 1), ("#", 0)],
)
def test_a_keyword_is_read_up_to_seven_letters(text, end):
    code, found = read_keyword(np.frombuffer((text + "\n\n").encode(), np.uint8), 0)
    assert found == end and chr(HASH) == "#"
    if end != PARSE_FAILED:
        assert code.to_bytes(8, "little").rstrip(b"\0").decode() == text[:end]
