"""Mesh files that cannot be used: each is refused with a message that says what was found."""

import math
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh

from lightopt.core.errors import InputError
from lightopt.geometry import load_mesh


def refused(path: Path, match: str, **changes) -> None:
    options = {"unit_mm": 1.0, "normals": "smooth", "crease_angle": 0.5, **changes}
    with pytest.raises(InputError, match=match) as caught:
        load_mesh(path, **options)
    if path.stem == "part":
        assert path.name in str(caught.value)


def written(tmp_path: Path, name: str, data: bytes | str) -> Path:
    path = tmp_path / name
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    return path


def exported(suffix: str, **options) -> bytes:
    data = trimesh.creation.icosphere(subdivisions=1).export(file_type=suffix, **options)
    return data.encode() if isinstance(data, str) else data


def ascii_ply(vertices: str, faces: str, count: tuple[int, int]) -> str:
    head = f"ply\nformat ascii 1.0\nelement vertex {count[0]}\n" + "".join(f"property float {c}\n" for c in "xyz")
    return head + f"element face {count[1]}\nproperty list uchar int vertex_indices\nend_header\n{vertices}{faces}"


TRIANGLE = "0 0 0\n1 0 0\n0 1 0\n"


def test_missing_file_folder_and_unknown_format(tmp_path):
    refused(tmp_path / "part.stl", "no such mesh file")
    refused(written(tmp_path, "part.3mf", b"x"), r"unknown mesh format '.3mf', expected one of .stl")
    (tmp_path / "part.ply").mkdir()
    refused(tmp_path / "part.ply", "cannot be read")


@pytest.mark.parametrize("suffix", ["stl", "ply", "obj", "glb", "step"])
def test_empty_files(tmp_path, suffix):
    refused(written(tmp_path, f"part.{suffix}", b""), r"empty \(0 bytes\)")


@pytest.mark.parametrize("suffix", ["stl", "ply", "obj", "glb", "step"])
def test_files_of_another_kind(tmp_path, suffix):
    refused(written(tmp_path, f"part.{suffix}", b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 2), "part")


def test_binary_stl_whose_size_disagrees_with_its_count(tmp_path):
    data = exported("stl")
    refused(written(tmp_path, "part.stl", data[:-10]), r"says 80 triangles \(4,084 bytes\), but the file has 4,074")
    refused(written(tmp_path, "part.stl", data + b"x"), "has 4,085 bytes")
    refused(written(tmp_path, "part.stl", data[:60]), "60 bytes, a binary STL has a header of 84")
    refused(written(tmp_path, "part.stl", bytes(84)), "no triangles")


def test_binary_stl_whose_header_begins_with_solid(tmp_path):
    data = b"solid part".ljust(80, b" ") + exported("stl")[80:]
    whole = written(tmp_path, "whole.stl", data)
    assert len(load_mesh(whole, unit_mm=1.0, normals="facet", crease_angle=0.5).mesh.faces) == 80
    refused(written(tmp_path, "part.stl", data[:-10]), "a binary STL file that is cut off")
    refused(written(tmp_path, "part.stl", data[:90]), "a binary STL file that is cut off")


