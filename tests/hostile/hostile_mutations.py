"""Broken and hostile variants of a valid file: structural mutations of bytes, text, JSON and archives."""

import io
import json
import random
import re
import zipfile
from collections.abc import Callable
from pathlib import PurePath
from typing import NamedTuple

from json_paths import holder, paths_of

MAX_BAIT_BYTES = 2_000_000  # of what is repeated until something quadratic would take minutes
TEXT = {".toml", ".json", ".txt", ".xml", ".obj"}

NUMBERS = [
    "nan",
    "NaN",
    "inf",
    "-Infinity",
    "1e308",
    "-1e308",
    "1e999",
    "1e-320",
    "-0.0",
    "0",
    "-1",
    "4294967296",
    "2147483648",
    "-2147483649",
    "9007199254740993",
    "9" * 30,
    "1" * 5000,
    "0x1p9999",
    "0x1.8p-1075",
    "1_000",
    "\uff11\uff12",
    "1e",
    "1e-",
    "--1",
    "true",
    "null",
    "''",
    "[]",
    "{}",
    "[[[]]]",
    '"\\ud800"',
    '"\\u0000"',
    "\x00",
    "\x1b[2J",
]
WORDS = [
    "",
    "x",
    "a" * 100_000,
    "a." * 40_000,
    "\x00",
    "\x1b]0;title\x07",
    "\u202e",
    "%s%n",
    "../../etc/passwd",
    "/dev/zero",
    "<script>",
    "]]>",
    "&lol;",
    "${x}",
    "{x}",
    "__class__",
    "null",
    "-1",
    "1e308",
    "[" * 60,
    "\ud7ff\U0010ffff",
]


class Mutation(NamedTuple):
    """A file's new content, and what was done to it."""

    data: bytes
    what: str


Mutate = Callable[[random.Random, bytes, str], bytes]
ANY: dict[str, Mutate] = {}  # for every file
TEXTUAL: dict[str, Mutate] = {}  # for text
BY_SUFFIX: dict[str, dict[str, Mutate]] = {}  # for one kind alone


def mutated(rng: random.Random, data: bytes, name: str) -> Mutation:
    """One mutation, now and then two."""
    suffix, done = PurePath(name).suffix, []
    for _ in range(1 + (rng.random() < 0.2)):
        special = BY_SUFFIX.get(suffix, {})
        groups = [group for group in (ANY, TEXTUAL if suffix in TEXT else {}, special, special) if group]
        group = rng.choice(groups)
        kind = rng.choice(sorted(group))
        try:
            data = group[kind](rng, data, suffix)
        except (ValueError, LookupError, zipfile.BadZipFile, RecursionError):  # of a second one: no such place left
            kind = f"no {kind}"
        done.append(kind)
    return Mutation(data, ", ".join(done))


def mutation(group: dict[str, Mutate]) -> Callable[[Mutate], Mutate]:
    """Register a function under its name."""

    def register(function: Mutate) -> Mutate:
        group[function.__name__] = function
        return function

    return register


def only(*suffixes: str) -> Callable[[Mutate], Mutate]:
    def register(function: Mutate) -> Mutate:
        for suffix in suffixes:
            BY_SUFFIX.setdefault(suffix, {})[function.__name__] = function
        return function

    return register


def place(rng: random.Random, data: bytes) -> int:
    """A position, half of the time in the head."""
    return rng.randrange(max(1, min(len(data), rng.choice((400, len(data))))))


# ---- bytes


@mutation(ANY)
def truncated(rng: random.Random, data: bytes, suffix: str) -> bytes:
    return data[: place(rng, data)]


@mutation(ANY)
def empty(rng: random.Random, data: bytes, suffix: str) -> bytes:
    return rng.choice((b"", b"\n", b"\xef\xbb\xbf", b"\x00" * 4096))


@mutation(ANY)
def flipped_bits(rng: random.Random, data: bytes, suffix: str) -> bytes:
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 3, 30))):
        out[place(rng, data)] ^= 1 << rng.randrange(8)
    return bytes(out)


@mutation(ANY)
def inserted(rng: random.Random, data: bytes, suffix: str) -> bytes:
    at = place(rng, data)
    new = rng.choice(
        (b"\x00", b"\xff\xfe", b"\xc3\x28", b"\xed\xa0\x80", b"\x1b[31m", b"\r", b"\x1a", rng.randbytes(9))
    )
    return data[:at] + new + data[at:]


@mutation(ANY)
def removed(rng: random.Random, data: bytes, suffix: str) -> bytes:
    at = place(rng, data)
    return data[:at] + data[at + rng.choice((1, 4, 40)) :]


