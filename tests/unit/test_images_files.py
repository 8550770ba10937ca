"""EXR, PNG, npz and text files: exact values, stable bytes, all or nothing."""

from __future__ import annotations

import errno
import hashlib
import os
import re
import struct
import zlib
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest
from hypothesis import given, settings, strategies as st
from hypothesis.extra import numpy as hnp

from lightopt.core.errors import InputError
from lightopt.core.provenance import file_sha256
from lightopt.images import read_exr, read_metadata, read_png, write_exr, write_npz_atomic, write_png, write_text_atomic
from lightopt.images._atomic import write_atomically

RNG = np.random.default_rng(0)
NOISE = RNG.normal(size=(70, 33)).astype(np.float32)
METADATA = {"light": "light1", "angle": 0.1, "größe": [1, 2, None], "deep": {"b": 1, "a": True}}


@pytest.fixture
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("größe %d")


def test_exr_keeps_values_channels_and_metadata(folder: Path):
    channels = {"Y": NOISE, "diffuse.Y": NOISE * 2, "N.X": -NOISE, "Z": NOISE + 1, "patch": np.floor(NOISE)}
    channels["Y"] = channels["Y"].copy()
    channels["Y"][0, :4] = [np.nan, np.inf, 1e-42, 1e7]
    digest = write_exr(folder / "a.exr", channels, metadata=METADATA)
    assert digest == hashlib.sha256((folder / "a.exr").read_bytes()).hexdigest()
    read = read_exr(folder / "a.exr")
    assert list(read) == sorted(channels)
    for name, values in channels.items():
        assert read[name].dtype == np.float32
        assert np.array_equal(read[name], values, equal_nan=True), name
    assert read_metadata(folder / "a.exr") == METADATA


def test_exr_of_more_rows_than_a_block_and_of_a_strided_view(folder: Path):
    values = RNG.random((1100, 24), dtype=np.float32)
    write_exr(folder / "a.exr", {"Y": values[::2, ::-1]}, metadata={})
    assert np.array_equal(read_exr(folder / "a.exr")["Y"], values[::2, ::-1])


def test_same_input_gives_the_same_bytes_at_any_time_and_thread_count(folder: Path, monkeypatch):
    hashes = set()
    levels = (NOISE * 1000).astype(np.uint16)
    threads = [OpenImageIO.get_int_attribute(name) for name in ("threads", "exr_threads")]
    try:
        for i, count in enumerate((1, 2, 4)):
            OpenImageIO.attribute("threads", count)
            OpenImageIO.attribute("exr_threads", count)
            monkeypatch.setenv("TZ", f"UTC{i}")  # a local time in the file would move
            exr = write_exr(folder / "a.exr", {"Y": np.tile(NOISE, (9, 9))}, metadata=METADATA)
            png = write_png(folder / "a.png", levels, metadata=dict(reversed(METADATA.items())))
            npz = write_npz_atomic(folder / "a.npz", {"x": NOISE})
            hashes.add((exr, png, npz))
    finally:
        for name, count in zip(("threads", "exr_threads"), threads, strict=True):
            OpenImageIO.attribute(name, count)
    assert len(hashes) == 1


def test_files_carry_no_date(folder: Path):
    write_exr(folder / "a.exr", {"Y": NOISE}, metadata={})
    write_png(folder / "a.png", np.zeros((3, 3), np.uint8), metadata={})
    assert not re.search(rb"\d{4}:\d\d:\d\d \d\d:", (folder / "a.exr").read_bytes())
    assert b"tIME" not in (folder / "a.png").read_bytes()
    for name in ("a.exr", "a.png"):
        image = OpenImageIO.ImageInput.open(str(folder / name))
        assert not image.spec().getattribute("DateTime")
        image.close()


