"""Bytes of frames as levels, against a reading of them bit by bit, and the choice of a format."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st

from lightopt.core.errors import HardwareError, InputError
from lightopt.rig.devices._camera_features import PIXEL_FORMATS, choose_format, levels_of
from lightopt.rig.simulated._camera_gige import FORMATS, packed

SIZES = st.tuples(st.integers(1, 9), st.integers(1, 5))


def bit(data: bytes, number: int) -> int:
    """A bit, counted from the lowest of the first byte."""
    return data[number // 8] >> number % 8 & 1


def read_bit_by_bit(data: bytes, name: str, pixel: int) -> int:
    """Level of a pixel, as the tables of the formats have its bits."""
    bits = PIXEL_FORMATS[name].bits
    if name.endswith("Packed"):
        # a pair of pixels in 24 bits: the second half of the middle byte belongs to the second pixel
        base, low = pixel // 2 * 24, bits - 8
        places = [base + 8 + 4 * (pixel % 2) + i for i in range(low)]
        places += [base + 16 * (pixel % 2) + i for i in range(8)]
    else:
        width = bits if name.endswith("p") else PIXEL_FORMATS[name].stored
        places = [pixel * width + i for i in range(bits)]
    return sum(bit(data, place) << i for i, place in enumerate(places))


@pytest.mark.parametrize("name", PIXEL_FORMATS)
@given(size=SIZES, seed=st.integers(0, 2**32 - 1))
def test_levels_are_those_of_the_bits(name: str, size: tuple[int, int], seed: int) -> None:
    width, height = size
    form = PIXEL_FORMATS[name]
    random = np.random.default_rng(seed)
    data = random.integers(0, 256, form.size(width * height), dtype=np.uint8)
    if form.stored == 16 and form.bits < 16:  # the upper bits of a word are zero
        data = random.integers(0, 1 << form.bits, width * height).astype("<u2").view(np.uint8)
    levels = levels_of(data, form, width=width, height=height)
    expected = [read_bit_by_bit(data.tobytes(), name, i) for i in range(width * height)]
    assert levels.dtype == (np.uint8 if form.bits == 8 else np.uint16)
    assert levels.reshape(-1).tolist() == expected


@pytest.mark.parametrize("name", FORMATS)
@given(size=SIZES, seed=st.integers(0, 2**32 - 1))
def test_what_the_simulated_camera_packs_is_unpacked(name: str, size: tuple[int, int], seed: int) -> None:
    code, bits = FORMATS[name]
    form = PIXEL_FORMATS[name]
    assert (form.code, form.bits) == (code, bits)
    sent = np.random.default_rng(seed).integers(0, 1 << bits, size[::-1])
    data = np.frombuffer(packed(sent, code), np.uint8)
    assert len(data) >= form.size(size[0] * size[1])
    assert np.array_equal(levels_of(data, form, width=size[0], height=size[1]), sent)


def test_levels_are_no_view_of_a_buffer_that_is_used_again() -> None:
    data = np.arange(6, dtype=np.uint8)
    levels = levels_of(data, PIXEL_FORMATS["Mono8"], width=3, height=2)
    data[:] = 0
    assert levels.tolist() == [[0, 1, 2], [3, 4, 5]]


def test_what_follows_the_pixels_is_ignored_and_too_little_is_refused() -> None:
    form = PIXEL_FORMATS["Mono12p"]
    assert form.size(3) == 5
    data = np.full(9, 255, np.uint8)
    assert levels_of(data, form, width=3, height=1).tolist() == [[4095, 4095, 4095]]
    with pytest.raises(HardwareError, match="takes 5 bytes, and the camera delivered 4"):
        levels_of(data[:4], form, width=3, height=1)


@pytest.mark.parametrize(
    ("offered", "depth", "wanted", "chosen"),
    [
        (("Mono8", "Mono12p", "Mono12"), 12, None, "Mono12"),
        (("Mono8", "Mono12Packed", "Mono12p"), 12, None, "Mono12p"),
        (("Mono8", "Mono12Packed", "Mono12p"), 12, "Mono12Packed", "Mono12Packed"),
        (("RGBa8", "Mono8"), 8, None, "Mono8"),
        (("Mono10Packed",), 10, None, "Mono10Packed"),
        (("Mono16",), 16, None, "Mono16"),
    ],
)
def test_the_format_fits_the_sensor(offered, depth, wanted, chosen) -> None:
    assert choose_format(offered, bit_depth=depth, wanted=wanted, where="camera").name == chosen


@pytest.mark.parametrize(
    ("offered", "depth", "wanted", "words"),
    [
        (("Mono8", "Mono16"), 12, None, ["no pixel format of 12 bits", "Mono8, Mono16", "bit_depth: 8 or 16"]),
        (("BayerRG8", "RGB8"), 8, None, ["camera of colour", "BayerRG8, RGB8", "monochrome model"]),
        (("Mono8", "BayerRG8"), 8, "BayerRG8", ["BayerRG8 is no format of grey levels"]),
        (("Mono8",), 8, "Mono12", ["no pixel format Mono12", "it has Mono8"]),
        (("Mono8", "Mono12"), 8, "Mono12", ["12 bits", "bit_depth 8"]),
    ],
)
def test_what_does_not_fit_is_refused(offered, depth, wanted, words) -> None:
    with pytest.raises(InputError) as raised:
        choose_format(offered, bit_depth=depth, wanted=wanted, where="rig.yaml:9: camera")
    for word in ("rig.yaml:9: camera", *words):
        assert word in str(raised.value)