def test_ascii_stl_cut_off(tmp_path):
    data = exported("stl_ascii")
    for end in (len(data) // 2, len(data) - 12):
        refused(written(tmp_path, "part.stl", data[:end]), "cut off or damaged")
    refused(written(tmp_path, "part.stl", b"solid nothing\nendsolid nothing\n"), "no triangles")
    refused(written(tmp_path, "part.stl", data.replace(b"vertex ", b"vertex x", 1)), "could not be read as STL")


def test_ply_cut_off_or_damaged(tmp_path):
    binary = exported("ply")
    refused(written(tmp_path, "part.ply", binary[:-5]), r"could not be read as binary PLY \(vertex 42, face 80\)")
    refused(written(tmp_path, "part.ply", binary[:40]), "cut off in its header")
    refused(written(tmp_path, "part.ply", exported("ply", encoding="ascii")[:-30]), "cut off|could not be read|found")
    refused(written(tmp_path, "part.ply", ascii_ply(TRIANGLE, "", (3, 1))), "announces 4 lines .* has 3: cut off")
    refused(written(tmp_path, "part.ply", ascii_ply(TRIANGLE, "", (3, 0))), "no triangles")


def test_glb_cut_off_or_damaged(tmp_path):
    data = trimesh.Scene(trimesh.creation.box()).export(file_type="glb")
    refused(written(tmp_path, "part.glb", data[:-40]), r"says [\d,]+ bytes, but the file has")
    refused(written(tmp_path, "part.glb", data[:4] + b"\x01" + data[5:]), "version 1, expected 2")
    refused(written(tmp_path, "part.glb", data[:20] + b"[" + data[21:]), "JSON part of the GLB file is damaged")
    refused(written(tmp_path, "part.glb", data.replace(b'"count":36', b'"count":96')), "could not be read as GLB")
    refused(written(tmp_path, "part.glb", data.replace(b'"POSITION"', b'"POSITIOM"')), "does not have")
    json = b'{"asset":{"version":"2.0"}}  '[:28]
    empty = b"glTF" + struct.pack("<III4s", 2, 20 + len(json), len(json), b"JSON") + json
    refused(written(tmp_path, "part.glb", empty), "could not be read as GLB|no triangles")


def test_obj_damaged(tmp_path):
    good = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
    refused(written(tmp_path, "part.obj", good + "f 1 2 4\n"), "part.obj")
    refused(written(tmp_path, "part.obj", good + "f 1 2 3\nf 0 1 2\n"), "line 5: a face that uses vertex 0")
    refused(written(tmp_path, "part.obj", good + "f 1 2 3\nf 1 2"), "line 5: a face with fewer than three vertices")
    refused(written(tmp_path, "part.obj", "v 0 0 0\nv 1 0\nv 0 1 0\nf 1 2 3\n"), "part.obj")
    refused(written(tmp_path, "part.obj", good), "no triangles")


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_coordinates_that_are_not_finite(tmp_path, bad):
    triangles = np.zeros(2, dtype=[("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    triangles["v"] = np.eye(3)
    triangles["v"][1, 2, 0] = bad
    data = bytes(80) + struct.pack("<I", 2) + triangles.tobytes()
    refused(written(tmp_path, "part.stl", data), "1 vertices have coordinates that are not finite.* vertex 5")
    refused(written(tmp_path, "part.ply", ascii_ply(f"0 0 0\n1 {bad} 0\n0 1 0\n", "3 0 1 2\n", (3, 1))), "not finite")


def test_indices_out_of_range(tmp_path):
    path = written(tmp_path, "part.ply", ascii_ply(TRIANGLE, "3 0 1 2\n3 1 2 7\n", (3, 2)))
    refused(path, "1 triangle with vertices that do not exist: indices 0 to 7 .* for 3 vertices")
    path = written(tmp_path, "part.ply", ascii_ply(TRIANGLE, "3 0 1 -1\n", (3, 1)))
    refused(path, "indices -1 to 1")


def test_only_triangles_without_area(tmp_path):
    path = written(tmp_path, "part.ply", ascii_ply("0 0 0\n1 1 1\n3 3 3\n", "3 0 1 2\n", (3, 1)))
    refused(path, "none of the 1 triangles")


@pytest.mark.parametrize(("suffix", "options"), [("stl", {}), ("stl_ascii", {}), ("ply", {}), ("obj", {}), ("glb", {})])
def test_budget_of_triangles_is_checked_before_loading(tmp_path, monkeypatch, suffix, options):
    def never(*_, **__):
        raise AssertionError("loaded all the same")

    for module, name in (("stl", "load_stl"), ("ply", "load_ply"), ("obj", "load_obj")):
        monkeypatch.setattr(getattr(trimesh.exchange, module), name, never)
    path = written(tmp_path, f"part.{suffix.split('_')[0]}", exported(suffix, **options))
    monkeypatch.setattr(trimesh, "load_scene", never)
    refused(path, r"80 triangles, at most 79 are accepted; loading them would take about .* GB", max_triangles=79)


def test_huge_file_is_refused_by_its_size(tmp_path):
    path = written(tmp_path, "part.obj", b"#" * 1_010_000)
    refused(path, "too much for the 5 triangles", max_triangles=5)


def test_coordinates_beyond_reason(tmp_path):
    path = written(tmp_path, "part.ply", ascii_ply("0 0 0\n9e9 0 0\n0 1 0\n", "3 0 1 2\n", (3, 1)))
    refused(path, "coordinates up to 9e\\+09 units of 1 mm, at most 1e\\+09 mm")
