"""Comparing two images, patch tables or image sets, and a picture of where two images differ."""

import math
import zipfile
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt import images
from lightopt.core.arrays import Bool, UInt8
from lightopt.core.errors import InputError, collected, counted
from lightopt.core.provenance import file_sha256, files_sha256, provenance
from lightopt.core.transforms import Posture
from lightopt.images.comparison._channels import ChannelDifference, ComparisonThresholds, Verdict, compare_arrays

LEVELS = "levels"  # name given to a grey PNG's only channel

_EXR_MAGIC = b"\x76\x2f\x31\x01"
_PNG_MAGIC = b"\x89PNG"
_DEFAULT_FULL_SCALE = 255.0
_SATURATING = frozenset({LEVELS, "Y"})
_DEFAULTS = ComparisonThresholds()
# what NumPy raises for files that are no readable .npz
_NPZ_ERRORS = (OSError, ValueError, EOFError, TypeError, AttributeError, zipfile.BadZipFile, zlib.error)


@dataclass(frozen=True)
class LoadedFile:
    """An image's channels (H, W) by name, what it is, and its levels of saturation and of background."""

    channels: dict[str, NDArray[Any]]
    kind: str
    saturation: float
    black: float = 0.0

    @property
    def shape(self) -> tuple[int, ...]:
        return next(iter(self.channels.values())).shape

    @property
    def hit(self) -> Bool | None:
        """Where the rays of a geometry image hit the part (everything is 0 where they miss); None for other images."""
        return self.channels["Z"] != 0 if {"Z", "N.X"} <= self.channels.keys() else None

    def lit(self, channel: str) -> Bool:
        """Where a channel is not background: 0, or the black level as the camera rounds it."""
        return self.channels[channel] != math.floor(self.black + 0.5)


def load_file(path: Path) -> LoadedFile:
    """Read an EXR or PNG, told apart by content; InputError when the file is missing, damaged, or neither."""
    try:
        with path.open("rb") as file:
            magic = file.read(4)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    if magic == _EXR_MAGIC:
        full_scale = _number(images.read_metadata(path).get("full_scale"), _DEFAULT_FULL_SCALE)
        return LoadedFile(channels=dict(images.read_exr(path)), kind="EXR of floats", saturation=full_scale)
    if magic != _PNG_MAGIC:
        raise InputError(f"{path}: expected an EXR or PNG image, found neither")
    pixels = images.read_png(path, colour=True)
    grey = pixels.ndim == 2
    channels = {LEVELS: pixels} if grey else {name: pixels[..., i] for i, name in enumerate("RGB")}
    metadata = images.read_metadata(path)
    saturation = _number(metadata.get("saturation_level"), float(np.iinfo(pixels.dtype).max))
    black = _number(metadata.get("black_level"), 0.0)
    return LoadedFile(dict(channels), f"PNG of {pixels.dtype}", saturation, black)


def _number(value: object, default: float) -> float:
    return float(value) if isinstance(value, (int, float)) and value > 0 else default


