"""Where ``lightopt render`` writes to: folders that cannot be written, full disks, results that are there already."""

from __future__ import annotations

import errno
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from lightopt.images import read_image_set, write_exr

FEW = ("--patches", "500")


def refuse_out(cli, bench, out):
    ran = cli("render", bench.rig, bench.part, "-o", out, *FEW)
    assert ran.status == 2, ran
    assert ran.err.startswith("error: ")
    assert str(out) in ran.err
    assert "Traceback" not in ran.err
    return ran.err


def impossible_folders(bench) -> list[Path]:
    folders = [bench.rig / "out", bench.rig]  # below a file, and a file itself
    if Path("/proc/self").exists():
        folders.append(Path("/proc/lightopt-test"))  # where even root cannot make a folder
    return folders


def test_an_output_folder_that_cannot_be_made(cli, bench, snapshot):
    before = snapshot(bench.folder)
    for out in impossible_folders(bench):
        what_to_do = "another name" if out.is_file() else "output folder that can be written"
        assert what_to_do in refuse_out(cli, bench, out)
    assert snapshot(bench.folder) == before


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path | None]:
    """A file system of its own that can be filled or made read-only; None where it may not be mounted."""
    folder = tmp_path / "disk"
    folder.mkdir()
    if not mount(folder, "size=64k"):
        yield None
        return
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def mount(folder: Path, options: str, *, again: bool = False) -> bool:
    options = f"remount,{options}" if again else options
    try:
        done = subprocess.run(
            ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)], capture_output=True, check=False
        )
    except FileNotFoundError:
        return False
    return done.returncode == 0


def test_a_read_only_output_folder(cli, bench, small_disk, tmp_path, monkeypatch):
    if small_disk is not None:
        out = small_disk
        assert mount(out, "ro", again=True)
    else:
        out = tmp_path / "read-only"
        out.mkdir()

        def refused(*arguments: object) -> None:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

        monkeypatch.setattr(os, "replace", refused)
    said = refuse_out(cli, bench, out)
    assert "cannot be written" in said
    assert list(out.iterdir()) == []


@pytest.mark.parametrize("kilobytes", [4, 64, 256, 400, 550])
def test_a_full_disk_leaves_a_valid_set_that_can_be_completed(
    cli, bench, small_disk, tmp_path, snapshot, monkeypatch, kilobytes
):
    """A set of 12 files and about 700 kB, on a disk that is full after some of them."""
    undisturbed = tmp_path / "undisturbed"
    assert cli("render", bench.rig, bench.part, "-o", undisturbed, *FEW).status == 0
    sizes = [path.stat().st_size for path in undisturbed.rglob("*") if path.is_file()]
    assert sum(sizes) > 600_000
    out = tmp_path / "simulated" if small_disk is None else small_disk / "out"
    with monkeypatch.context() as patch:
        if small_disk is not None:
            assert mount(small_disk, f"size={kilobytes}k", again=True)
        else:
            simulate_full_disk(patch, kilobytes * 1000)
        said = refuse_out(cli, bench, out)
    assert "No space left on device" in said or os.strerror(errno.ENOSPC) in said
    assert "has room" in said
    assert not list(out.rglob("*.partial"))
    assert not list(out.rglob(".*"))
    if (out / "manifest.json").exists():
        read_image_set(out)
    else:
        assert [path for path in out.rglob("*") if path.is_file()] == []
    if small_disk is not None:
        assert mount(small_disk, "size=10m", again=True)
    assert cli("render", bench.rig, bench.part, "-o", out, *FEW).status == 0
    assert snapshot(out) == snapshot(undisturbed)


def simulate_full_disk(patch: pytest.MonkeyPatch, room: int) -> None:
    """Let the flush to disk fail once the files written sum up to `room` bytes."""
    written = [0]
    flush = os.fsync

    def full(descriptor: int) -> None:
        written[0] += os.fstat(descriptor).st_size
        if written[0] > room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        flush(descriptor)

    patch.setattr(os, "fsync", full)


@pytest.mark.parametrize("kilobytes", [0, 64, 256, 400, 550])
def test_a_disk_that_refuses_the_flush(cli, bench, tmp_path, monkeypatch, snapshot, kilobytes):
    """The same without a file system to mount: on every platform and for every user."""
    undisturbed, out = tmp_path / "undisturbed", tmp_path / "out"
    assert cli("render", bench.rig, bench.part, "-o", undisturbed, *FEW).status == 0
    with monkeypatch.context() as patch:
        simulate_full_disk(patch, kilobytes * 1000)
        assert os.strerror(errno.ENOSPC) in refuse_out(cli, bench, out)
    assert not list(out.rglob(".*"))
    if (out / "manifest.json").exists():
        read_image_set(out)
    assert cli("render", bench.rig, bench.part, "-o", out, *FEW).status == 0
    assert snapshot(out) == snapshot(undisturbed)


