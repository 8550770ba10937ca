"""The command line as a user starts it: seconds and peak memory of ``lightopt render``, and the time of ``--help``."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import trimesh
import yaml

from benchmarks._case import CONFIGS, RIG, Size, case_scene
from benchmarks._report import Report, Table, ratio_text, ratios, rounds
from benchmarks.bare import THREADS
from lightopt.geometry import TriangleMesh

ROOT = CONFIGS.parent
HELP_TARGET = 1.3
HELP_ROUNDS = 15
BIG_SENSOR = 4096 / 1600
"""The second sensor has this many times the pixels per side: 4096 × 3072 at full size."""


def run(size: Size) -> Report:
    """Measure renders of the case from files to files, and ``lightopt --help`` against ``import typer``."""
    mesh = case_scene(size).mesh
    with tempfile.TemporaryDirectory(prefix="lightopt-bench-") as name:
        folder = Path(name)
        write_meshes(mesh, folder)
        normal = write_rig(folder / "rig.yaml", size.width)
        large = write_rig(folder / "large.yaml", round(size.width * BIG_SENSOR))
        stl, ply = (write_part(folder / f"{kind}.yaml", f"case.{kind}") for kind in ("stl", "ply"))
        runs = {
            f"binary STL, {size.width} px wide": (normal, stl, 1.0),
            f"binary PLY with normals, {size.width} px wide": (normal, ply, 1.0),
            f"binary PLY with normals, {round(size.width * BIG_SENSOR)} px wide": (large, ply, 1.5),
        }
        measured: dict[str, list[dict[str, float]]] = {key: [] for key in runs}
        for _ in range(min(3, size.repeats)):
            for key, (rig, part, _) in runs.items():
                measured[key].append(measure(render_command(rig, part, folder / "out")))
        sizes = {path.name: path.stat().st_size for path in sorted(folder.glob("case.*"))}
    help_seconds = rounds(
        {
            "import typer": lambda: _silently([sys.executable, "-c", "import typer"]),
            "lightopt --help": lambda: _silently([*_lightopt(), "--help"]),
        },
        HELP_ROUNDS if size.repeats > 1 else 2,
    )
    limits = {key: limit for key, (_, _, limit) in runs.items()}
    return Report(
        "command",
        [_render_table(measured, limits), _help_table(help_seconds)],
        {
            "triangles": len(mesh.faces),
            "mesh_bytes": sizes,
            "renders": measured,
            "limits_gb": limits,
            "help_seconds": help_seconds,
            "help_ratio": ratios(help_seconds["lightopt --help"], help_seconds["import typer"]),
        },
        [
            f"{len(mesh.faces):,} triangles, one posture, four lights of 4 points, shadows, {THREADS} threads",
            "written: EXR and PNG of each light, geometry EXR, patches, manifest",
            "peak memory: of the command, or of a process that it starts if that is larger",
        ],
    )


def measure(command: list[str]) -> dict[str, float]:
    """Seconds and peak memory of a command, in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks._child", *command], cwd=ROOT, check=True, capture_output=True, text=True
    )
    result = json.loads(done.stdout)
    if result["status"] != 0:
        raise RuntimeError(f"{' '.join(command)} left with status {result['status']}: {done.stderr.strip()}")
    return result


def render_command(rig: Path, part: Path, out: Path) -> list[str]:
    """``lightopt render``, replacing what is there."""
    options = ["-o", str(out), "--force", "--quiet", "--threads", str(THREADS)]
    return [*_lightopt(), "render", str(rig), str(part), *options]


def write_meshes(mesh: TriangleMesh, folder: Path) -> None:
    """case.stl and case.ply, binary both; the PLY keeps the normals of the CAD surface."""
    plain = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_normals=mesh.normals, process=False)
    for kind, options in (("stl", {}), ("ply", {"vertex_normal": True})):
        plain.export(folder / f"case.{kind}", **options)


def write_rig(path: Path, width: int) -> Path:
    """The four-panel rig with the same view on a sensor of `width` pixels by three quarters of it."""
    rig = yaml.safe_load(RIG.read_text(encoding="utf-8"))
    camera = rig["camera"]
    camera["pixel_size_um"] *= camera["resolution_px"][0] / width
    camera["resolution_px"] = [width, width * 3 // 4]
    path.write_text(yaml.safe_dump(rig), encoding="utf-8")
    return path


def write_part(path: Path, mesh_file: str) -> Path:
    """The cover knob with another mesh file, in one posture."""
    part = yaml.safe_load((CONFIGS / "parts" / "cover-knob.yaml").read_text(encoding="utf-8"))
    part["mesh"].update(file=mesh_file, units="mm")
    part["postures"] = part["postures"][:1]
    path.write_text(yaml.safe_dump(part), encoding="utf-8")
    return path


def _lightopt() -> list[str]:
    script = Path(sys.executable).with_name("lightopt.exe" if os.name == "nt" else "lightopt")
    return [str(script)] if script.exists() else [sys.executable, "-m", "lightopt"]


def _silently(command: list[str]) -> None:
    subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)


def _render_table(measured: dict[str, list[dict[str, float]]], limits: dict[str, float]) -> Table:
    rows: list[tuple[str, ...]] = []
    for key, results in measured.items():
        peaks = [result["peak_bytes"] for result in results]
        peak = f"{max(peaks) / 1e9:.2f} GB" if None not in peaks else "not measured here"
        seconds = sorted(result["seconds"] for result in results)
        rows.append((key, f"{seconds[0]:.1f}", f"{seconds[len(seconds) // 2]:.1f}", peak, f"{limits[key]} GB"))
    return Table("lightopt render, files to files", ("", "least s", "median s", "peak memory", "limit"), rows)


def _help_table(seconds: dict[str, list[float]]) -> Table:
    base = seconds["import typer"]
    return Table(
        f"start-up, {len(base)} rounds (target < {HELP_TARGET})",
        ("", "least s", "ratio of least", "median ratio"),
        [(name, f"{min(times):.3f}", *ratio_text(times, base)) for name, times in seconds.items()],
    )
