"""``lightopt batch``: which tasks a batch has, what is kept, and what a failure, a kill or Ctrl-C leaves.

Commands are doubles here; tests/system/test_batch_workers.py runs real ones by workers.
"""

from __future__ import annotations

import errno
import inspect
import json
import shutil
import socket
import sys
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import ClassVar

import pytest

from lightopt.batch import Workers, _cluster, _expand, _run, _schedule, _task, answer_text, jobs_table, run_batch
from lightopt.batch._expand import expand
from lightopt.batch._task import Outcome
from lightopt.cli._batch import command_form
from lightopt.cli._main import _COMMANDS
from lightopt.core.errors import InputError
from lightopt.core.run_context import RunContext

JOBS = """\
format: lightopt-batch/1
rigs: [rig.yaml]
parts: [parts]
jobs:
  - name: images
    command: render
    options: {exposure: [1, 1/16], sheet: true}
  - {name: fit, command: fit-specular, images_from: images}
  - {name: best, command: optimize, part_from: fit, options: {step: 5}}
"""


class Commands:
    """Stand in for the command line: write a file, and the fitted part of a fit."""

    def __init__(self):
        self.ran, self.answers = [], {}

    def __call__(self, words):
        command, folder = words[0], Path(words[words.index("-o") + 1])
        self.ran.append((command, Path(words[2]).stem))
        status, error = self.answers.pop(self.ran[-1], (0, ""))
        if isinstance(error, Exception):
            raise error
        (folder / "inner").mkdir()
        (folder / "inner" / "result.txt").write_text(f"{command} of {Path(words[2]).name}", encoding="utf-8")
        if command == "fit-specular":
            (folder / "part.fitted.yaml").write_text("format: lightopt-part/1", encoding="utf-8")
        return status, f"answer of {command} in {folder}\nmore\n", error


@pytest.fixture
def files(bench):
    parts = bench.folder / "parts"
    parts.mkdir()
    shutil.move(bench.mesh, parts)
    for name in "ab":
        shutil.copy(bench.part, parts / f"{name}.yaml")
    bench.part.unlink()
    (bench.folder / "jobs.yaml").write_text(JOBS, encoding="utf-8")
    return bench


@pytest.fixture
def commands():
    return Commands()


@pytest.fixture
def batch(files, commands):
    def run(out=files.out, **options):
        commands.ran.clear()
        return run_batch(files.folder / "jobs.yaml", out, command_form, commands, **options)

    return run


def tree(folder):
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


def problems(files):
    with pytest.raises(InputError) as caught:
        run_batch(files.folder / "jobs.yaml", files.out, command_form, pytest.fail)
    assert not files.out.exists()
    return caught.value.messages


def test_each_job_is_run_for_each_part_after_those_that_it_needs(batch, files, commands):
    result = batch()
    assert sorted(commands.ran[:2]) == [("render", "a"), ("render", "b")]
    assert commands.ran[2:4] == [("fit-specular", "a"), ("fit-specular", "b")]
    assert commands.ran[4:] == [("optimize", "part.fitted"), ("optimize", "part.fitted")]
    assert answer_text(result.outcomes, len(result.tasks)) == "6 tasks: 6 done"
    assert tree(files.out / "images") == [
        f"rig/{part}/{name}" for part in "ab" for name in ("inner/result.txt", "task.json", "terminal.txt")
    ]
    terminal = (files.out / "images" / "rig" / "a" / "terminal.txt").read_text(encoding="utf-8")
    assert terminal == f"answer of render in {files.out / 'images' / 'rig' / 'a'}\nmore\n", "and no temporary name"
    page = (files.out / "report.html").read_text(encoding="utf-8")
    assert 'href="fit/rig/b/terminal.txt"' in page
    assert "<strong>6</strong> tasks: 6 done" in page