@settings(max_examples=25)
@given(hnp.arrays(st.sampled_from([np.uint8, np.uint16]), hnp.array_shapes(min_dims=2, max_dims=2, max_side=9)))
def test_png_keeps_every_level_of_8_and_16_bits(tmp_path_factory, levels: np.ndarray):
    path = tmp_path_factory.mktemp("png") / "a.png"
    write_png(path, levels, metadata={})
    read = read_png(path)
    assert read.dtype == levels.dtype
    assert np.array_equal(read, levels)


def test_png_keeps_right_aligned_twelve_bits_and_metadata_and_says_nothing_of_colour(folder: Path):
    levels = np.arange(4096, dtype=np.uint16).reshape(64, 64)
    write_png(folder / "a.png", levels, metadata=METADATA)
    assert np.array_equal(read_png(folder / "a.png"), levels)
    assert read_metadata(folder / "a.png") == METADATA
    data = (folder / "a.png").read_bytes()
    assert not any(chunk in data for chunk in (b"sRGB", b"gAMA", b"cHRM", b"cICP"))


def test_colour_png_only_when_requested(folder: Path):
    picture = RNG.integers(0, 256, (5, 7, 3)).astype(np.uint8)
    write_png(folder / "a.png", picture, metadata={})
    with pytest.raises(InputError, match=r"expected 8- or 16-bit grey, found 8-bit RGB"):
        read_png(folder / "a.png")
    assert np.array_equal(read_png(folder / "a.png", colour=True), picture)


def foreign_png(bits: int, kind: int, rows: bytes, *chunks: bytes) -> bytes:
    """A PNG of 8 × 1 pixels made by hand."""

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    header = struct.pack(">IIBBBBB", 8, 1, bits, kind, 0, 0, 0)
    extra = b"".join(chunk(data[:4], data[4:]) for data in chunks)
    body = chunk(b"IDAT", zlib.compress(b"\0" + rows))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + extra + body + chunk(b"IEND", b"")


@pytest.mark.parametrize(
    ("data", "found"),
    [
        (foreign_png(1, 0, b"\xa5"), "1-bit grey"),
        (foreign_png(4, 0, b"\x12\x34\x56\x78"), "4-bit grey"),
        (foreign_png(8, 3, bytes(8), b"PLTE" + bytes(range(24))), "8-bit palette"),
        (foreign_png(8, 4, bytes(16)), "8-bit grey with alpha"),
        (foreign_png(8, 0, bytes(8), b"tRNS\0\0"), "transparent"),
    ],
)
def test_png_whose_levels_would_be_changed_by_decoding_is_refused(folder: Path, data: bytes, found: str):
    (folder / "a.png").write_bytes(data)
    with pytest.raises(InputError, match=found):
        read_png(folder / "a.png", colour=True)


def test_plain_foreign_png_with_gamma_is_read_untouched(folder: Path):
    (folder / "a.png").write_bytes(foreign_png(8, 0, bytes(range(8)), b"gAMA" + struct.pack(">I", 45455)))
    assert read_png(folder / "a.png").tolist() == [list(range(8))]
    assert read_metadata(folder / "a.png") == {}


