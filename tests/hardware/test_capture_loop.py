"""Through the commands: capture on the virtual bench, fit, and find the truth within the intervals; kill and resume."""

from __future__ import annotations

import contextlib
import io
import json
import random
import subprocess
import sys

import pytest
from fault_cases import make_rig
from fault_runs import differences, kill_sometime

from lightopt.cli._main import run
from lightopt.config import load_part
from lightopt.images import read_image_set

EXPOSURES = ("--exposure", "1,1/16", "--dark")


def lightopt(*arguments: object) -> tuple[str, str]:
    """What a command says to standard output and to standard error."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = run([*map(str, arguments)])
    assert status == 0, err.getvalue()
    return out.getvalue(), err.getvalue()


@pytest.fixture(scope="module")
def captured(tmp_path_factory):
    """A rig, a part, and the set that an undisturbed command captured."""
    folder = tmp_path_factory.mktemp("loop")
    rig, part = make_rig(folder)
    said = lightopt("capture", rig, part, "-o", folder / "set", *EXPOSURES)
    return rig, part, folder / "set", said


@pytest.mark.slow
def test_the_command_says_what_it_did(captured):
    _, _, folder, (said, errors) = captured
    assert errors == ""
    first, last = said.splitlines()
    assert first.startswith("8 images in ")
    assert last == str(folder / "manifest.json")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("guess", "command", "fitted"),
    [
        pytest.param("R_d: 30, R_s: 12500, sigma_rad: 0.0475", ("fit-diffuse",), {"R_d"}, marks=pytest.mark.nightly),
        pytest.param(
            "R_d: 30, R_s: 4000, sigma_rad: 0.06",
            ("fit-specular", "--joint"),
            {"R_d", "R_s", "sigma_rad"},
            marks=pytest.mark.nightly,  # tests/hardware/test_capture_fit.py does as much in one process
        ),
    ],
)
def test_what_is_fitted_to_a_capture_holds_the_truth(captured, tmp_path, guess, command, fitted):
    rig, part, folder, _ = captured
    text = part.read_text(encoding="utf-8")
    truth = load_part(part).reflectance
    wrong = part.with_name(f"guess-{command[0]}.yaml")
    old = "R_d: 45.0, R_s: 12500, sigma_rad: 0.0475"
    assert old in text
    wrong.write_text(text.replace(old, guess), encoding="utf-8", newline="\n")
    name, *options = command
    lightopt(name, rig, wrong, folder, "-o", tmp_path, "--pixels", "6000", *options)
    found = json.loads((tmp_path / "fit.json").read_text(encoding="utf-8"))
    assert set(found["fitted"]) == fitted
    for parameter in fitted:
        low, high = found["values"][parameter]["interval_95"]
        assert low <= getattr(truth, parameter) <= high, parameter


def test_overlap_and_compare_take_a_capture(captured):
    _, _, folder, _ = captured
    lightopt("overlap", folder)
    lightopt("compare", folder, folder)


@pytest.mark.slow
def test_a_changed_file_is_noticed_by_compare_and_fit(captured, tmp_path):
    import shutil

    rig, part, folder, _ = captured
    shutil.copytree(folder, tmp_path / "set")
    entry = read_image_set(folder).images[0]
    path = tmp_path / "set" / entry.png
    path.write_bytes(path.read_bytes() + b"\0")
    for status, arguments in (
        (2, ("fit-diffuse", rig, part, tmp_path / "set", "-o", tmp_path / "fit")),
        (1, ("compare", folder, tmp_path / "set")),
    ):
        command = [sys.executable, "-m", "lightopt", *map(str, arguments)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
        assert done.returncode == status
        assert "changed since" in done.stdout + done.stderr


def kill_and_resume(captured, tmp_path, kills, seed, cli):
    rig, part, truth, _ = captured
    moments = random.Random(seed)
    begun = unfinished = 0
    for number in range(kills):
        out = tmp_path / str(number)
        command = [sys.executable, "-m", "lightopt", "capture", rig, part, "-o", out, *EXPOSURES]
        kill_sometime(list(map(str, command)), out, moments)
        if (out / "manifest.json").exists():
            begun += 1
            unfinished += len(read_image_set(out).images) < 8  # valid, whatever was going on
        # in process, which saves the start of an interpreter
        resumed = cli("capture", rig, part, "-o", out, "--resume", "-q", *EXPOSURES)
        assert resumed.status == 0, resumed.err
        assert differences(out, truth) == [], f"kill {number}"
        assert not list(out.rglob("*.partial"))
    assert begun >= kills / 2
    assert unfinished >= kills / 3


@pytest.mark.slow
def test_killed_and_resumed_it_is_the_same_set(captured, tmp_path, cli):
    kill_and_resume(captured, tmp_path, 2, seed=3, cli=cli)


@pytest.mark.nightly
def test_killed_at_50_moments_and_resumed_it_is_the_same_set(captured, tmp_path, cli):
    kill_and_resume(captured, tmp_path, 50, seed=2026, cli=cli)