# --- what is there already


def test_existing_results_are_kept_without_force(cli, bench, snapshot):
    assert cli("render", bench.rig, bench.part, "-o", bench.out, *FEW).status == 0
    bench.edit("part.yaml", "R_d: 45.0", "R_d: 46.0")
    before = snapshot(bench.out)
    said = refuse_out(cli, bench, bench.out)
    assert "holds the image set of another run (part.sha256: " in said
    assert "--force" in said
    assert snapshot(bench.out) == before


@pytest.mark.parametrize("content", [b"", b"{", b'{"format": "something else"}', b"\xff\xfe"])
def test_a_damaged_manifest_is_not_overwritten_without_force(cli, bench, content):
    bench.out.mkdir()
    manifest = bench.out / "manifest.json"
    manifest.write_bytes(content)
    said = refuse_out(cli, bench, bench.out)
    assert "--force" in said
    assert manifest.read_bytes() == content
    assert cli("render", bench.rig, bench.part, "-o", bench.out, *FEW, "--force").status == 0
    read_image_set(bench.out)


def test_force_removes_the_set_that_was_there_and_nothing_else(cli, bench, snapshot):
    options = ("--sheet", "--exposure", "1,1/4", *FEW)
    assert cli("render", bench.rig, bench.part, "-o", bench.out, *options).status == 0
    old = snapshot(bench.out)
    (bench.out / "notes.txt").write_text("mine", encoding="utf-8")
    (bench.out / "posture_0_0" / "mine.png").write_bytes(b"mine")
    bench.edit("part.yaml", "R_d: 45.0", "R_d: 46.0")
    few = ("--light", "light1", "--posture", "-10,170", *FEW)
    ran = cli("render", bench.rig, bench.part, "-o", bench.out, *few, "--force")
    assert ran.status == 0
    assert ran.out.splitlines()[1] == f"replaced the existing image set ({len(old) - 1} files)"
    listed = {"posture_-10_170/light1.png", "posture_-10_170/light1.exr", "posture_-10_170/geometry.exr"}
    mine = {"notes.txt", "posture_0_0/mine.png"}
    assert set(snapshot(bench.out)) == {"manifest.json", "patches.npz", *listed, *mine}


def test_not_even_force_replaces_captured_images(cli, bench, snapshot):
    assert cli("render", bench.rig, bench.part, "-o", bench.out, *FEW).status == 0
    manifest = bench.out / "manifest.json"
    text = manifest.read_text(encoding="utf-8").replace('"kind": "simulated"', '"kind": "captured"')
    manifest.write_text(text, encoding="utf-8")
    before = snapshot(bench.out)
    ran = cli("render", bench.rig, bench.part, "-o", bench.out, *FEW, "--force")
    assert ran.status == 2
    assert f"{bench.out}: holds captured images" in ran.err
    assert snapshot(bench.out) == before


@pytest.mark.slow
@pytest.mark.parametrize(("option", "name"), [("--json", "findings.json"), ("--drawing", "rig.png")])
def test_check_replaces_another_result_only_with_force(cli, bench, option, name):
    path = bench.folder / name
    assert cli("check", bench.rig, bench.part, option, path).status == 0
    assert cli("check", bench.rig, bench.part, option, path).status == 0  # the same result
    first = path.read_bytes()
    bench.edit("rig.yaml", "distance_mm: 330, elevation_deg: 60", "distance_mm: 300, elevation_deg: 60")
    ran = cli("check", bench.rig, bench.part, option, path)
    assert ran.status == 2
    assert f"error: {path}: exists with other content; use --force to replace it" in ran.err
    assert path.read_bytes() == first
    assert cli("check", bench.rig, bench.part, option, path, "--force").status == 0
    assert path.read_bytes() != first


@pytest.mark.parametrize(("option", "name"), [("--json", "figures.json"), ("--diff", "difference.png")])
def test_compare_replaces_another_result_only_with_force(cli, tmp_path, option, name):
    for i in range(3):
        write_exr(tmp_path / f"{i}.exr", {"Y": np.full((4, 5), 10.0 * i * i, np.float32)}, metadata={})
    golden, new, newer = (tmp_path / f"{i}.exr" for i in range(3))
    path = tmp_path / name
    assert cli("compare", golden, new, option, path).status == 1
    assert cli("compare", golden, new, option, path).status == 1  # the same result
    first = path.read_bytes()
    ran = cli("compare", golden, newer, option, path)
    assert ran.status == 2
    assert f"error: {path}: exists with other content" in ran.err
    assert path.read_bytes() == first
    assert cli("compare", golden, newer, option, path, "--force").status == 1
    assert path.read_bytes() != first
