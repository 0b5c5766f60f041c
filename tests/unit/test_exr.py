"""Writing EXR files keeps every bit; unreadable files are reported with the reason."""

import os
import resource
import signal
import struct

import numpy as np
import OpenEXR
import pytest

from caster.description.errors import FileMissing, SceneError
from caster.image import exr
from caster.image.exr import OutputError, UnreadableExr, read_exr, write_bands, write_exr

SHAPE = (5, 7)


def ramp(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=SHAPE).astype(np.float32)


def assert_same_bits(expected: np.ndarray, got: np.ndarray) -> None:
    assert got.dtype == expected.dtype
    assert got.tobytes() == np.ascontiguousarray(expected).tobytes()


# ---- writing ----


WIDE = np.random.default_rng(7).normal(size=(10, 14, 3)).astype(np.float32)


@pytest.mark.parametrize(
    "view",
    [
        pytest.param(WIDE[..., 1], id="one component of vectors"),
        pytest.param(WIDE[::-1, ::-1, 0], id="flipped"),
        pytest.param(WIDE[..., 0].T, id="transposed"),
        pytest.param(np.broadcast_to(WIDE[:1, :, 0], (6, 14)), id="broadcast"),
        pytest.param(WIDE[..., 0].astype(np.float64)[::-1].T, id="float64 flipped and transposed"),
        pytest.param(WIDE[..., 0].astype(">f4"), id="big endian"),
        pytest.param(WIDE[..., 0] > 0, id="bool"),
        pytest.param((np.arange(140).reshape(14, 10).T[::-1]).astype(np.uint32), id="uint32 strided"),
    ],
)
def test_memory_layout_never_reaches_the_file(tmp_path, view):
    before = view.copy()
    write_exr(tmp_path / "a.exr", {"Z": view})
    kind = np.uint32 if view.dtype == np.uint32 else np.float32
    assert_same_bits(np.array(before, kind), read_exr(tmp_path / "a.exr").channels["Z"])


def test_the_header_is_single_part_zip_tiles_without_a_name(tmp_path):
    write_exr(tmp_path / "a.exr", {"Z": ramp(), "id.prim": np.zeros(SHAPE, np.uint32)})
    data = (tmp_path / "a.exr").read_bytes()
    assert struct.unpack("<II", data[:8]) == (
        20000630,
        0x602,
    )  # version 2, tiled, with long names; neither deep nor parts
    header = OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True).header()
    assert "name" not in header and "capDate" not in header
    assert header["compression"] == OpenEXR.ZIP_COMPRESSION
    assert header["lineOrder"] == OpenEXR.INCREASING_Y
    assert header["type"] == OpenEXR.tiledimage


def test_provenance_lives_under_caster(tmp_path):
    long = "x" * 100_000
    write_exr(tmp_path / "a.exr", {"Z": ramp()}, {"version": "1 ü", "caster/scene_json": long, "empty": ""})
    header = OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True).header()
    expected = {"caster/empty": "", "caster/scene_json": long, "caster/version": "1 ü"}
    assert {key: value for key, value in header.items() if key.startswith("caster/")} == expected
    assert read_exr(tmp_path / "a.exr").provenance == expected


SQUARE = {"Z": np.zeros((2, 2))}


