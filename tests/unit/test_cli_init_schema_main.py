"""``lightopt init`` and ``lightopt schema``, help, version and wrong command lines."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import typer

from lightopt import __version__

ROOT = Path(__file__).resolve().parents[2]
COMMANDS = ("init", "check", "render", "compare", "schema")


def test_init_writes_a_rig_a_part_a_mesh_and_their_schemas(cli, tmp_path):
    folder = tmp_path / "a" / "mine"
    ran = cli("init", folder)
    assert (ran.status, ran.err) == (0, "")
    names = sorted(path.name for path in folder.iterdir())
    assert names == ["cover-knob.step", "part.json", "part.yaml", "rig.json", "rig.yaml"]
    lines = ran.out.splitlines()
    assert {Path(line).name for line in lines[:-1]} == set(names)
    assert lines[-1] == f"next: lightopt check {folder / 'rig.yaml'} {folder / 'part.yaml'}"
    for name in ("rig", "part"):
        text = (folder / f"{name}.yaml").read_text(encoding="utf-8")
        assert text.startswith(f"# yaml-language-server: $schema={name}.json\n")
        assert text.count("#") > 10, "the files are commented"
        json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))


@pytest.mark.slow
def test_what_init_wrote_can_be_checked(cli, tmp_path):
    assert cli("init", tmp_path / "mine").status == 0
    ran = cli("check", tmp_path / "mine" / "rig.yaml", tmp_path / "mine" / "part.yaml")
    assert ran.status == 0, ran.err
    assert "error:" not in ran.out


def test_init_does_not_replace_files_without_force(cli, tmp_path, snapshot):
    assert cli("init", tmp_path).status == 0
    pristine = snapshot(tmp_path)
    (tmp_path / "rig.yaml").write_text("mine")
    before = snapshot(tmp_path)
    ran = cli("init", tmp_path)
    assert ran.status == 2
    assert ran.err.startswith(f"error: {tmp_path} already has rig.yaml")
    assert "--force" in ran.err
    assert snapshot(tmp_path) == before
    assert cli("init", tmp_path, "--force").status == 0
    assert snapshot(tmp_path) == pristine


def test_init_in_a_place_that_cannot_be(cli, tmp_path):
    file = tmp_path / "file"
    file.write_text("")
    ran = cli("init", file / "mine")
    assert ran.status == 2
    assert ran.err.startswith(f"error: {file / 'mine'}: cannot be made: ")
    assert "Traceback" not in ran.err


@pytest.mark.parametrize("kind", ["rig", "part", "ranges"])
def test_schema_prints_what_is_committed(cli, kind):
    ran = cli("schema", kind)
    assert (ran.status, ran.err) == (0, "")
    printed = json.loads(ran.out)
    assert printed == json.loads((ROOT / "configs" / "schema" / f"{kind}.json").read_text(encoding="utf-8"))
    assert printed["$schema"] == "https://json-schema.org/draft/2020-12/schema"


def test_schema_of_something_else(cli):
    ran = cli("schema", "camera")
    assert ran.status == 2
    assert ran.err.startswith("error: ")
    assert 'found "camera"' in ran.err
    assert "lightopt schema --help" in ran.err


@pytest.mark.parametrize("option", ["--help", "-h"])
def test_help_names_all_commands(cli, option):
    ran = cli(option)
    assert ran.status == 0
    for command in COMMANDS:
        assert f"  {command} " in ran.out
    assert "130 interrupted" in " ".join(ran.out.split())


@pytest.mark.parametrize("command", COMMANDS)
def test_each_command_explains_itself(cli, command):
    ran = cli(command, "--help")
    assert ran.status == 0
    assert ran.out.startswith(f"Usage: lightopt {command} ")


def test_no_arguments_show_the_help(cli):
    ran = cli()
    assert "Usage: lightopt" in ran.out + ran.err
    assert ran.status in (0, 2)


def test_version(cli):
    ran = cli("--version")
    assert (ran.status, ran.out, ran.err) == (0, f"lightopt {__version__}\n", "")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("rendr",), "No such command 'rendr'"),
        (("render",), "Missing argument 'RIG'"),
        (("render", "rig.yaml"), "Missing argument 'PART'"),
        (("render", "rig.yaml", "part.yaml"), "Missing option '--out'"),
        (("render", "rig.yaml", "part.yaml", "-o", "out", "--exposur", "1"), "--exposure"),
        (
            ("render", "rig.yaml", "part.yaml", "-o", "out", "--threads", "two"),
            '--threads: expected a whole number, found "two"',
        ),
        (("dataset", "rig.yaml", "part.yaml", "-o", "out", "--images", "0"), '--images: expected 1 or more, found "0"'),
        (("schema", "prat"), 'KIND: expected rig, part, ranges or batch, found "prat"; did you mean "part"?'),
        (("render", "rig.yaml", "part.yaml", "other.yaml", "-o", "out"), "other.yaml"),
        (("compare", "a"), "Missing argument 'B'"),
    ],
)
def test_wrong_command_lines(cli, tmp_path, monkeypatch, arguments, said):
    monkeypatch.chdir(tmp_path)
    ran = cli(*arguments)
    assert ran.status == 2
    assert ran.err.startswith("error: ")
    assert said in ran.err
    assert "--help" in ran.err
    assert "Traceback" not in ran.err
    assert list(tmp_path.iterdir()) == []


def lightopt(*arguments, **options):
    return subprocess.run([sys.executable, "-m", "lightopt", *arguments], capture_output=True, text=True, **options)


def test_the_module_leaves_with_the_exit_status():
    assert lightopt("--version").returncode == 0
    ran = lightopt("render", "no.yaml", "no.yaml", "-o", os.devnull)
    assert ran.returncode == 2
    assert ran.stderr.startswith("error: no.yaml: no such file")


@pytest.mark.skipif(sys.platform == "win32", reason="pipes of Windows do not say that nobody reads")
def test_a_reader_that_goes_away_is_no_error():
    command = [sys.executable, "-m", "lightopt", "schema", "rig"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        said = process.stderr.read()
        process.wait(60)
    assert process.returncode == 0
    assert said == b""


@pytest.mark.slow
@pytest.mark.parametrize("encoding", ["cp1252", pytest.param("ascii", marks=pytest.mark.nightly)])
def test_output_redirected_in_a_windows_code_page_is_utf_8(tmp_path, shared_bench, encoding):
    """Neither θ nor σ nor ≤ is in cp1252: redirected output is UTF-8 instead of a traceback."""
    environment = {**os.environ, "PYTHONIOENCODING": encoding, "PYTHONUTF8": "0"}
    rig = tmp_path / "rig.yaml"
    rig.write_text(shared_bench.rig.read_text(encoding="utf-8") + "σ_θ: 1\n", encoding="utf-8")
    runs = {
        ("check", str(shared_bench.rig), str(shared_bench.part)): (0, "σ = 0.0475 rad"),
        ("render", "--help"): (0, "θ,φ"),
        ("check", str(rig)): (2, 'unknown key "σ_θ"'),
    }
    for arguments, (status, reported) in runs.items():
        command = [sys.executable, "-m", "lightopt", *arguments]
        done = subprocess.run(command, capture_output=True, check=False, env=environment)
        assert done.returncode == status
        assert reported in (done.stdout + done.stderr).decode("utf-8")
        assert b"Traceback" not in done.stderr


@pytest.mark.slow
def test_progress_is_for_terminals_only(tmp_path, shared_bench):
    arguments = ["render", shared_bench.rig, shared_bench.part, "-o", tmp_path / "out", "--patches", "500"]
    command = [sys.executable, "-m", "lightopt", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, b"")


def test_defaults_in_the_help_are_those_of_the_library():
    from lightopt.cli._main import app
    from lightopt.design import OptimizeOptions, PlanOptions, Tolerances
    from lightopt.estimate.reflectance import FitOptions, PaperOptions
    from lightopt.inspection import InspectOptions
    from lightopt.rendering import RenderOptions

    commands = typer.main.get_command(app).commands
    shown = {
        (name, parameter.name): parameter.show_default if isinstance(parameter.show_default, str) else parameter.default
        for name, command in commands.items()
        if not hasattr(command, "commands")
        for parameter in command.params
    }
    optimize, plan, inspect, fit, paper = (
        OptimizeOptions(),
        PlanOptions(),
        InspectOptions(),
        FitOptions(),
        PaperOptions(),
    )
    expected = {
        ("render", "patches"): RenderOptions().patch_budget,
        ("render", "supersample"): RenderOptions().supersample,
        ("optimize", "patches"): optimize.patch_budget,
        ("optimize", "step"): optimize.step_deg,
        ("optimize", "max_combinations"): optimize.limit,
        ("optimize", "min_images"): optimize.min_images,
        ("optimize", "false_alarms"): optimize.false_alarms,
        ("optimize", "ranking_rows"): optimize.rows,
        ("optimize", "posture_step"): plan.posture_step_deg,
        ("optimize", "allow_outside"): plan.allow_outside_px,
        ("optimize", "exposure_gain"): plan.exposure_gain,
        ("optimize", "tolerance_target"): Tolerances(light_deg=1.0).tolerance_target,
        ("inspect", "detector"): inspect.detector,
        ("inspect", "fusion"): inspect.fusion,
        ("inspect", "false_alarms"): inspect.false_alarms,
        ("inspect", "min_images"): inspect.min_images,
        ("inspect", "register"): inspect.register,
        ("fit-diffuse", "pixels"): fit.pixels,
        ("fit-diffuse", "register"): fit.register,
        ("fit-diffuse", "lambda_d"): paper.lambda_d,
        ("fit-diffuse", "start_rd"): paper.R_d_start,
        ("fit-diffuse", "highlight_margin"): round(np.degrees(paper.away), 9),
        ("fit-specular", "validate"): fit.validate,
        ("fit-specular", "lambda_s1"): paper.lambda_s1,
        ("fit-specular", "lambda_s2"): paper.lambda_s2,
        ("fit-specular", "start_rs"): paper.R_s_start,
        ("fit-specular", "start_sigma"): paper.sigma_start,
        ("fit-specular", "sigma_step"): paper.sigma_step,
    }  # fmt: skip
    for key, value in expected.items():
        same = shown[key] == value or (isinstance(shown[key], str) and shown[key] == f"{value}".removesuffix(".0"))
        assert same, f"{key}: the help has {shown[key]}, the library {value}"


BLAS = """
import os, sys
import lightopt.cli
early = "numpy" not in sys.modules
sys.argv[1:] = ["--version"]
try:
    lightopt.cli.main()
except SystemExit:
    print(early, os.environ["OPENBLAS_NUM_THREADS"])
"""


@pytest.mark.parametrize(("set_to", "used"), [(None, "1"), ("3", "3")])
def test_blas_has_one_thread_unless_the_user_says_otherwise(monkeypatch, set_to, used):
    if set_to is None:
        monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    else:
        monkeypatch.setenv("OPENBLAS_NUM_THREADS", set_to)
    ran = subprocess.run([sys.executable, "-c", BLAS], capture_output=True, text=True, check=True)
    assert ran.stdout.splitlines()[-1] == f"True {used}"
