"""Comparing two image files."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from lightopt.core.errors import InputError
from lightopt.images.comparison._channels import ChannelDifference, Thresholds, compare_arrays
from lightopt.images.comparison._load import LEVELS, LoadedFile, hit_mask, lit_mask, load_file

_SATURATING = frozenset({LEVELS, "Y"})
_DEFAULTS = Thresholds()


@dataclass(frozen=True)
class FileComparison:
    """How two files differ: per channel, and why that is too much.

    Attributes
    ----------
    a, b
        The golden and the new file.
    channels
        The differences by channel; in geometry images ``hit`` is the mask of rays that hit, its `iou` that of
        the masks.
    reasons
        Why the comparison fails, those of the channels included; empty when it passes.
    """

    a: str
    b: str
    channels: tuple[ChannelDifference, ...] = ()
    reasons: tuple[str, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether the files are close enough."""
        return not self.reasons

    def as_dict(self) -> dict[str, Any]:
        """JSON form."""
        return {
            "a": self.a,
            "b": self.b,
            "passed": self.passed,
            "reasons": list(self.reasons),
            "channels": [channel.as_dict() for channel in self.channels],
        }


def compare_files(
    a: str | Path,
    b: str | Path,
    thresholds: Thresholds = _DEFAULTS,
    *,
    saturation: tuple[float | None, float | None] = (None, None),
    black: tuple[float | None, float | None] = (None, None),
) -> FileComparison:
    """Compare two EXR or two PNG images; another format, size or channel is a failed comparison.

    Pixels that are background in both images are left out: level 0 (the black level in a PNG), or rays that miss in
    geometry images.

    Parameters
    ----------
    a, b
        The golden file and the new one.
    thresholds
        When a difference is too large; PNG in sensor levels, EXR in grey levels, geometry in mm.
    saturation
        Levels from which the PNGs count as saturated, where a manifest knows better than the files;
        `thresholds.saturation` goes before both.
    black
        Levels of the PNGs' background, where a manifest knows better than the files.

    Raises
    ------
    InputError
        When a file is missing, damaged or no image.
    """
    problems: list[str] = []
    golden = _load("golden", Path(a), saturation[0], black[0], problems)
    new = _load("new", Path(b), saturation[1], black[1], problems)
    if golden is None or new is None:
        raise InputError(*problems)
    reasons = list(_structure_problems(golden, new))
    comparable = golden.kind == new.kind and golden.shape == new.shape
    channels = tuple(_compare_channels(golden, new, thresholds)) if comparable else ()
    reasons += [reason for channel in channels for reason in channel.reasons]
    return FileComparison(str(a), str(b), channels=channels, reasons=tuple(reasons))


def _load(
    role: str, path: Path, saturation: float | None, black: float | None, problems: list[str]
) -> LoadedFile | None:
    """Read an image; where that fails, add the problem."""
    if not path.is_file():
        problems.append(f"{role} file is missing: {path}")
        return None
    try:
        image = load_file(path)
    except InputError as error:
        problems.extend(error.messages)
        return None
    if not image.kind.startswith("PNG"):
        return image
    return replace(
        image,
        saturation=image.saturation if saturation is None else saturation,
        black=image.black if black is None else black,
    )


def _structure_problems(golden: LoadedFile, new: LoadedFile) -> Iterator[str]:
    if golden.kind != new.kind:
        yield f"different formats: golden {golden.kind}, new {new.kind}"
    if golden.shape != new.shape:
        yield f"different sizes (H, W): golden {golden.shape}, new {new.shape}"
    for role, names in (
        ("new file lacks", set(golden.channels) - set(new.channels)),
        ("golden file lacks", set(new.channels) - set(golden.channels)),
    ):
        if names and golden.kind == new.kind:
            yield f"{role} channel {', '.join(sorted(names))}"


def _compare_channels(golden: LoadedFile, new: LoadedFile, limits: Thresholds) -> Iterator[ChannelDifference]:
    hit_a = hit_b = None
    if geometry := golden.is_geometry and new.is_geometry:
        hit_a, hit_b = hit_mask(golden), hit_mask(new)
        mask = compare_arrays(
            "hit",
            hit_a,
            hit_b,
            absolute=0,
            relative=0,
            max_share=limits.max_share,
            where=hit_a | hit_b,
            saturation=(1, 1),
        )
        yield replace(mask, saturated_a=None, saturated_b=None)
    for name in sorted(golden.channels.keys() & new.channels.keys()):
        patch = geometry and name == "patch"
        levels = tuple(
            limits.saturation if limits.saturation is not None else image.saturation
            for image in (golden, new)
        )
        difference = compare_arrays(
            name,
            golden.channels[name],
            new.channels[name],
            absolute=0 if patch else limits.geometry_absolute if geometry else limits.absolute,
            relative=0 if geometry else limits.relative,
            max_share=limits.max_share,
            where=lit_mask(golden, name) | lit_mask(new, name)
            if hit_a is None or hit_b is None
            else hit_a & hit_b,
            saturation=(levels[0], levels[1]) if name in _SATURATING else None,
            min_iou=limits.min_iou,
        )
        # Patch numbers are names: they are equal or not, and how far apart they are says nothing.
        yield replace(difference, max=None, rms=None, percentiles=None) if patch else difference