def test_command_lines(files):
    tasks = expand(files.folder / "jobs.yaml", command_form, files.out, threads=3)
    part, out = str(files.folder / "parts" / "a.yaml"), files.out
    first = [task for task in tasks if task.part == "a"]
    assert first[0].command == ("render", str(files.rig), part, "--exposure=1,1/16", "--sheet")
    assert first[1].command == ("fit-specular", str(files.rig), part, _task.FromTask(str(out / "images" / "rig" / "a")))
    fitted = _task.FromTask(str(out / "fit" / "rig" / "a"), "part.*.yaml")
    assert first[2].command == ("optimize", str(files.rig), fitted, "--step=5")
    assert {task.tail for task in tasks} == {("--threads=3",)}


def test_a_second_run_does_nothing_and_a_change_repeats_what_depends_on_it(batch, files, commands, monkeypatch):
    batch()
    monkeypatch.setattr(_expand, "_value_misfits", pytest.fail)  # which loads what computes, for seconds
    assert batch().count("kept") == 6
    monkeypatch.undo()
    assert commands.ran == []
    files.edit("jobs.yaml", "step: 5", "step: 10")
    batch()
    assert commands.ran == [("optimize", "part.fitted")] * 2, "an option of the last job"
    with (files.folder / "parts" / "b.yaml").open("a", encoding="utf-8") as file:
        file.write("# changed\n")
    batch()
    assert commands.ran == [("render", "b"), ("fit-specular", "b"), ("optimize", "part.fitted")]
    (files.out / "fit" / "rig" / "a" / "inner" / "result.txt").unlink()
    batch()
    assert commands.ran == [("fit-specular", "a")], "what others made from the lost result is the same"
    with (files.folder / "parts" / "knob.stl").open("ab") as file:
        file.write(b"\0")
    assert batch().count("done") == 6, "the mesh"


def test_a_file_that_the_ranges_of_a_dataset_name(batch, files, commands):
    (files.folder / "fit.json").write_text('{"format": "lightopt-fit/1", "values": {}}', encoding="utf-8")
    (files.folder / "r.yaml").write_text("format: lightopt-ranges/1\nfit: fit.json\n", encoding="utf-8")
    text = (files.folder / "jobs.yaml").read_text(encoding="utf-8").partition("jobs:")[0]
    job = "jobs:\n  - {name: set, command: dataset, options: {images: 2, ranges: r.yaml}}\n"
    (files.folder / "jobs.yaml").write_text(text + job, encoding="utf-8")
    assert batch().count("done") == 2
    assert batch().count("kept") == 2
    (files.folder / "fit.json").write_text('{"format": "lightopt-fit/1", "values": {"R_d": 1}}', encoding="utf-8")
    assert batch().count("done") == 2


def test_another_default_of_an_option_makes_its_tasks_anew(files):
    def key_of(form):
        tasks = expand(files.folder / "jobs.yaml", form, files.out, threads=1)
        return {task.job: task.key for task in tasks}

    def other(name):
        form = command_form(name)
        return replace(form, defaults={**form.defaults, "step": "7"}) if name == "optimize" else form

    before, now = key_of(command_form), key_of(other)
    assert [name for name in before if before[name] != now[name]] == ["best"]


def test_results_that_this_machine_does_not_see(batch, files, monkeypatch):
    """A worker elsewhere, which has the inputs and a folder of its own in the output's place."""

    def elsewhere(tasks, _known, _workers, _run_command, _run):
        for task in tasks:
            yield Outcome(place=task.place, state="done", worker="far 1")

    monkeypatch.setattr(_run, "outcomes_of", elsewhere)
    monkeypatch.setattr(_run, "_SHARED_S", 0.0)
    result = batch(workers=Workers(scheduler="tcp://far:8786"))
    assert result.count("failed") == 6
    assert "wrote results that this machine does not see" in next(iter(result.outcomes.values())).messages[0]
    assert batch().count("done") == 6


def test_a_worker_that_ends_as_soon_as_it_came_is_named_once():
    run, came, noted = RunContext(), {}, set()
    events = [(5.0, "remove-worker", "tcp://old"), (10.0, "add-worker", "tcp://a"), (900.0, "remove-worker", "tcp://a")]
    events += [(t, action, "tcp://b") for t in (1000.0, 1010.0) for action in ("add-worker", "remove-worker")]
    said = []
    for seconds, action, worker in events:
        _cluster._note_short_lived(run, came, noted, (seconds, {"action": action, "worker": worker}))
        said.append(len(run.warnings))
    assert said == [0, 0, 0, 0, 1, 1, 1]
    assert "worker tcp://b left 0 s after it came; see what it printed" in run.warnings[0]