@pytest.mark.parametrize(
    ("channels", "options", "words"),
    [
        ({}, {}, ["at least one channel"]),
        ({"Z": np.zeros((2, 3)), "R": np.zeros((3, 2))}, {}, ["'R'", "(3, 2)", "'Z'", "(2, 3)"]),
        ({"normal": np.zeros((2, 3, 3))}, {}, ["'normal'", "(2, 3, 3)"]),
        ({"Z": np.zeros((0, 3))}, {}, ["'Z'", "(0, 3)"]),
        ({"Z": np.zeros((2, 2), np.int32)}, {}, ["'Z'", "uint32", "int32"]),
        ({"": np.zeros((2, 2))}, {}, ["channel name ''"]),
        ({"x" * 256: np.zeros((2, 2))}, {}, ["channel name", "255"]),
        (SQUARE, {"provenance": {"n": 3}}, ["caster/n", "string", "3"]),
        (SQUARE, {"provenance": {"k" * 250: "v"}}, ["provenance name", "255"]),
        (SQUARE, {"data_window": (0, 0, 3, 2)}, ["(0, 0, 3, 2)", "2 x 2"]),
        (SQUARE, {"data_window": (2, 0, 0, 2)}, ["data_window", "(2, 0, 0, 2)"]),
        (SQUARE, {"display_window": (0, 0, 0, 2)}, ["display_window"]),
        (SQUARE, {"display_window": (0, 0, 2, 2**31)}, ["display_window", "2^30"]),
    ],
)
def test_what_an_exr_cannot_hold_is_an_error_that_states_it(tmp_path, channels, options, words):
    with pytest.raises(SceneError) as caught:
        write_exr(tmp_path / "a.exr", channels, **options)
    assert all(word in str(caught.value) for word in words), str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_a_finite_value_beyond_float32_is_named_with_its_film_pixel(tmp_path):
    depth = np.ones(SHAPE)
    depth[3, 4] = 1e39
    with pytest.raises(SceneError, match=r"'depth.Z' at pixel \(14, 23\): 1e\+39"):
        write_exr(tmp_path / "a.exr", {"depth.Z": depth}, data_window=(10, 20, 17, 25))
    assert list(tmp_path.iterdir()) == []


# ---- nothing half-written ----


@pytest.mark.parametrize("target", ["/dev/null", "."])
def test_a_device_or_folder_is_never_replaced(here, target):
    with pytest.raises(OutputError, match="expected a file"):
        write_exr(target, {"Z": ramp()})
    assert not os.path.isfile(target)


@pytest.mark.parametrize(
    ("error", "raised"),
    [
        (OSError(28, "No space left on device"), OutputError),
        (SceneError("odd"), SceneError),
        (KeyboardInterrupt(), KeyboardInterrupt),
    ],
)
@pytest.mark.parametrize("older", [None, b"an older image"])
def test_a_write_that_stops_half_way_leaves_what_was_there(tmp_path, error, raised, older):
    target = tmp_path / "out.exr"
    if older is not None:
        target.write_bytes(older)

    def bands():
        yield {"Z": np.zeros((exr.TILE, 7))}
        raise error

    with pytest.raises(raised) as caught:
        write_bands(target, bands(), {}, (0, 0, 7, 100), (0, 0, 7, 100), 2)
    assert type(caught.value) is raised
    assert [path.name for path in tmp_path.iterdir()] == ([] if older is None else ["out.exr"])
    assert older is None or target.read_bytes() == older


@pytest.mark.parametrize("missing", [1, 200_000])
def test_a_full_disk_is_named_and_leaves_nothing(tmp_path, missing):
    """A limit on the file size stands for the disk: a write fails, the last one or one half-way."""
    noise = np.random.default_rng(0).random((256, 256)).astype(np.float32)
    write_exr(tmp_path / "out.exr", {"Z": noise})
    size = (tmp_path / "out.exr").stat().st_size
    (tmp_path / "out.exr").unlink()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size - missing, limits[1]))
    try:
        with pytest.raises(OutputError, match=r"out\.exr: cannot write: File too large \(\d+ MiB free"):
            write_exr(tmp_path / "out.exr", {"Z": noise})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)
    assert list(tmp_path.iterdir()) == []


def test_permissions_follow_the_umask_and_links_stay_links(tmp_path):
    (tmp_path / "link.exr").symlink_to(tmp_path / "real.exr")
    before = os.umask(0o027)
    try:
        write_exr(tmp_path / "link.exr", {"Z": ramp()})
    finally:
        os.umask(before)
    assert (tmp_path / "link.exr").is_symlink()
    assert (tmp_path / "real.exr").stat().st_mode & 0o777 == 0o640
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link.exr", "real.exr"]


# ---- reading what others wrote ----