@dataclass(frozen=True)
class Comparison(Verdict):
    """Comparison of the golden `a` with the new `b`."""

    a: str
    b: str
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True)
class FileComparison(Comparison):
    """Comparison of two files by channel; ``hit`` of geometry images is the mask of rays that hit, with its IoU."""

    channels: tuple[ChannelDifference, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        return {**super().as_dict(), "channels": [channel.as_dict() for channel in self.channels]}


def compare_files(
    a: str | Path,
    b: str | Path,
    thresholds: ComparisonThresholds = _DEFAULTS,
    *,
    manifests: tuple[images.Manifest | None, images.Manifest | None] = (None, None),
) -> FileComparison:
    """Compare the golden image `a` with `b`, both EXR or both PNG; other formats, sizes or channels fail.

    Pixels that are background in both images are left out: level 0 (the black level in a PNG), or rays that miss in
    geometry images. Thresholds are in sensor levels for PNG, in grey levels for EXR, in mm for geometry.

    manifests: Of the sets of both: they know levels of saturation and background of PNGs better than the files;
        `thresholds.saturation` goes before both.
    Raises InputError: A file is missing, damaged or no image.
    """
    problems: list[str] = []
    golden = _load_image("golden", Path(a), manifests[0], problems)
    new = _load_image("new", Path(b), manifests[1], problems)
    if golden is None or new is None:
        raise InputError(*problems)
    reasons = list(_structure_problems(golden, new))
    comparable = golden.kind == new.kind and golden.shape == new.shape
    channels = tuple(_compare_channels(golden, new, thresholds)) if comparable else ()
    reasons += [reason for channel in channels for reason in channel.reasons]
    return FileComparison(str(a), str(b), channels=channels, reasons=tuple(reasons))


def _load_image(role: str, path: Path, manifest: images.Manifest | None, problems: list[str]) -> LoadedFile | None:
    with collected(problems):
        if not path.is_file():
            raise InputError(f"{role} file is missing: {path}")
        image = load_file(path)
        if manifest is None or not image.kind.startswith("PNG"):
            return image
        return replace(image, saturation=manifest.saturated_from, black=manifest.black_level)
    return None


def _structure_problems(golden: LoadedFile, new: LoadedFile) -> Iterator[str]:
    if golden.kind != new.kind:
        yield f"different formats: golden {golden.kind}, new {new.kind}"
    if golden.shape != new.shape:
        yield f"different sizes (H, W): golden {golden.shape}, new {new.shape}"
    old, now = set(golden.channels), set(new.channels)
    for role, names in (("new", old - now), ("golden", now - old)):
        if names and golden.kind == new.kind:
            yield f"{role} file lacks channel {', '.join(sorted(names))}"


def _compare_channels(golden: LoadedFile, new: LoadedFile, limits: ComparisonThresholds) -> Iterator[ChannelDifference]:
    both_hit, hit_a, hit_b = None, golden.hit, new.hit
    if hit_a is not None and hit_b is not None:
        both_hit, either, share = hit_a & hit_b, hit_a | hit_b, limits.max_share
        exact: dict[str, Any] = {"absolute": 0, "relative": 0, "saturation": (1, 1)}
        mask = compare_arrays("hit", hit_a, hit_b, **exact, max_share=share, where=either)
        yield replace(mask, saturated_a=None, saturated_b=None)
    for name in sorted(golden.channels.keys() & new.channels.keys()):
        geometry = both_hit is not None
        patch = geometry and name == "patch"
        difference = compare_arrays(
            name,
            golden.channels[name],
            new.channels[name],
            absolute=0 if patch else limits.geometry_absolute if geometry else limits.absolute,
            relative=0 if geometry else limits.relative,
            max_share=limits.max_share,
            where=golden.lit(name) | new.lit(name) if both_hit is None else both_hit,
            saturation=_saturation(golden, new, limits.saturation) if name in _SATURATING else None,
            min_iou=limits.min_iou,
        )
        # Patch numbers are names: they are equal or not, and how far apart they are says nothing.
        yield replace(difference, max=None, rms=None, percentiles=None) if patch else difference


def _saturation(golden: LoadedFile, new: LoadedFile, level: float | None) -> tuple[float, float]:
    # levels from which both are saturated: one that was given goes before those of the files
    return (golden.saturation, new.saturation) if level is None else (level, level)


def compare_tables(a: Path, b: Path, thresholds: ComparisonThresholds) -> FileComparison:
    """Compare the arrays of two ``.npz`` files: floats within `geometry_absolute`, the rest exactly."""
    reasons: list[str] = []
    golden, new = _load_arrays("golden", a, reasons), _load_arrays("new", b, reasons)
    if reasons:
        return FileComparison(str(a), str(b), reasons=tuple(reasons))
    if golden.keys() != new.keys():
        reasons.append(f"different arrays: golden {sorted(golden)}, new {sorted(new)}")
    channels: list[ChannelDifference] = []
    for name in sorted(golden.keys() & new.keys()):
        old, now = golden[name], new[name]
        if old.shape != now.shape or old.dtype.kind != now.dtype.kind:
            reasons.append(f"{name}: golden {old.dtype} {old.shape}, new {now.dtype} {now.shape}")
        elif old.dtype.kind in "biuf":
            absolute, share = thresholds.geometry_absolute if old.dtype.kind == "f" else 0.0, thresholds.max_share
            channels.append(compare_arrays(name, old, now, absolute=absolute, relative=0, max_share=share))
        elif not np.array_equal(old, now):
            reasons.append(f"{name}: different texts")
    reasons += [reason for channel in channels for reason in channel.reasons]
    return FileComparison(str(a), str(b), channels=tuple(channels), reasons=tuple(reasons))


def _load_arrays(role: str, path: Path, reasons: list[str]) -> dict[str, NDArray[Any]]:
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except FileNotFoundError:
        reasons.append(f"{role} file is missing: {path}")
    except _NPZ_ERRORS as error:
        reasons.append(f"{role} file is no readable .npz: {path}: {error}")
    return {}


_LOWER, _EQUAL, _HIGHER = (33, 102, 172), (247, 247, 247), (178, 24, 43)
_ONLY_GOLDEN, _ONLY_NEW, _NOT_FINITE = (0, 150, 60), (255, 0, 255), (0, 0, 0)
_SCALE_PERCENTILE = 99.9
_LEAST_SCALE = 0.05


def difference_picture(
    a: str | Path, b: str | Path, path: str | Path, *, saturation: float | None = None, overwrite: bool = True
) -> float:
    """Write a PNG of the signed difference new − golden: blue lower, white equal, red higher; returns the scale.

    Pixels saturated only in the golden image `a` are green, only in the new one `b` magenta, values that are not
    finite in either black. Channel, scale and numbers of such pixels are in the file's metadata. The channel is ``Y``,
    a PNG's levels, or the first one; the scale, the difference of the full colours [level of the files], is the 99.9th
    percentile of the differences.

    saturation: Level from which a pixel counts as saturated; by default what the files say.
    Raises InputError: An image cannot be read, they differ in format or size or share no channel, the picture cannot be
        written, or one of other content is there and `overwrite` is False.
    """
    golden, new = load_file(Path(a)), load_file(Path(b))
    if golden.kind != new.kind or golden.shape != new.shape:
        kinds = f"{golden.kind} of {golden.shape} and {new.kind} of {new.shape}"
        raise InputError(f"{a} and {b}: no difference to show between {kinds}")
    common = sorted(golden.channels.keys() & new.channels.keys())
    if not common:
        raise InputError(f"{a} and {b}: no channel is in both images")
    name = next((name for name in ("Y", LEVELS) if name in common), common[0])
    old, now = golden.channels[name].astype(np.float64), new.channels[name].astype(np.float64)
    finite = np.isfinite(old) & np.isfinite(now)
    signed = np.zeros(old.shape)
    np.subtract(now, old, out=signed, where=finite)
    scale = _LEAST_SCALE
    if signed.any():
        scale = max(float(np.percentile(np.abs(signed[signed != 0]), _SCALE_PERCENTILE)), _LEAST_SCALE)
    pixels = diverging(signed / scale)
    limits = _saturation(golden, new, saturation)
    saturating = name in _SATURATING
    full_a, full_b = saturating & (old >= limits[0]), saturating & (now >= limits[1])
    only_golden, only_new = full_a & ~full_b, full_b & ~full_a
    pixels[only_golden], pixels[only_new], pixels[~finite] = _ONLY_GOLDEN, _ONLY_NEW, _NOT_FINITE
    counts = {"only_golden": int(only_golden.sum()), "only_new": int(only_new.sum())}
    shades = {f"{-scale:g} (new − golden) and below": _LOWER, "0": _EQUAL, f"{scale:g} and above": _HIGHER}
    marks = {"saturated only in golden": _ONLY_GOLDEN, "saturated only in new": _ONLY_NEW, "not finite": _NOT_FINITE}
    scaled = {"scale": scale, "beyond_scale": int((np.abs(signed) > scale).sum())}
    facts: dict[str, Any] = {"picture": "difference", "channel": name, **scaled, **counts, "colours": shades | marks}
    images.write_png(path, pixels, metadata=facts, overwrite=overwrite)
    return scale


def diverging(shares: NDArray[np.floating[Any]]) -> UInt8:
    """Colours of shares from −1, blue, over 0, white, to 1, red, and beyond as there; shape of the shares and 3."""
    colours = zip(_LOWER, _EQUAL, _HIGHER, strict=True)
    channels = [np.interp(shares, [-1.0, 0.0, 1.0], channel) for channel in colours]
    return np.floor(np.stack(channels, axis=-1) + 0.5).astype(np.uint8)


_ANGLE_TOLERANCE_DEG = 1e-6
_PATCHES = "patch table"


@dataclass(frozen=True)
class SetComparison(Comparison):
    files: tuple[FileComparison, ...] = ()  # the files of the golden set against their counterparts
    missing: tuple[str, ...] = ()  # what only the golden set has, which fails
    extra: tuple[str, ...] = ()  # what only the new one has, which is reported
    notes: tuple[str, ...] = ()  # differences that fail nothing, and what is extra

    def as_dict(self) -> dict[str, Any]:
        return {**super().as_dict(), "files": [file.as_dict() for file in self.files]}


def compare_sets(a: str | Path, b: str | Path, thresholds: ComparisonThresholds = _DEFAULTS) -> SetComparison:
    """Compare two image sets, golden `a` against new `b`; images are matched by light, posture and exposure.

    A file that is missing, damaged or changed since it was listed is a failed comparison with its reason.

    Raises InputError: one of them is no image set, or its manifest is damaged.
    """
    problems: list[str] = []
    golden, new = (_open(role, path, problems) for role, path in (("golden", a), ("new", b)))
    if golden is None or new is None:
        raise InputError(*problems)
    reasons: list[str] = []
    old, now = _listed(golden.manifest), _listed(new.manifest)
    missing = tuple(label for label in old if label not in now)
    extra = tuple(label for label in now if label not in old)
    if not old:
        reasons.append(f"golden set lists no files: {a}")
    reasons += [f"new set lacks {text}" for text in _in_one_set(missing, golden.manifest, new.manifest)]
    reasons += _manifest_problems(golden.manifest, new.manifest)
    files: list[FileComparison] = []
    compare_images = partial(compare_files, manifests=(golden.manifest, new.manifest))
    for label in (label for label in old if label in now):
        path_a, path_b = golden.path(old[label][0]), new.path(now[label][0])
        for role, path, digest in (("golden", path_a, old[label][1]), ("new", path_b, now[label][1])):
            if digest is not None and path.is_file() and file_sha256(path) != digest.lower():
                reasons.append(f"{role} file changed since its manifest was written: {path}")
        try:
            comparison = (compare_tables if label == _PATCHES else compare_images)(path_a, path_b, thresholds)
        except InputError as error:
            comparison = FileComparison(str(path_a), str(path_b), reasons=error.messages)
        files.append(comparison)
        reasons += [f"{label}: {reason}" for reason in comparison.reasons]
    added = (f"only in the new set: {text}" for text in _in_one_set(extra, new.manifest, golden.manifest))
    notes = (*_notes(golden.manifest, new.manifest), *added)
    return SetComparison(str(a), str(b), tuple(reasons), tuple(files), missing=missing, extra=extra, notes=notes)


def _open(role: str, path: str | Path, problems: list[str]) -> images.ImageSet | None:
    with collected(problems, where=f"{role} set"):
        return images.read_image_set(path, verify=False)
    return None


def _listed(manifest: images.Manifest) -> dict[str, tuple[str, str | None]]:
    """Map the items of a set, in words, to their files and SHA-256; an EXR that exposures share comes once."""
    listed: dict[str, tuple[str, str | None]] = {}
    for image in manifest.images:
        what = f"{image.light} at {_words(image.posture)}"
        if image.png is not None:
            listed[f"{what}, exposure {image.exposure:.15g}, PNG"] = image.png, image.sha256.get("png")
        if image.exr is not None:
            listed.setdefault(f"{what}, EXR", (image.exr, image.sha256.get("exr")))
    for geometry in manifest.geometry:
        listed[f"geometry at {_words(geometry.posture)}"] = geometry.exr, geometry.sha256.get("exr")
    if manifest.patches is not None:
        listed[_PATCHES] = manifest.patches, manifest.files.get(manifest.patches)
    return listed


def _in_one_set(labels: Sequence[str], own: images.Manifest, other: images.Manifest) -> Iterator[str]:
    # items that only one set has, in words: postures of which the other set has nothing are said once
    postures, others = (dict.fromkeys(_words(one.posture) for one in (*m.images, *m.geometry)) for m in (own, other))
    whole = [words for words in postures if words not in others]
    of_postures = [label for label in labels if any(f"at {words}" in label for words in whole)]
    if whole:
        number = f"{len(whole)} of {counted(len(postures), 'posture')}"
        yield f"{number} ({counted(len(of_postures), 'file')}): {', '.join(whole).replace('posture ', '')}"
    yield from (label for label in labels if label not in of_postures)


def _words(posture: Posture) -> str:
    return f"posture ({posture.elevation_deg:.15g}°, {posture.rotation_deg:.15g}°)"


def _manifest_problems(golden: images.Manifest, new: images.Manifest) -> Iterator[str]:
    for name in ("bit_depth", "full_scale", "black_level"):
        old, now = getattr(golden, name), getattr(new, name)
        if old != now:
            yield f"different {name}: golden {old:g}, new {now:g}"
    angles = {image.key: (image.light_elevation_deg, image.light_azimuth_deg) for image in golden.images}
    moved: Counter[str] = Counter()
    for image in new.images:
        old = angles.get(image.key)
        now = (image.light_elevation_deg, image.light_azimuth_deg)
        if old and max(abs(old[0] - now[0]), abs(old[1] - now[1])) > _ANGLE_TOLERANCE_DEG:
            moved[f"{image.light} stood elsewhere: golden {old}°, new {now}°"] += 1
    yield from (f"{text}, in {counted(number, 'image')}" for text, number in moved.items())


def _notes(golden: images.Manifest, new: images.Manifest) -> Iterator[str]:
    if golden.saturated_from != new.saturated_from:
        yield f"different saturation_level: golden {golden.saturated_from:g}, new {new.saturated_from:g}"
    for name, old, now in (("rig", golden.rig, new.rig), ("part", golden.part, new.part)):
        if old and now and old.sha256 != now.sha256:
            yield f"different {name} file: golden {old.file}, new {now.file}"


def comparison_provenance(result: FileComparison | SetComparison, thresholds: ComparisonThresholds) -> dict[str, Any]:
    """Inputs and thresholds of a comparison, in the layout of :mod:`lightopt.core.provenance`. Raises OSError."""
    if isinstance(result, SetComparison):
        golden = _set_hashes(result.a, [file.a for file in result.files])
        inputs = {"golden": golden, "new": _set_hashes(result.b, [file.b for file in result.files])}
    else:
        inputs = {"golden": {"sha256": file_sha256(result.a)}, "new": {"sha256": file_sha256(result.b)}}
    return provenance(inputs, asdict(thresholds))


def _set_hashes(given: str, files: Sequence[str]) -> dict[str, str]:
    manifest = Path(given) / images.MANIFEST_NAME if Path(given).is_dir() else Path(given)
    names = (Path(file).relative_to(manifest.parent).as_posix() for file in files)
    return {"manifest_sha256": file_sha256(manifest), "files_sha256": files_sha256(manifest.parent, names)}
