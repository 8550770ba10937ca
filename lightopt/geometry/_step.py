"""STEP files as triangles with the CAD surface's normals, through a worker process around cascadio."""

import re
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.core.errors import InputError
from lightopt.core.units import step_units_mm, unit_name
from lightopt.geometry import _step_worker
from lightopt.geometry._glb import glb_triangle_count, parse_glb, split_glb
from lightopt.geometry._mesh_formats import RawMesh, check_budget, joined
from lightopt.geometry._step_bodies import name_bodies

_LARGEST_MM, _SMALLEST_MM = 1000.0, 0.1
_FINEST_SHARE = 2e-6  # of the part's size: a finer tolerance takes millions of triangles, and hours
_MM_PER_GLB_UNIT = 1000.0
_MATERIAL = re.compile(r"mat_\d+")

# The first pass only has to learn the size, in a time that does not depend on the unit: relative to the edges.
_COARSE_LINEAR, _COARSE_ANGULAR = 0.2, 0.5
TIMEOUT_S = 300.0  # time for both passes together [s]
MEMORY_GB = 4.0  # address space of each of the two workers [10⁹ bytes]; not limited on Windows


def read_step(
    path: Path,
    data: bytes,
    *,
    chord_tolerance_mm: float,
    angular_tolerance: float,
    max_triangles: int,
    pieces: bool = False,
) -> RawMesh:
    """Triangles of a STEP file [mm], Z up, all solids of an assembly in place.

    The file declares its unit. A coarse tessellation learns the size, so that a unit mistake ends in a message and not
    in hours of tessellating.

    chord_tolerance_mm: Largest distance between triangle and surface [mm]
    angular_tolerance: Largest angle between neighbouring tangents along an edge [rad]
    pieces: Whether to keep which triangles are of which face, solid and colour
    """
    name = str(path)
    if not data.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"ISO-10303-21"):
        raise InputError(f"{name}: not a STEP file: expected it to begin with ISO-10303-21, found {data[:20]!r}")
    if b"END-ISO-10303-21" not in data[-2000:]:
        cut = f"{len(data):,} bytes without END-ISO-10303-21 at the end. Export or copy it again"
        raise InputError(f"{name}: the STEP file is cut off: {cut}")
    deadline = time.monotonic() + TIMEOUT_S
    # both at the same time; the fine one is ended where the coarse one finds a mistake
    with (
        _Tessellation(path, _COARSE_LINEAR, _COARSE_ANGULAR, relative=True) as coarse,
        _Tessellation(path, chord_tolerance_mm, angular_tolerance, relative=False, faces=pieces) as fine_one,
    ):
        size, _ = coarse.result(deadline)
        largest = _check_size(name, parse_glb(name, size), declared_unit_mm(data))
        if chord_tolerance_mm < _FINEST_SHARE * largest:
            raise InputError(
                f"{name}: triangles within {chord_tolerance_mm:.2g} mm of a part of {largest:.4g} mm are too many. The "
                "tolerance is mesh.chord_tolerance_mm, or without it a share of a pixel's footprint: check distance_mm "
                "and pixel_size_um of the camera"
            )
        fine, output = fine_one.result(deadline)
    check_budget(name, glb_triangle_count(name, split_glb(name, fine)[0]), max_triangles)
    parts = parse_glb(name, fine)
    unnamed = name_bodies(parts, data, _MM_PER_GLB_UNIT) if pieces else ()
    raw = joined(name, parts, "STEP", repeats_vertices=True)
    warnings = unnamed + ((f"the CAD kernel reported while reading the STEP file: {output}",) if output else ())
    # the kernel numbers colours: its names of materials mean nothing
    own = tuple(replace(one, names=tuple(n for n in one.names if not _MATERIAL.fullmatch(n))) for one in raw.pieces)
    return replace(raw, vertices=raw.vertices * _MM_PER_GLB_UNIT, warnings=warnings, pieces=own, unnamed=unnamed)


def declared_unit_mm(data: bytes) -> float | None:
    """Millimetres in the length unit that a STEP file declares; None where it declares none, or several."""
    declared = step_units_mm(data)
    return next(iter(declared)) if len(declared) == 1 else None