def test_another_version_makes_everything_anew(batch, monkeypatch):
    batch()
    made_by = {**_cluster.computed_by(), "lightopt": "another"}
    for module in ("_expand", "_cluster"):
        monkeypatch.setattr(f"lightopt.batch.{module}.computed_by", lambda: made_by)
    assert batch().count("done") == 6


def test_a_failure_stops_what_needs_it_and_nothing_else(batch, files, commands):
    commands.answers[("render", "a")] = (2, "warning: one\nerror: no room\n")
    result = batch()
    assert answer_text(result.outcomes, len(result.tasks)) == "6 tasks: 3 done, 1 failed, 2 skipped"
    assert result.outcomes["images/rig/a"].messages == ("warning: one", "error: no room")
    assert result.outcomes["best/rig/a"].messages == ("needs fit/rig/a",)
    assert not (files.out / "images" / "rig" / "a").exists()
    assert not list(files.out.rglob(".*")), "nothing half-written is left"
    assert [row[3] for row in jobs_table(result.tasks, result.outcomes)[1]] == ["1", "-", "-"]
    assert "no room" in (files.out / "summary.csv").read_text(encoding="utf-8")
    assert batch().count("done") == 3, "what failed is tried again"


def test_a_task_that_failed_has_no_link_to_earlier_results(batch, files, commands):
    batch()
    files.edit("jobs.yaml", "step: 5", "step: 10")
    commands.answers[("optimize", "part.fitted")] = (2, "error: no room\n")
    assert batch().count("failed") == 1
    assert (files.out / "best" / "rig" / "a" / "task.json").is_file()
    page = (files.out / "report.html").read_text(encoding="utf-8")
    assert 'href="best/rig/b/terminal.txt"' in page
    assert 'href="best/rig/a/' not in page


def test_a_check_that_failed_is_not_repeated(batch, files, commands):
    commands.answers[("fit-specular", "b")] = (1, "error: the fit did not converge\n")
    assert batch().count("failed", "skipped") == 2
    assert (files.out / "fit" / "rig" / "b" / "part.fitted.yaml").is_file(), "its files are there"
    result = batch()
    assert commands.ran == []
    assert result.outcomes["fit/rig/b"].messages == ("error: the fit did not converge",)


def test_a_full_disk_loses_nothing(batch, files, commands):
    commands.answers[("fit-specular", "a")] = (0, OSError(errno.ENOSPC, "No space left on device"))
    result = batch()
    assert result.count("done") == 4
    assert "No space left" in result.outcomes["fit/rig/a"].messages[0]
    assert not list(files.out.rglob(".*"))
    assert batch().count("kept") == 4


def test_ctrl_c_ends_with_what_was_done_and_the_same_call_continues(batch, files, commands):
    commands.answers[("fit-specular", "b")] = (130, "interrupted\n")
    result = batch()
    assert result.interrupted
    assert answer_text(result.outcomes, len(result.tasks)) == "6 tasks: 3 done, 3 not run"
    assert not list(files.out.rglob(".*"))
    assert "not run" in (files.out / "summary.csv").read_text(encoding="utf-8")
    result = batch()
    assert (result.count("kept"), result.count("done"), result.interrupted) == (3, 3, False)


def test_what_a_killed_worker_was_writing_is_removed_when_the_results_are_there(batch, files):
    for name in (".a@0123", ".a@b@0123"):
        (files.out / "images" / "rig" / name).mkdir(parents=True)
    batch()
    left = [path.name for path in (files.out / "images" / "rig").iterdir()]
    assert sorted(left) == [".a@b@0123", "a", "b"], "but not what is of another part"