@mutation(ANY)
def doubled(rng: random.Random, data: bytes, suffix: str) -> bytes:
    a, b = sorted((place(rng, data), place(rng, data)))
    return data[:b] + data[a:b] + data[b:]


@mutation(ANY)
def overwritten_integer(rng: random.Random, data: bytes, suffix: str) -> bytes:
    """Four or eight bytes: counts and sizes of binary formats, of either sign and byte order."""
    size = rng.choice((4, 8))
    at = place(rng, data)
    number = rng.choice((0, 1, 2**31 - 1, 2**31, 2**32 - 1, 2**62, 2**63 - 1)) % 2 ** (8 * size)
    return data[:at] + number.to_bytes(size, rng.choice(("little", "big"))) + data[at + size :]


@mutation(ANY)
def number_of_the_head(rng: random.Random, data: bytes, suffix: str) -> bytes:
    """Decimal digits in the first bytes, such as counts of a header."""
    found = list(re.finditer(rb"-?\d+", data[:600]))
    one = rng.choice(found)
    return data[: one.start()] + rng.choice(NUMBERS).encode(errors="surrogatepass") + data[one.end() :]


# ---- text


def as_text(data: bytes) -> str:
    return data.decode("utf-8", "surrogateescape")


def as_bytes(text: str) -> bytes:
    return text.encode("utf-8", "surrogateescape")


@mutation(TEXTUAL)
def with_mark(rng: random.Random, data: bytes, suffix: str) -> bytes:
    return rng.choice(
        (b"\xef\xbb\xbf" + data, as_bytes("\ufeff" + as_text(data)), as_text(data).encode("utf-16", "replace"))
    )


@mutation(TEXTUAL)
def other_line_ends(rng: random.Random, data: bytes, suffix: str) -> bytes:
    return data.replace(b"\n", rng.choice((b"\r\n", b"\r", b"\n\n\n", b"\x0b", b" ")))


@mutation(TEXTUAL)
def replaced_number(rng: random.Random, data: bytes, suffix: str) -> bytes:
    text = as_text(data)
    one = rng.choice(list(re.finditer(r"-?\d+(\.\d+)?(e[-+]?\d+)?", text)))
    return as_bytes(text[: one.start()] + rng.choice(NUMBERS) + text[one.end() :])


@mutation(TEXTUAL)
def replaced_word(rng: random.Random, data: bytes, suffix: str) -> bytes:
    text = as_text(data)
    words = list(re.finditer(r"[A-Za-z_/.]+", text))
    one = rng.choice(words)
    new = rng.choice([*WORDS, rng.choice(words)[0], rng.choice(words)[0]])
    return as_bytes(text[: one.start()] + new + text[one.end() :])


@mutation(TEXTUAL)
def lines_moved(rng: random.Random, data: bytes, suffix: str) -> bytes:
    """One line twice, gone, or elsewhere."""
    lines = data.split(b"\n")
    one = rng.randrange(len(lines))
    line = lines.pop(one)
    for _ in range(rng.randrange(3)):
        lines.insert(rng.randrange(len(lines) + 1), line)
    return b"\n".join(lines)


