"""Comparing two image sets."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from lightopt.core.errors import InputError
from lightopt.core.provenance import file_sha256, files_sha256, provenance
from lightopt.core.transforms import Posture
from lightopt.images import MANIFEST_NAME, ImageSet, Manifest, read_image_set
from lightopt.images.comparison._channels import ComparisonThresholds
from lightopt.images.comparison._files import Comparison, FileComparison, compare_files, compare_tables

_DEFAULTS = ComparisonThresholds()
_ANGLE_TOLERANCE_DEG = 1e-6
_PATCHES = "patch table"


@dataclass(frozen=True)
class SetComparison(Comparison):
    """Comparison of two image sets."""

    files: tuple[FileComparison, ...] = ()  # the files of the golden set against their counterparts
    missing: tuple[str, ...] = ()  # what only the golden set has, which fails
    extra: tuple[str, ...] = ()  # what only the new one has, which is reported
    notes: tuple[str, ...] = ()  # differences that fail nothing

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
    reasons += [f"new set lacks {label}" for label in missing]
    reasons += _manifest_problems(golden.manifest, new.manifest)
    files: list[FileComparison] = []
    saturation = (golden.manifest.saturated_from, new.manifest.saturated_from)
    black = (golden.manifest.black_level, new.manifest.black_level)
    for label in (label for label in old if label in now):
        path_a, path_b = golden.path(old[label][0]), new.path(now[label][0])
        for role, path, digest in (("golden", path_a, old[label][1]), ("new", path_b, now[label][1])):
            if digest is not None and path.is_file() and file_sha256(path) != digest.lower():
                reasons.append(f"{role} file changed since its manifest was written: {path}")
        compare_images = partial(compare_files, saturation=saturation, black=black)
        try:
            comparison = (compare_tables if label == _PATCHES else compare_images)(path_a, path_b, thresholds)
        except InputError as error:
            comparison = FileComparison(str(path_a), str(path_b), reasons=error.messages)
        files.append(comparison)
        reasons += [f"{label}: {reason}" for reason in comparison.reasons]
    notes = tuple(_notes(golden.manifest, new.manifest))
    return SetComparison(str(a), str(b), tuple(reasons), tuple(files), missing=missing, extra=extra, notes=notes)


def _open(role: str, path: str | Path, problems: list[str]) -> ImageSet | None:
    try:
        return read_image_set(path, verify=False)
    except InputError as error:
        problems.extend(f"{role} set: {message}" for message in error.messages)
        return None


def _listed(manifest: Manifest) -> dict[str, tuple[str, str | None]]:
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


def _words(posture: Posture) -> str:
    return f"posture ({posture.elevation_deg:.15g}°, {posture.rotation_deg:.15g}°)"


def _manifest_problems(golden: Manifest, new: Manifest) -> Iterator[str]:
    for name in ("bit_depth", "full_scale", "black_level"):
        old, now = getattr(golden, name), getattr(new, name)
        if old != now:
            yield f"different {name}: golden {old:g}, new {now:g}"
    angles = {image.key: (image.light_elevation_deg, image.light_azimuth_deg) for image in golden.images}
    for image in new.images:
        old = angles.get(image.key)
        now = (image.light_elevation_deg, image.light_azimuth_deg)
        if old and max(abs(old[0] - now[0]), abs(old[1] - now[1])) > _ANGLE_TOLERANCE_DEG:
            yield f"{image.light} at {_words(image.posture)} stood elsewhere: golden {old}°, new {now}°"


def _notes(golden: Manifest, new: Manifest) -> Iterator[str]:
    if golden.saturated_from != new.saturated_from:
        yield f"different saturation_level: golden {golden.saturated_from:g}, new {new.saturated_from:g}"
    for name, old, now in (("rig", golden.rig, new.rig), ("part", golden.part, new.part)):
        if old and now and old.sha256 != now.sha256:
            yield f"different {name} file: golden {old.file}, new {now.file}"


def comparison_provenance(result: FileComparison | SetComparison, thresholds: ComparisonThresholds) -> dict[str, Any]:
    """Inputs and thresholds of a comparison, in the layout of :mod:`lightopt.core.provenance`. Raises OSError."""
    if isinstance(result, SetComparison):
        inputs = {
            "golden": _set_hashes(result.a, [file.a for file in result.files]),
            "new": _set_hashes(result.b, [file.b for file in result.files]),
        }
    else:
        inputs = {"golden": {"sha256": file_sha256(result.a)}, "new": {"sha256": file_sha256(result.b)}}
    return provenance(inputs, asdict(thresholds))


def _set_hashes(given: str, files: Sequence[str]) -> dict[str, str]:
    manifest = Path(given) / MANIFEST_NAME if Path(given).is_dir() else Path(given)
    names = (Path(file).relative_to(manifest.parent).as_posix() for file in files)
    return {"manifest_sha256": file_sha256(manifest), "files_sha256": files_sha256(manifest.parent, names)}