def _check_size(name: str, parts: list[dict[str, NDArray[Any]]], declared: float | None) -> float:
    # returns the largest side [mm]
    if not parts:
        raise InputError(f"{name}: the STEP file has no surfaces or solids, or they could not be tessellated")
    low = np.min([part["vertices"].min(axis=0) for part in parts], axis=0)
    high = np.max([part["vertices"].max(axis=0) for part in parts], axis=0)
    size = (high - low) * _MM_PER_GLB_UNIT
    largest = float(size.max())
    if _SMALLEST_MM <= largest <= _LARGEST_MM:
        return largest
    unit = "" if declared is None else f" (the file declares {unit_name(declared)})"
    true = {mistake: largest / mistake if largest > _LARGEST_MM else largest * mistake for mistake in (1000.0, 25.4)}
    likely = " or ".join(f"{mm:.3g} mm with a unit mistake of {mistake:g}" for mistake, mm in true.items())
    raise InputError(
        f"{name}: the part is {size[0]:.4g} × {size[1]:.4g} × {size[2]:.4g} mm{unit}; expected its largest side "
        f"between {_SMALLEST_MM} mm and {_LARGEST_MM:g} mm. It would be {likely}: export it in its true unit"
    )


class _Tessellation:
    """A worker process that tessellates a STEP file; as a context manager it is ended with its block."""

    def __init__(self, path: Path, linear: float, angular: float, *, relative: bool, faces: bool = False) -> None:
        self._path = path
        self._what = f"{'coarse' if relative else 'fine'} tessellation (" + (
            "to learn the size)" if relative else f"chord tolerance {linear:g} mm, {angular:g} rad)"
        )
        self._folder = tempfile.TemporaryDirectory(prefix="lightopt-step-")
        self._glb = Path(self._folder.name) / "part.glb"
        files, numbers = (str(path.resolve()), str(self._glb)), (repr(linear), repr(angular))
        flags = str(int(relative)), str(int(faces))
        self._process = subprocess.Popen(  # noqa: S603  our own worker, no shell
            [sys.executable, _step_worker.__file__, *files, *numbers, *flags, str(int(MEMORY_GB * 1e9))],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )

    def __enter__(self) -> "_Tessellation":
        return self

    def __exit__(self, *_: object) -> None:
        if self._process.poll() is None:
            self._process.kill()
        self._process.communicate()
        self._folder.cleanup()

    def result(self, deadline: float) -> tuple[bytes, str]:
        """The GLB file that the worker wrote, and what the CAD kernel complained about."""
        path, what = self._path, self._what
        try:
            written, _ = self._process.communicate(timeout=max(0.01, deadline - time.monotonic()))
        except subprocess.TimeoutExpired as error:
            raise InputError(
                f"{path}: {what} was stopped after {TIMEOUT_S:g} s in all. Use a coarser "
                "mesh.chord_tolerance_mm, simplify the part, or export it as STL"
            ) from error
        status = self._process.returncode
        if status == 0 and self._glb.is_file():
            return self._glb.read_bytes(), _last_line(written)
        output = f" ({_last_line(written)})" if written.strip() else ""
        coarser = "Use a coarser mesh.chord_tolerance_mm"
        problem = (
            f"{what} ended with status {status}{output}: the CAD kernel crashed on this file or reached the memory "
            f"limit of {MEMORY_GB:g} GB. {coarser}, or export the part as STL"
        )
        if status == _step_worker.EXIT_READ:
            problem = f"the STEP file could not be read{output}. Export it again (AP203, AP214 or AP242)"
        elif status == _step_worker.EXIT_MEMORY:
            problem = f"{what} needs more than {MEMORY_GB:g} GB of memory. {coarser}, or simplify the part"
        raise InputError(f"{path}: {problem}")


def _last_line(output: bytes) -> str:
    text = re.sub(r"\x1b\[[0-9;]*m", "", output.decode("utf-8", "replace"))
    lines = [line.strip(" *\t") for line in text.splitlines() if line.strip(" *\t\r")]
    return lines[-1] if lines else ""