@mutation(TEXTUAL)
def repeated_lines(rng: random.Random, data: bytes, suffix: str) -> bytes:
    """A few lines thousands of times: what is quadratic takes minutes."""
    lines = data.split(b"\n")
    a = rng.randrange(len(lines))
    block = b"\n".join(lines[a : a + rng.choice((1, 3, 8))]) + b"\n"
    times = min(20_000, MAX_BAIT_BYTES // max(1, len(block)))
    return b"\n".join(lines[:a]) + b"\n" + block * times + b"\n".join(lines[a:])


@mutation(TEXTUAL)
def nested(rng: random.Random, data: bytes, suffix: str) -> bytes:
    text = as_text(data)
    one = rng.choice(list(re.finditer(r"-?\d+(\.\d+)?|\"[^\"]*\"", text)))
    depth = rng.choice((5, 33, 2000, 100_000))
    opens, closes = rng.choice((("[", "]"), ('{"a":', "}"), ("{a=", "}"), ("<shape>", "</shape>"), ("{ ", " }")))
    end = closes * depth if rng.random() < 0.5 else ""
    return as_bytes(text[: one.start()] + opens * depth + "1" + end + text[one.end() :])


# ---- kinds


@only(".toml")
def toml_bait(rng: random.Random, data: bytes, suffix: str) -> bytes:
    text = rng.choice(
        [
            '[[shape]]\ntype = "sphere"\nradius = -1\n' * 20_000,
            '[[shape]]\ntype = "mesh"\nfile = "no.obj"\n' * 3_000,
            '[[shape]]\ntype = "cube"\nto_world = [' + "{ translate = [1, 0, 0] }, " * 20_000 + "]\n",
            '[[shape]]\ntype = "triangle"\nvertices = ' + "[" * 5000 + "]" * 5000 + "\n",
            "".join(f"[material.m{i}]\nreflectance = [2, 0, 0]\n" for i in range(20_000)),
            "".join(f"k{i} = 1\n" for i in range(100_000)),
            "a." * 30_000 + "a = 1\n",
            '[[light]]\ntype = "ambient"\nradiance = [1, 1, 1]\n' * 10_000,
            '[[shape]]\ntype = "heightfield"\nresolution = 500\n' * 2,
            '[[shape]]\ntype = "icosphere"\nsubdivisions = 9\n',
            'x = """' + "a" * 1_000_000,
        ]
    )
    return data + b"\n" + as_bytes(text)


@only(".obj")
def obj_bait(rng: random.Random, data: bytes, suffix: str) -> bytes:
    text = rng.choice(
        [
            "f " + "1 2 " * 1000,
            "f 1 2 999999999\n" * 50_000,
            "f 1/1/1 2/2/2 3//\n" * 50_000,
            "o x\n" * 200_000,
            "usemtl x\n" * 100_000,
            "v 1 2\n" * 100_000,
            "v " + "1 " * 500_000,
            "v 1 2 3 \\\n" * 50_000,
            "f -1 -1 -2\n" * 1000,
            "f -99999999999999999999 1 2\n",
            "v " + "1" * 1_000_000 + " 0 0\n",
            "vt nan inf\n" * 9,
            "mtllib /dev/zero\nmtllib ../../../etc/passwd\n",
            "call x.obj\n",
        ]
    )
    return data + b"\n" + as_bytes(text)


@only(".ply")
def ply_header(rng: random.Random, data: bytes, suffix: str) -> bytes:
    """Header lines replaced, repeated or contradicted."""
    head, end, body = data.partition(b"end_header\n")
    lines = head.split(b"\n")
    i = rng.randrange(1, max(2, len(lines) - 1))
    new = rng.choice(
        [
            b"element vertex -1",
            b"element vertex 4000000000",
            b"element face 99999999999999999999",
            b"element x 1",
            b"property list uchar int vertex_indices",
            b"property list float double x",
            b"property double x",
            b"property list int int vertex_indices",
            b"format binary_big_endian 1.0",
            b"format ascii 1.0",
            b"format x 9",
            b"property float p\n" * 100_000,
            b"comment x\n" * 100_000,
            b"element e 0\n" * 50_000,
            b"property uchar x",
            b"",
            b"comment " + b"x" * 1_000_000,
            b"\x00",
            b"property",
        ]
    )
    lines[i : i + rng.randrange(2)] = [new]
    return b"\n".join(lines) + end + body


@only(".xml")
def xml_bait(rng: random.Random, data: bytes, suffix: str) -> bytes:
    entities = "".join(f'<!ENTITY e{i + 1} "{f"&e{i};" * 10}">' for i in range(12))
    heads = [
        f'<!DOCTYPE x [<!ENTITY e0 "lol">{entities}]>',
        '<!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/passwd">]>',
        '<!DOCTYPE x SYSTEM "http://127.0.0.1:9/x.dtd">',
        '<?xml version="1.0" encoding="utf-7"?>',
    ]
    insides = [
        '<default name="a" value="1"/>' * 20_000,
        '<include filename="mitsuba.xml"/>',
        '<include filename="/dev/zero"/>',
        "&e12;&e;",
        "<shape type='sphere'>" * 50_000,
        "".join(
            f'<shape type="shapegroup" id="g{i}"><shape type="sphere"/></shape>'
            f'<shape type="instance"><ref id="g{i}"/></shape>'
            for i in range(3000)
        ),
        '<shape type="instance"><ref id="no"/></shape>' * 20_000,
        '<transform name="to_world"><matrix value="' + "1 " * 300_000 + '"/></transform>',
        '<shape type="obj"><string name="filename" value="/dev/zero"/></shape>',
        '<shape type="ply"><string name="filename" value="../../in/fifo.ply"/></shape>',
        '<bsdf type="diffuse" id="b"><ref id="b"/></bsdf>',
        '<default name="x" value="$x$x$x$x$x$x$x$x"/>' * 40 + '<float name="$x" value="$x"/>',
    ]
    if rng.random() < 0.3:
        return as_bytes(rng.choice(heads)) + data
    return data.replace(b"</scene>", as_bytes(rng.choice(insides)) + b"</scene>")


@only(".txt")
def course_bait(rng: random.Random, data: bytes, suffix: str) -> bytes:
    one = "Sphere { center 0 0 0 radius 1 }"
    return data + as_bytes(
        rng.choice(
            [
                "Group { numObjects 1 " * 50_000,
                f"Group {{ numObjects 1000000000 {one} }}",
                f"Group {{ numObjects 20000 {one * 20_000} }}",
                "Transform { " + "Scale 2 2 2 " * 50_000 + one + " }",
                "TriangleMesh { obj_file /dev/zero }",
                "TriangleMesh { obj_file in/mesh.obj }" * 2000,
                "Group { numObjects -1 }",
                "Materials { numMaterials 99999999 }",
                "Group { numObjects 1 MaterialIndex -5 " + one + " }",
            ]
        )
    )


@only(".json")
def replaced_leaf(rng: random.Random, data: bytes, suffix: str) -> bytes:
    """Any value or table of the JSON."""
    record = json.loads(data)
    path = rng.choice(list(paths_of(record)))
    here = holder(record, path)
    new = rng.choice([*NUMBERS, "[" * 100_000, '"' + "x" * 100_000 + '"', '{"": null}', '"../../x"', '"\\u001b[2J"'])
    if not path:
        return new.encode(errors="surrogatepass")
    if isinstance(here, dict) and rng.random() < 0.2:
        del here[path[-1]]
        return json.dumps(record).encode()
    here[path[-1]] = "@@"
    return json.dumps(record).replace('"@@"', new).encode(errors="surrogatepass")


@only(".npy")
def npy_header(rng: random.Random, data: bytes, suffix: str) -> bytes:
    """Shape, type and order of the array, at the same length."""
    new = rng.choice(
        [
            b"'shape': (4294967296, 8)",
            b"'shape': (-1, 8)",
            b"'shape': ()",
            b"'shape': (2**62, 8)",
            b"'shape': (1e9,)",
            b"'descr': '|O'",
            b"'descr': '<f2'",
            b"'descr': '>f8'",
            b"'descr': '<c16'",
            b"'descr': [('a', '<f8')]",
            b"'shape': " + b"(" * 2000,
            b"'descr': __import__('os')",
            b"'fortran_order': True",
            b"'descr': '<M8[s]'",
        ]
    )
    key = new.partition(b":")[0]
    end = data.index(b"\n") + 1
    head = re.sub(re.escape(key) + rb": (\([^)]*\)|'[^']*'|\w+)", lambda _: new, data[10:end])
    if rng.random() < 0.5:
        head = head.rstrip(b" \n").ljust(len(data[10:end]) - 1)[: len(data[10:end]) - 1] + b"\n"
    return data[:8] + (len(head) % 65536).to_bytes(2, "little") + head + data[end:]


@only(".npz")
def inside_archive(rng: random.Random, data: bytes, suffix: str) -> bytes:
    """A member mutated, and packed again with a digest that fits; its name changed, or it is packed twice."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = [(name, archive.read(name)) for name in archive.namelist()]
    i = rng.randrange(len(members))
    name, content = members[i]
    if rng.random() < 0.8:
        content = mutated(rng, content, "x.npy").data
    else:
        name = rng.choice(("../../x.npy", "/abs.npy", "t\x00.npy", "t", "T.npy", "\x1b[2J.npy"))
    members[i : i + rng.randrange(2)] = [(name, content)]
    return zipped(members)


@only(".npz")
def archive_bomb(rng: random.Random, data: bytes, suffix: str) -> bytes:
    """A few kilobytes that unpack to a gigabyte."""
    shape = f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({2**24}, 8), }}".ljust(117) + "\n"
    head = b"\x93NUMPY\x01\x00" + len(shape).to_bytes(2, "little") + shape.encode()
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        first = archive.namelist()[0]
    return zipped([(first, head + bytes(2**27))])


def zipped(members: list[tuple[str, bytes]]) -> bytes:
    import warnings

    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # two members of one name
        for name, content in members:
            archive.writestr(name, content)
    return out.getvalue()


@only(".exr")
def exr_header(rng: random.Random, data: bytes, suffix: str) -> bytes:
    """A word of the header, an attribute's size, the window, or the table of offsets."""
    end = min(len(data), 4000)
    names = [b"channels", b"dataWindow", b"displayWindow", b"compression", b"lineOrder", b"chlist", b"box2i", b"string"]
    found = [match for name in names for match in re.finditer(name, data[:end])]
    one = rng.choice(found)
    if rng.random() < 0.3:
        return data[: one.start()] + rng.choice((b"x", b"", b"\xff" * 300, b"\x1b[2J")) + data[one.end() :]
    at = one.end() + rng.randrange(24)
    number = rng.choice((0, 1, -1, 2**31 - 1, -(2**31), 100_000)) % 2**32
    return data[:at] + number.to_bytes(4, "little") + data[at + 4 :]