def test_two_workers_with_the_same_task(batch, files, commands, monkeypatch):
    """The second finds the results of the first, which was taken for lost, or its own folder removed."""
    done = batch()
    task = done.tasks[0]
    (files.out / "images" / "rig" / "a").rename(files.folder / "first")

    def slowly(words):
        answer = commands(words)
        (files.folder / "first").rename(task.folder)  # meanwhile the first one ends, and tidies up
        _task.remove_leftovers(task)
        return answer

    outcome = _task.run_task(task, slowly)
    assert outcome.state == "kept"
    assert outcome.answer == done.outcomes[task.place].answer


def test_a_folder_of_something_else_is_not_touched(batch, files):
    mine = files.out / "best" / "rig" / "b" / "mine.txt"
    mine.parent.mkdir(parents=True)
    mine.touch()
    with pytest.raises(InputError, match="is not a result of a batch"):
        batch()
    assert mine.exists()


def test_files_that_were_put_beside_results_are_not_replaced(batch, files):
    batch()
    mine = files.out / "images" / "rig" / "a" / "mine.txt"
    mine.touch()
    assert batch().count("kept") == len(batch().tasks)
    part = files.folder / "parts" / "a.yaml"
    part.write_text(part.read_text(encoding="utf-8") + "# changed\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"files that the batch did not write \(mine.txt\); move them away"):
        batch()
    assert mine.exists()


@pytest.mark.parametrize("text", ["", "[]", '{"key": 1}', "{"])
def test_a_damaged_record_is_no_result(batch, files, text):
    batch()
    (files.out / "images" / "rig" / "a" / "task.json").write_text(text, encoding="utf-8")
    assert batch().count("done") == 1


def test_a_wrong_part_fails_by_itself(batch, files, commands):
    (files.folder / "parts" / "a.yaml").write_text("format: nonsense", encoding="utf-8")
    assert batch().count("done") == 6, "its command says what is wrong"


def test_files_that_changed_or_are_not_there_for_a_worker(batch, files):
    done = batch()
    task = done.tasks[0]
    (files.folder / "parts" / "knob.stl").unlink()
    files.rig.write_text("format: lightopt-rig/1", encoding="utf-8")
    (mine, mesh) = _task.worker_problems(task.computed_by, task.files)
    assert mine.startswith(f"{files.rig}: changed since the batch was started")
    assert "knob.stl: changed since" in mesh
    shutil.rmtree(task.folder)
    assert _task.run_task(task, Commands()).messages == (mine, mesh)


def test_images_of_ones_own(files, batch, commands):
    files.edit("jobs.yaml", "images_from: images", 'images: "captured/{rig}/{part}"')
    tasks = expand(files.folder / "jobs.yaml", command_form, files.out, threads=1)
    fits = [task for task in tasks if task.job == "fit"]
    assert [task.command[3] for task in fits] == [str(files.folder / "captured" / "rig" / part) for part in "ab"]


def test_lighting_systems_are_compared_for_each_part_once(files, commands, batch):
    shutil.copy(files.rig, files.folder / "second.yaml")
    files.edit("jobs.yaml", "rigs: [rig.yaml]", "rigs: [rig.yaml, second.yaml]")
    files.edit(
        "jobs.yaml",
        "{name: best, command: optimize, part_from: fit, options: {step: 5}}",
        "{name: c, command: compare-lighting}",
    )
    tasks = expand(files.folder / "jobs.yaml", command_form, files.out, threads=1)
    (first, second) = [task for task in tasks if task.job == "c"]
    rigs = [str(files.rig), str(files.folder / "second.yaml")]
    assert first.command == ("compare-lighting", str(files.folder / "parts" / "a.yaml"), *rigs)
    assert (first.place, second.place) == ("c/a", "c/b")


def test_files_of_the_same_name_are_told_apart_by_their_folders(files):
    for name in ("one", "two"):
        (files.folder / name).mkdir()
        shutil.copy(files.folder / "parts" / "a.yaml", files.folder / name / "part.yaml")
    files.edit("jobs.yaml", "parts: [parts]", 'parts: ["*/part.yaml"]')
    tasks = expand(files.folder / "jobs.yaml", command_form, files.out, threads=1)
    assert {task.part for task in tasks} == {"one-part", "two-part"}


@pytest.mark.parametrize(
    ("old", "new", "line", "message"),
    [
        ("command: render", "command: rendr", 6, 'jobs[0].command: expected a command on a rig and a part, found "re'),
        ("command: render", "command: defects", 6, "expected a command on a rig and a part"),
        ("sheet: true", "sheets: true", 7, 'no such option of render in a batch; did you mean "sheet"?'),
        ("sheet: true", "no-shadows: true", 7, "write shadows: false"),
        ("sheet: true", "force: true", 7, "no such option of render in a batch; its options are light"),
        ("step: 5", "workers: 2", 9, "no such option of optimize in a batch"),
        ("sheet: true", "sheet: 1", 7, "expected true or false, found 1"),
        ("sheet: true", "sheet: false", 7, "leave the option out"),
        ("sheet: true", "noise: true", 7, "expected a value, found true"),
        ("step: 5", "calibration: none.json", 9, "no such file"),
        (", images_from: images", "", 8, "fit-specular reads images; give images_from: JOB, or images: FOLDER"),
        ("part_from: fit", "images_from: images", 9, "optimize reads no images"),
        ("step: 5", "step: five", 9, 'jobs[2].options.step: expected a number, found "five"'),
        ("step: 5", "step: -5", 9, "jobs[2].options.step: expected degrees above 0, found -5"),
        ("step: 5", "posture-step: 5", 9, "options.posture-step: has no effect without --choose-postures or --target"),
        ("[1, 1/16]", "[1, 1/x]", 7, "jobs[0].options.exposure: expected a number from"),
        ("sheet: true", "posture: [a, b]", 7, "options.posture: expected tilt,rotation in degrees, such as 0,82"),
        ("sheet: true", "noise: -1", 7, "jobs[0].options.noise: expected a seed of 0 or more, found -1"),
        ("optimize, part_from: fit, options: {step: 5}", "dataset", 9, "jobs[2]: Missing option '--images'"),
        ("rigs: [rig.yaml]", "rigs: [rg.yaml]", 2, "rigs[0]: no such file"),
        ("parts: [parts]", 'parts: ["*.yml"]', 3, "parts[0]: no file matches"),
        ("parts: [parts]", "parts: [empty]", 3, "parts[0]: no file matches"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_jobs(files, old, new, line, message):
    (files.folder / "empty").mkdir()
    files.edit("jobs.yaml", old, new)
    (said,) = problems(files)
    assert said.startswith(f"{files.folder / 'jobs.yaml'}:{line}: ")
    assert message in said


@pytest.mark.parametrize(
    ("old", "new", "line", "message"),
    [
        ("name: fit,", "name: Images,", 8, 'the name "Images" is already that of jobs[0]'),
        ("images_from: images", "images_from: image", 8, 'no job "image"; the jobs are images, fit, best'),
        ("command: render", "command: render\n    needs: [best]", 5, "images needs best needs fit needs im"),
        ("images_from: images", "images_from: images, images: x", 8, "expected only one of them"),
        ("step: 5", "step: {a: 1}", 9, "expected a number, text, true, false, or a list"),
        ("name: best", "name: best.1", 9, "expected a name without a dot"),
        ("name: best", "nam: best", 9, 'did you mean "name"?'),
    ],
)  # fmt: skip
def test_what_is_wrong_with_the_file(files, old, new, line, message):
    files.edit("jobs.yaml", old, new)
    messages = problems(files)
    assert any(f":{line}: " in said and message in said for said in messages), messages


def test_all_that_is_wrong_with_the_file_is_said_at_once(files):
    for old, new in [
        ("rigs: [rig.yaml]", "rigs: [rg.yaml, 3]"),
        ("command: render", "command: rendr"),
        ("images_from: images", "images_from: image, images: 7"),
        ("{step: 5}", "{stp: 5, images: {}, calibration: none.json}, needed: []"),
    ]:
        files.edit("jobs.yaml", old, new)
    expected = [
        (2, "rigs[0]: no such file"),
        (2, "rigs[1]: expected text"),
        (6, 'command: expected a command on a rig and a part, found "rendr"'),
        (8, 'images_from: no job "image"'),
        (8, "images: given together with images_from"),
        (8, "images: expected text"),
        (9, 'options.stp: no such option of optimize in a batch; did you mean "step"?'),
        (9, "options.images: expected a number, text, true, false, or a list"),
        (9, "options.calibration: no such file"),
        (9, 'unknown key "needed"; did you mean "needs"?'),
    ]
    messages = problems(files)
    assert len(messages) == len(expected), messages
    for line, message in expected:
        assert any(f"jobs.yaml:{line}: " in said and message in said for said in messages), message


def test_all_values_that_are_wrong_are_said_at_once(files):
    """Also those that the command would not come to, and none that is wrong only where another one is left out."""
    options = "{step: five, objective: [paper, areas], exposure: x, exposure-gain: 2, shade-below: 3}"
    files.edit("jobs.yaml", "{step: 5}", options)
    expected = [
        'options.step: expected a number, found "five"',
        'options.objective: expected coverage or paper or detectability, found "areas"',
        "options.exposure: expected a number from",
        "options.shade-below: expected a share of full scale",
    ]
    messages = problems(files)
    assert len(messages) == len(expected), messages
    for message in expected:
        assert any("jobs.yaml:9: jobs[2]." in said and message in said for said in messages), message


@pytest.mark.parametrize("command", [name for name in _COMMANDS if command_form(name) is not None])
def test_options_are_checked_without_a_file(command, tmp_path, monkeypatch, capsys):
    """No command reads its rig, part or images, or writes anything, when its options are checked."""
    monkeypatch.chdir(tmp_path)
    needed = {"images": ["--images=2"]} if command == "dataset" else {}
    assert list(command_form(command).problems(needed)) == []
    assert not list(tmp_path.iterdir())
    assert capsys.readouterr() == ("", "")


def test_ctrl_c_while_options_are_checked(monkeypatch):
    def interrupt():
        raise KeyboardInterrupt

    monkeypatch.setattr("lightopt.cli._common.options_are_read", interrupt)
    with pytest.raises(KeyboardInterrupt):
        list(command_form("check").problems({}))


HARDWARE = """\
hardware:
  controllers: {main: {driver: ccs, port: PORT, channels: 4}}
  lights: {light1: {controller: main, channel: 1, level: 200}, light3: {controller: main, channel: 3, level: 150}}
  camera: {driver: virtual}
"""


@pytest.mark.parametrize(("port", "real"), [("virtual", False), ("COM3", True)])
def test_a_batch_drives_no_devices(files, port, real):
    with files.rig.open("a", encoding="utf-8") as file:
        file.write(HARDWARE.replace("PORT", port))
    old = "command: render\n    options: {exposure: [1, 1/16], sheet: true}"
    files.edit("jobs.yaml", old, "command: capture")
    if not real:
        assert expand(files.folder / "jobs.yaml", command_form, files.out, threads=1)[0].command[0] == "capture"
    else:
        assert "a batch drives none" in problems(files)[0]


def test_the_command(cli, files, monkeypatch):
    jobs = files.folder / "jobs.yaml"
    monkeypatch.setattr("lightopt.cli._batch.run_captured", commands := Commands())
    commands.answers[("render", "a")] = (2, "warning: coarse\nerror: no room\n")
    ran = cli("batch", jobs, "-o", files.out, "--workers", 1)
    assert ran.status == 1
    assert ran.err == "error: images/rig/a: no room\n"
    assert len(ran.out.splitlines()) <= 15
    assert ran.out.startswith("6 tasks: 3 done, 1 failed, 2 skipped; ")
    assert cli("batch", jobs, "-o", files.out, "--workers", 1, "--quiet").out == ""
    commands.answers[("optimize", "part.fitted")] = (130, "")
    ran = cli("batch", jobs, "-o", files.folder / "other", "--workers", 1)
    assert ran.status == 130
    assert "the same command continues the batch" in ran.err
    ran = cli("batch", jobs, "-o", files.out, "--scheduler", "tcp://127.0.0.1:1", "--workers", 2)
    assert (ran.status, "no effect with --scheduler" in ran.err) == (2, True)
    ran = cli("batch", jobs, "-o", files.out, "--slurm", "--kubernetes")
    assert (ran.status, "expected one of them" in ran.err) == (2, True)


class LostResult:
    """A future whose result went with its worker, as Dask has it until another one has computed it again."""

    key, status = "best-1", "lost"

    def __init__(self, then):
        self.then = then

    def exception(self):
        self.status = self.then

    def result(self):
        assert self.status == "finished"
        return _task.Outcome(place="best/knob", state="done")


@pytest.mark.parametrize(("then", "state"), [("finished", "done"), ("cancelled", "failed")])
def test_a_result_that_went_with_its_worker_is_computed_again(then, state):
    assert _schedule._outcome(LostResult(then), {"best-1": "best/knob"}).state == state


def test_a_scheduler_that_does_not_answer(batch, monkeypatch):
    monkeypatch.setattr(_cluster, "_ANSWER_S", 0.2)
    with pytest.raises(InputError, match=r"tcp://127.0.0.1:1: no Dask scheduler answers"):
        batch(workers=Workers(scheduler="tcp://127.0.0.1:1"))
    with pytest.raises(InputError, match="no Dask scheduler answers"):
        batch(workers=Workers(scheduler="nonsense://x"))
    with socket.create_server(("127.0.0.1", 0)) as other, pytest.raises(InputError, match="no Dask scheduler answers"):
        batch(workers=Workers(scheduler=f"tcp://127.0.0.1:{other.getsockname()[1]}"))


@pytest.mark.parametrize(
    ("workers", "missing", "install"),
    [
        (Workers(number=2), "distributed", "lightopt[batch]"),
        (Workers(system="slurm"), "dask_jobqueue", "lightopt[slurm]"),
        (Workers(system="kubernetes"), "dask_kubernetes.operator", "lightopt[kubernetes]"),
    ],
)
def test_packages_that_are_missing(batch, monkeypatch, workers, missing, install):
    monkeypatch.setitem(__import__("sys").modules, missing, None)
    with pytest.raises(InputError) as caught:
        batch(workers=workers)
    assert install in caught.value.messages[0]


class KubeCluster:
    """Stand in for ``dask_kubernetes.operator.KubeCluster``: the same arguments, and no Kubernetes."""

    name = "dask-user-1"
    fails: ClassVar[dict[str, BaseException]] = {}
    calls: ClassVar[list[tuple]] = []

    def __init__(self, *, name=None, namespace=None, image=None, n_workers=None, resources=None, env=None,
                 worker_command=None, port_forward_cluster_ip=None, create_mode=None, shutdown_on_close=None,
                 idle_timeout=None, resource_timeout=None, scheduler_service_type=None, custom_cluster_spec=None,
                 scheduler_forward_port=None, jupyter=False, loop=None, asynchronous=False, quiet=False):  # fmt: skip
        given = {key: value for key, value in locals().items() if key != "self" and value}
        self.called("start", given)

    def called(self, *call):
        self.calls.append(call)
        if call[0] in self.fails:
            raise self.fails[call[0]]

    def scale(self, n, worker_group="default"):
        self.called("scale", n, worker_group)

    def close(self, timeout=3600):
        self.called("close", timeout)

    def __enter__(self):
        return self

    def __exit__(self, kind, value, traceback):
        self.close()


STARTED = [("start", {"quiet": True}), ("scale", 3, "default")]


@pytest.fixture
def pods(monkeypatch):
    """The calls of a Kubernetes cluster of three pods; run with what fails, and what happens meanwhile."""
    warned = []
    operator = ModuleType("dask_kubernetes.operator")
    operator.KubeCluster = KubeCluster
    monkeypatch.setitem(sys.modules, operator.__name__, operator)
    monkeypatch.setattr(KubeCluster, "calls", [])

    def run(meanwhile=None, **fails):
        monkeypatch.setattr(KubeCluster, "fails", fails)
        with _cluster._started("kubernetes", 3, RunContext(warn=warned.append)) as cluster:
            assert isinstance(cluster, KubeCluster)
            if meanwhile is not None:
                raise meanwhile

    run.calls, run.warned = KubeCluster.calls, warned
    return run


@pytest.mark.parametrize("meanwhile", [None, InputError("no room"), KeyboardInterrupt(), GeneratorExit()])
def test_pods_are_started_and_removed_whatever_happens(pods, meanwhile):
    with nullcontext() if meanwhile is None else pytest.raises(type(meanwhile)) as caught:
        pods(meanwhile)
    assert meanwhile is None or caught.value is meanwhile
    assert pods.calls == [*STARTED, ("close", 3600)]
    assert pods.warned == []


def test_a_cluster_of_pods_that_does_not_start(pods):
    log = RuntimeError("Scheduler failed to start.\n" + "line of the log\n" * 1000)
    with pytest.raises(InputError) as caught:
        pods(start=log)
    (message,) = caught.value.messages
    assert message.startswith(
        "dask-kubernetes could not start a cluster (RuntimeError: Scheduler failed to start. line"
    )
    assert len(message) < 700
    assert pods.calls == STARTED[:1], "what was not started is not removed"
    with pytest.raises(KeyboardInterrupt):
        pods(start=KeyboardInterrupt())


def test_pods_that_are_refused(pods):
    with pytest.raises(InputError, match=r"dask-kubernetes could not start 3 workers \(OSError: forbidden\)"):
        pods(scale=OSError("forbidden"))
    assert pods.calls == [*STARTED, ("close", 3600)]


@pytest.mark.parametrize("meanwhile", [None, InputError("no room"), KeyboardInterrupt()])
def test_pods_that_cannot_be_removed_cost_no_results(pods, meanwhile):
    with nullcontext() if meanwhile is None else pytest.raises(type(meanwhile)) as caught:
        pods(meanwhile, close=TimeoutError("no answer"))
    assert meanwhile is None or caught.value is meanwhile
    (message,) = pods.warned
    assert message.startswith("dask-kubernetes could not remove the cluster dask-user-1 (TimeoutError: no answer)")


def test_ctrl_c_while_pods_are_removed(pods):
    with pytest.raises(KeyboardInterrupt):
        pods(close=KeyboardInterrupt())


def test_the_arguments_are_those_of_dask_kubernetes():
    """Where the package is installed: it takes any others, too, and hands them on."""
    real = pytest.importorskip("dask_kubernetes.operator").KubeCluster
    mine, own = (inspect.signature(cluster).parameters for cluster in (KubeCluster, real))
    assert set(mine) <= set(own)
    for name in ("scale", "close"):
        ours, theirs = (inspect.signature(getattr(cluster, name)).parameters for cluster in (KubeCluster, real))
        assert list(ours) == list(theirs)


def test_progress_counts_tasks(batch):
    shares = []
    batch(run=RunContext(progress=lambda stage, share: shares.append((stage, round(share, 2)))))
    assert shares[0] == ("6 of 6 tasks", 0.17)
    assert shares[-1] == ("6 of 6 tasks", 1.0)


@pytest.mark.parametrize(
    ("lines", "answer"),
    [
        ([], ""),
        (["4 images"], "4 images"),
        (["lights  found at", "60°, 45°   50 %", "3  4"], "lights: 60°, 45°; found at: 50 %"),
        (["a  b  c", "1     2"], "1 2"),
        (["a  b"], "a b"),
    ],
)
def test_the_answer_is_the_first_line_or_row(lines, answer):
    assert _task._answer(lines) == answer


def test_a_record_names_what_it_is_of(batch, files):
    batch()
    record = json.loads((files.out / "images" / "rig" / "a" / "task.json").read_text(encoding="utf-8"))
    assert record["format"] == "lightopt-task/1"
    assert record["files"] == {
        "inner/result.txt": 16,
        "terminal.txt": (files.out / "images/rig/a/terminal.txt").stat().st_size,
    }