def test_a_missing_file_is_file_missing(tmp_path):
    with pytest.raises(FileMissing, match=r"absent\.exr: cannot read this EXR image: No such file") as caught:
        read_exr(tmp_path / "absent.exr")
    assert not isinstance(caught.value, UnreadableExr)
    assert caught.value.exit_code == 4


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "empty (0 bytes)"),
        (b"\x89PNG\r\n\x1a\n....", "PNG'"),
        (b"v/1", "starts with 'v/1'"),
        (b"v/1\x01\x02\x08\0\0channels", "truncated"),
        (b"v/1\x01\x02\x10\0\0channels", "truncated"),
    ],
)
def test_a_file_that_is_no_image_is_unreadable(tmp_path, capfd, content, words):
    (tmp_path / "a.exr").write_bytes(content)
    with pytest.raises(UnreadableExr) as caught:
        read_exr(tmp_path / "a.exr")
    assert words in str(caught.value)
    assert str(caught.value).startswith(str(tmp_path / "a.exr"))
    assert capfd.readouterr() == ("", "")


def test_every_truncation_is_unreadable_and_nothing_is_printed(tmp_path, capfd):
    write_exr(tmp_path / "a.exr", {"Z": np.random.default_rng(0).random((40, 8)), "A": np.ones((40, 8))})
    whole = (tmp_path / "a.exr").read_bytes()
    for length in [*range(0, 420, 7), *range(420, len(whole), 97), len(whole) - 1]:
        (tmp_path / "a.exr").write_bytes(whole[:length])
        with pytest.raises(UnreadableExr):
            read_exr(tmp_path / "a.exr")
    assert capfd.readouterr() == ("", "")


# ---- tiles ----


def numbers(rows: int, columns: int) -> dict[str, np.ndarray]:
    """Channels that compress well, badly, and not at all."""
    rng = np.random.default_rng(rows)
    y, x = np.ogrid[:rows, :columns]
    noise = rng.integers(2**32, size=(rows, columns), dtype=np.uint64)
    return {
        "depth.Z": np.sqrt(x * x + y * y, dtype=np.float32),
        "R": rng.random((rows, columns)).astype(np.float32),
        "id.prim": (x // 9 + 100 * (y // 7)).astype(np.uint32),
        "a name longer than 31 bytes, such as this": noise.astype(np.uint32),
    }


SIZES = [(1, 1), (exr.TILE, exr.TILE), (exr.TILE + 1, exr.TILE - 1), (200, 150)]


@pytest.mark.parametrize(("rows", "columns"), SIZES)
@pytest.mark.parametrize("name", ["depth.Z", "a name longer than 31 bytes, such as this"])
def test_the_library_reads_each_tile_where_it_belongs(tmp_path, rows, columns, name):
    """Alone, noise is stored as it is."""
    expected = numbers(rows, columns)
    for channels in (expected, {name: expected[name]}):
        write_exr(tmp_path / "a.exr", channels, data_window=(-3, 5, columns - 3, rows + 5))
        with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
            assert file.header()["tiles"].xSize == file.header()["tiles"].ySize == exr.TILE
            assert np.array(file.header()["dataWindow"]).tolist() == [[-3, 5], [columns - 4, rows + 4]]
            assert file.channels().keys() == channels.keys()
            for each, channel in file.channels().items():
                assert_same_bits(channels[each], channel.pixels)


@pytest.mark.parametrize(("rows", "columns"), SIZES)
@pytest.mark.parametrize("step", [exr.TILE, 2 * exr.TILE])
def test_neither_bands_nor_threads_change_a_byte(tmp_path, rows, columns, step):
    channels, window = numbers(rows, columns), (2, 1, columns + 2, rows + 1)
    write_exr(tmp_path / "whole.exr", channels, {"a": "b"}, data_window=window, display_window=(0, 0, 300, 300))
    bands = [{name: values[y : y + step] for name, values in channels.items()} for y in range(0, rows, step)]
    write_bands(tmp_path / "bands.exr", iter(bands), {"a": "b"}, window, (0, 0, 300, 300), 3)
    assert (tmp_path / "whole.exr").read_bytes() == (tmp_path / "bands.exr").read_bytes()


def test_an_image_without_its_last_rows_is_no_file(tmp_path):
    with pytest.raises(ValueError, match="64 of 65 rows"):
        write_bands(tmp_path / "a.exr", [{"Z": np.zeros((64, 9))}], {}, (0, 0, 9, 65), (0, 0, 9, 65), 1)
    assert list(tmp_path.iterdir()) == []
