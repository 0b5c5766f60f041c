"""PLY files in each encoding, spelt out value by value."""

import struct

ENCODINGS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
CODES = {
    **{"char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I"},
    **{"int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I"},
    **{"float": "f", "double": "d", "float32": "f", "float64": "d"},
}
XYZ = ["float x", "float y", "float z"]
INDICES = ["list uchar int vertex_indices"]


def ply(encoding, *elements, newline="\n", extra=()):
    """A PLY file, spelt out value by value: elements are (name, properties, rows), lists are tuples."""
    lines = ["ply", f"format {encoding} 1.0", *extra]
    for name, properties, rows in elements:
        lines += [f"element {name} {len(rows)}", *(f"property {p}" for p in properties)]
    header = newline.join([*lines, "end_header", ""]).encode()
    table = [
        [cell for declared, value in zip(properties, row, strict=True) for cell in cells(declared.split(), value)]
        for _, properties, rows in elements
        for row in rows
    ]
    if encoding == "ascii":
        return header + newline.join([*(" ".join(repr(value) for _, value in row) for row in table), ""]).encode()
    return header + b"".join(struct.pack(ENCODINGS[encoding] + code, value) for row in table for code, value in row)


def cells(words, value):
    """[(struct code, number)] of one property of one row."""
    if words[0] != "list":
        return [(CODES[words[0]], value)]
    return [(CODES[words[1]], len(value)), *((CODES[words[2]], item) for item in value)]


def ply_mesh(encoding, vertices, polygons, **options):
    """A PLY file of float32 vertices and polygons."""
    return ply(encoding, ("vertex", XYZ, vertices), ("face", INDICES, [(polygon,) for polygon in polygons]), **options)