@pytest.mark.parametrize("reader", [read_exr, read_png, read_metadata])
def test_missing_empty_truncated_and_mistaken_files_are_named(folder: Path, reader):
    exr = "exr" in reader.__name__
    good = folder / ("a.exr" if exr else "a.png")
    other = folder / ("b.png" if exr else "b.exr")
    write_exr(good if exr else other, {"Y": NOISE}, metadata={})
    write_png(other if exr else good, np.zeros((70, 33), np.uint8), metadata={})
    with pytest.raises(InputError, match="missing"):
        reader(folder / "missing")
    (folder / "empty").write_bytes(b"")
    with pytest.raises(InputError, match="empty"):
        reader(folder / "empty")
    if reader is not read_metadata:
        with pytest.raises(InputError, match=r"b\."):
            reader(other)
        (folder / "cut").write_bytes(good.read_bytes()[: good.stat().st_size * 2 // 3])
        with pytest.raises(InputError, match="cut"):
            reader(folder / "cut")
    assert not OpenImageIO.geterror()  # an error left there is printed when Python ends


def write_foreign_exr(path: Path, change, channel_type: str = "float") -> None:
    spec = OpenImageIO.ImageSpec(8, 4, 1, channel_type)
    spec.channelnames = ("Y",)
    change(spec)
    output = OpenImageIO.ImageOutput.create("openexr")
    assert output.open(str(path), spec)
    assert output.write_image(np.ones((spec.height, spec.width, 1), channel_type.replace("uint", "uint32")))
    output.close()


def test_half_exr_is_widened(folder: Path):
    spec = OpenImageIO.ImageSpec(8, 4, 1, "half")
    spec.channelnames = ("Y",)
    output = OpenImageIO.ImageOutput.create("openexr")
    assert output.open(str(folder / "a.exr"), spec)
    output.write_image(np.full((4, 8, 1), 1.5, np.float32))
    output.close()
    assert (read_exr(folder / "a.exr")["Y"] == 1.5).all()
    assert read_metadata(folder / "a.exr") == {}


def test_integer_channels_and_cropped_windows_are_refused(folder: Path):
    write_foreign_exr(folder / "a.exr", lambda spec: None, "uint")
    with pytest.raises(InputError, match="expected float or half, found uint"):
        read_exr(folder / "a.exr")

    def crop(spec) -> None:
        spec.full_width = 16

    write_foreign_exr(folder / "b.exr", crop)
    with pytest.raises(InputError, match="data window"):
        read_exr(folder / "b.exr")


def test_damaged_metadata_are_an_error(folder: Path):
    write_foreign_exr(folder / "a.exr", lambda spec: spec.attribute("lightopt:json", "{"))
    with pytest.raises(InputError, match="not valid JSON"):
        read_metadata(folder / "a.exr")
    write_foreign_exr(folder / "a.exr", lambda spec: spec.attribute("lightopt:json", "[1]"))
    with pytest.raises(InputError, match="JSON object"):
        read_metadata(folder / "a.exr")


@pytest.mark.parametrize(
    "channels",
    [{}, {"Y": NOISE.astype(np.float64)}, {"Y": NOISE[0]}, {"Y": NOISE[:0]}, {"Y": NOISE, "Z": NOISE[1:]}, {"": NOISE}],
)
def test_channels_that_are_no_image_are_refused(folder: Path, channels: dict):
    with pytest.raises(InputError, match=r"a\.exr"):
        write_exr(folder / "a.exr", channels, metadata={})
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize("levels", [NOISE, np.zeros((3, 3, 3), np.uint16), np.zeros((0, 3), np.uint8)])
def test_levels_that_are_no_png_are_refused(folder: Path, levels: np.ndarray):
    with pytest.raises(InputError, match=r"a\.png"):
        write_png(folder / "a.png", levels, metadata={})
    assert list(folder.iterdir()) == []


def test_npz_keeps_arrays_and_refuses_objects(folder: Path):
    arrays = {"points": NOISE.T, "index": np.arange(5), "name": np.array(["a", "bc"]), "scalar": np.array(3.5)}
    digest = write_npz_atomic(folder / "a.npz", arrays)
    assert digest == file_sha256(folder / "a.npz")
    with np.load(folder / "a.npz") as read:
        assert read.files == list(arrays)
        assert all(np.array_equal(read[name], array) for name, array in arrays.items())
        assert read["scalar"].shape == ()
    with pytest.raises(ValueError, match="Object arrays"):
        write_npz_atomic(folder / "b.npz", {"bad": np.array([None])})
    assert not (folder / "b.npz").exists()


def test_text_is_utf8_with_its_own_line_ends(folder: Path):
    digest = write_text_atomic(folder / "a.txt", "größe\nσ\n")
    assert (folder / "a.txt").read_bytes() == "größe\nσ\n".encode()
    assert digest == hashlib.sha256("größe\nσ\n".encode()).hexdigest()


LEVELS = (np.abs(NOISE) * 9999).astype(np.uint16)
WRITERS = {
    "exr": lambda path, rows=70: write_exr(path, {"Y": NOISE[:rows]}, metadata={}),
    "png": lambda path, rows=70: write_png(path, LEVELS[:rows], metadata={}),
    "npz": lambda path, rows=70: write_npz_atomic(path, {"x": NOISE[:rows]}),
    "txt": lambda path, rows=70: write_text_atomic(path, "new\n" * rows),
}


@pytest.fixture(params=WRITERS)
def writer(request):
    return WRITERS[request.param]


@pytest.mark.parametrize("step", ["fsync", "replace"])
@pytest.mark.parametrize("failure", [OSError, KeyboardInterrupt])
def test_failure_at_the_end_keeps_the_old_file_and_leaves_no_other(folder, writer, monkeypatch, step, failure):
    path = folder / "result"
    path.write_text("old")

    def fail(*args: object) -> None:
        raise failure(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, step, fail)
    expected = InputError if failure is OSError else KeyboardInterrupt
    with pytest.raises(expected) as caught:
        writer(path)
    if expected is InputError:
        assert "result: cannot be written: No space left on device" in str(caught.value)
    assert path.read_text() == "old"
    assert list(folder.iterdir()) == [path]


def test_failure_within_the_encoder_leaves_nothing(folder, monkeypatch):
    class Broken:
        def open(self, *args: object) -> bool:
            return True

        def write_scanlines(self, *args: object) -> bool:
            return False

        def close(self) -> bool:
            return True

        def geterror(self) -> str:
            return "encoder broke\nmore"

    monkeypatch.setattr(OpenImageIO.ImageOutput, "create", lambda name: Broken())
    for name in ("exr", "png"):
        with pytest.raises(InputError, match="encoder broke"):
            WRITERS[name](folder / "a")
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize("rows", [1, 70])
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no /dev/full")
def test_full_disk_is_reported_by_the_systems_reason(folder, writer, rows):
    """Every write to the file fails; encoders hide it when the whole file fits their buffer."""
    (folder / ".result.partial").symlink_to("/dev/full")
    with pytest.raises(InputError, match=r"result: cannot be written: No space left on device"):
        writer(folder / "result", rows)
    assert list(folder.iterdir()) == []
    assert Path("/dev/full").exists()


def test_missing_folder_and_folder_in_the_way_are_named(folder, writer):
    with pytest.raises(InputError, match=r"nowhere.*No such file"):
        writer(folder / "nowhere" / "a")
    (folder / "taken").mkdir()
    with pytest.raises(InputError, match="taken"):
        writer(folder / "taken")
    assert [path.name for path in folder.iterdir()] == ["taken"]


def test_a_name_that_no_file_can_have_is_an_input_error(folder: Path):
    with pytest.raises(InputError, match="cannot be written: File name too long"):
        write_text_atomic(folder / ("a" * 300), "text")


def test_read_only_folder_is_reported(read_only_folder, writer):
    with pytest.raises(InputError, match="denied"):
        writer(read_only_folder / "a")


def test_exception_of_the_filler_passes_and_leaves_nothing(folder: Path):
    def fill(temporary: Path) -> None:
        temporary.write_text("half")
        raise KeyError("mine")

    with pytest.raises(KeyError):
        write_atomically(folder / "a", fill)
    assert list(folder.iterdir()) == []


def test_partial_file_of_a_killed_run_is_replaced(folder: Path):
    (folder / ".a.txt.partial").write_bytes(b"x" * 10_000)
    write_text_atomic(folder / "a.txt", "new")
    assert [path.name for path in folder.iterdir()] == ["a.txt"]
    assert (folder / "a.txt").read_text() == "new"
