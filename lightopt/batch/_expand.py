"""The tasks of a batch: each job for each rig and part, its command line, and the hash of all that it depends on."""

import glob
import hashlib
import json
import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

from lightopt.batch._task import FromTask, Task, content_sha256
from lightopt.config import JobConfig, PartConfig, RigConfig, input_files, load_batch, load_part, load_ranges, load_rig
from lightopt.core.errors import InputError, did_you_mean
from lightopt.core.provenance import computed_by
from lightopt.images import MANIFEST_NAME, read_image_set


@dataclass(frozen=True, kw_only=True)
class OptionForm:
    flag: bool = False  # without a value
    has_opposite: bool = False  # --no-NAME is a flag, too
    repeatable: bool = False
    file: bool = False  # its value names a file or folder that is read


@dataclass(frozen=True, kw_only=True)
class CommandForm:
    """What a command takes: arguments (rig, part, images, rigs: all rigs at once), and options by long name."""

    name: str
    arguments: tuple[str, ...]
    options: Mapping[str, OptionForm]
    problems: Callable[[Mapping[str, Sequence[str]]], Iterator[tuple[str | None, str]]]
    """What is wrong with the values of options, whose words it is given by name: name of one option or None, message"""
    defaults: Mapping[str, Any] = field(default_factory=dict[str, Any])  # of its options, as JSON has them
    writes_folder: bool = True  # takes -o DIR
    takes_threads: bool = True


FormOf = Callable[[str], CommandForm | None]
Keys = tuple[str | int, ...]  # that lead to a value of the file
_VALUES = (bool, int, float, str, list)  # of an option, as the file is read


@dataclass(frozen=True)
class _Input:
    # a rig or part file, and all that is read with it
    name: str
    path: Path
    hashes: Mapping[str, str]  # SHA-256 of each file, by its path
    drives_devices: bool = False

    @property
    def facts(self) -> dict[str, Any]:
        # the same wherever the files are; results name the first one
        return {"file": self.path.name, "sha256": list(self.hashes.values())}


def expand(path: Path, form_of: FormOf, out: Path, *, threads: int) -> tuple[Task, ...]:
    """The tasks of a batch file, each after those that it needs; results go to ``out/JOB/RIG/PART``.

    form_of: The form of a command; None where there is none for a rig and a part
    Raises InputError: All that is wrong with the file, the files that it names and the options of its jobs; if nothing
        is but for values of options, :func:`check_option_values` has to be called for jobs that are run
    """
    named = dict[str, tuple[_Input, ...]]()

    def misfits(raw: Mapping[str, Any]) -> Iterator[tuple[Keys, str]]:
        for key, load in (("rigs", load_rig), ("parts", load_part)):
            named[key], problems = _named_inputs(raw.get(key), path.parent, load)
            yield from (((key, *keys), message) for keys, message in problems)
        for index, job in _jobs_of(raw):
            problems = _job_misfits(job, form_of, path.parent, named["rigs"])
            yield from ((("jobs", index, *keys), message) for keys, message in problems)

    def all_misfits(raw: Mapping[str, Any]) -> Iterator[tuple[Keys, str]]:
        yield from misfits(raw)
        yield from _value_misfits(raw, form_of, path.parent)

    try:
        batch = load_batch(path, misfits)
    except InputError:
        batch = load_batch(path, all_misfits)  # which says all that is wrong at once
    rigs, parts = named["rigs"], named["parts"]
    made_by, tasks = computed_by(), dict[tuple[str, str, str], Task]()
    for job in batch.in_order:
        form = form_of(job.command)
        assert form is not None, "the file was refused otherwise"
        options = [_option_words(form, name, value, path.parent) for name, value in job.options.items()]
        words = [word for own, _ in options for word in own]
        option_files = {str(file): content_sha256(file) for _, files in options for file in files}
        groups = [rigs] if "rigs" in form.arguments else [(rig,) for rig in rigs]
        for own_rigs, part in product(groups, parts):
            needs = {name: [tasks[name, rig.name, part.name] for rig in own_rigs] for name in job.all_needs}
            place = Path(job.name, *([] if "rigs" in form.arguments else [own_rigs[0].name]), part.name)
            images = None
            if job.images is not None:
                folder = job.images.replace("{rig}", own_rigs[0].name).replace("{part}", part.name)
                images = batch.source.resolve(folder).absolute()
            inputs = [pair for one in (*own_rigs, part) for pair in one.hashes.items()]
            arguments, facts = _arguments(job, form, own_rigs, part, images, needs)
            facts |= {"command": job.command, "options": job.options, "defaults": form.defaults}
            facts["files"] = list(option_files.values())
            text = json.dumps({**facts, "computed_by": made_by}, sort_keys=True)
            task = Task(
                job=job.name,
                rig=", ".join(rig.name for rig in own_rigs),
                part=part.name,
                folder=out.absolute() / place,
                place=place.as_posix(),
                key=hashlib.sha256(text.encode()).hexdigest(),
                command=(job.command, *arguments, *words),
                tail=((f"--threads={threads}",) if form.takes_threads else ()),
                writes_folder=form.writes_folder,
                files=tuple({**option_files, **dict(inputs), **_manifest(images)}.items()),
                needs=tuple(dict.fromkeys(one.place for some in needs.values() for one in some)),
                computed_by=json.dumps(made_by, sort_keys=True),
            )
            tasks |= {(job.name, rig.name, part.name): task for rig in own_rigs}
    return tuple({task.place: task for task in tasks.values()}.values())


def check_option_values(path: Path, form_of: FormOf, jobs: Set[str]) -> None:
    """Check what commands say of the values of the options of these jobs of a batch file.

    Each command loads the package that it is of to do so, which takes longer than a batch that is done.

    Raises InputError: With the lines of the file
    """
    if jobs:
        load_batch(path, lambda raw: _value_misfits(raw, form_of, path.parent, jobs))


def _jobs_of(raw: Mapping[str, Any]) -> Iterator[tuple[int, Mapping[str, Any]]]:
    jobs = raw.get("jobs")
    entries: list[Any] = jobs if isinstance(jobs, list) else []
    yield from ((index, job) for index, job in enumerate(entries) if isinstance(job, Mapping))


def _value_misfits(
    raw: Mapping[str, Any], form_of: FormOf, folder: Path, jobs: Set[str] | None = None
) -> Iterator[tuple[Keys, str]]:
    # what is wrong with values of options, of jobs of some names or of all, as they were read
    for index, job in _jobs_of(raw):
        command, options = job.get("command"), job.get("options")
        form = form_of(command) if isinstance(command, str) else None
        if form is None or (jobs is not None and job.get("name") not in jobs):
            continue
        words = {
            name: _option_words(form, name, value, folder)[0]
            for name, value in (options.items() if isinstance(options, Mapping) else ())
            if isinstance(value, _VALUES) and not any(_option_misfits(form, name, value, folder))
        }
        for name, message in form.problems(words):
            yield ("jobs", index, *(() if name is None else ("options", name))), message


def _job_misfits(
    job: Mapping[str, Any], form_of: FormOf, folder: Path, rigs: Sequence[_Input]
) -> Iterator[tuple[Keys, str]]:
    # what is wrong with command, images and options of a job as it was read, but for the values of options
    if not isinstance(command := job.get("command"), str):
        return
    form = form_of(command)
    if form is None:
        yield ("command",), f'expected a command on a rig and a part, found "{command}"'
        return
    reads, given = "images" in form.arguments, job.get("images") is not None or job.get("images_from") is not None
    if reads and not given:
        yield (), f"{command} reads images; give images_from: JOB, or images: FOLDER"
    elif given and not reads:
        yield (), f"{command} reads no images; leave images and images_from out"
    if command == "capture":
        driven = [rig.name for rig in rigs if rig.drives_devices]
        yield from (((), f"capture would drive the devices of rig {rig}, and a batch drives none") for rig in driven)
    options = job.get("options")
    for name, value in options.items() if isinstance(options, Mapping) else ():
        yield from ((("options", name), message) for message in _option_misfits(form, name, value, folder))


def _named_inputs(
    texts: Any, folder: Path, load: Callable[[Path], RigConfig | PartConfig]
) -> tuple[tuple[_Input, ...], list[tuple[Keys, str]]]:
    """The rig or part files that the batch names, each once, and what is wrong with the names."""
    paths, problems = dict[Path, None](), list[tuple[Keys, str]]()
    entries: list[Any] = texts if isinstance(texts, list) else []
    for index, text in enumerate(entries):
        if not isinstance(text, str) or not text:
            continue  # the form of the file is checked elsewhere
        given = folder / text
        pattern = str(given / "*.yaml" if given.is_dir() else given)
        matches = [given] if given.is_file() else map(Path, glob.glob(pattern, recursive=True))  # noqa: PTH207 - absolute
        found = sorted(path for path in matches if path.is_file())
        if not found:
            what = f"no such file: {given}" if glob.escape(pattern) == pattern else f"no file matches {pattern}"
            problems.append(((index,), f"{what}; expected YAML files or a folder of them"))
        paths |= dict.fromkeys(Path(os.path.abspath(path)) for path in found)  # noqa: PTH100 - links stay as they are
    names = {path: path.stem for path in paths}
    same = Counter(name.lower() for name in names.values())
    names |= {path: f"{path.parent.name}-{name}" for path, name in names.items() if same[name.lower()] > 1}
    for name, number in Counter(name.lower() for name in names.values()).items():
        if number > 1:
            problems.append(((), f"{number} files would have their results in folders {name}; rename them"))
    return tuple(_read(name, path, load) for path, name in names.items()), problems


def _read(name: str, path: Path, load: Callable[[Path], RigConfig | PartConfig]) -> _Input:
    files, drives_devices = [path], False
    try:
        config = load(path)
        files += input_files(config).values()
        if isinstance(config, RigConfig):
            if (hardware := config.hardware) is not None:
                stage = [] if hardware.stage is None else [hardware.stage.port]
                ports = {*stage, *(controller.port for controller in hardware.controllers.values())}
                drives_devices = hardware.camera.driver != "virtual" or not ports <= {None, "virtual"}
            if config.virtual_bench is not None and config.virtual_bench.rig is not None:
                files.append(config.source.resolve(config.virtual_bench.rig))
                files += input_files(load_rig(files[-1])).values()
    except InputError:
        pass  # one wrong file stops no other: its own tasks fail, and say why
    return _Input(name, path, {str(file.absolute()): content_sha256(file) for file in files}, drives_devices)


def _arguments(
    job: JobConfig,
    form: CommandForm,
    rigs: Sequence[_Input],
    part: _Input,
    images: Path | None,
    needs: Mapping[str, Sequence[Task]],
) -> tuple[list[str | FromTask], dict[str, Any]]:
    """Arguments of the command, and facts that its results depend on."""
    arguments = list[str | FromTask]()
    facts: dict[str, Any] = {"rig": [rig.facts for rig in rigs], "part": part.facts}
    for name in form.arguments:
        kind = name.removesuffix("s") if name == "rigs" else name
        source = job.sources.get(kind)
        if source is not None:
            # the same key, the same results
            facts[kind] = [task.key for task in needs[source]]
            pattern = "" if kind == "images" else f"{kind}.*.yaml"
            arguments += [FromTask(str(task.folder), pattern) for task in dict.fromkeys(needs[source])]
        elif kind == "images":
            facts[kind] = _fingerprint(images)
            arguments.append(str(images))
        else:
            arguments += [str(one.path) for one in (rigs if kind == "rig" else [part])]
    return arguments, facts


def _manifest(images: Path | None) -> dict[str, str]:
    if images is None:
        return {}
    file = images / MANIFEST_NAME if images.is_dir() else images
    return {str(file): content_sha256(file)}


def _fingerprint(images: Path | None) -> dict[str, Any]:
    try:
        return {} if images is None else read_image_set(images).fingerprint
    except (InputError, OSError):
        return {}


def _option_words(form: CommandForm, name: str, value: Any, folder: Path) -> tuple[list[str], list[Path]]:
    """An option of a job as words of its command line, and the files that it names, relative to the batch file."""
    if isinstance(value, bool):
        return [f"--{name}" if value else f"--no-{name}"], []
    option, files = form.options[name], list[Path]()
    texts = [str(one) for one in (value if isinstance(value, Sequence) and not isinstance(value, str) else (value,))]
    if option.file:
        files = [(folder / text).absolute() for text in texts]
        texts = [str(file) for file in files]
        files += [named for file in files for named in _named_by(file)]
    # --option=value: a value may begin with a dash
    return [f"--{name}={text}" for text in (texts if option.repeatable else [",".join(texts)])], files


def _named_by(file: Path) -> list[Path]:
    # files that a dataset's ranges name; other files of options name none
    try:
        return [path.absolute() for path in input_files(load_ranges(file)).values()] if file.suffix == ".yaml" else []
    except InputError:
        return []


def _option_misfits(form: CommandForm, name: str, value: object, folder: Path) -> Iterator[str]:
    option = form.options.get(name)
    if option is None:
        plain = name.replace("_", "-")
        opposite = plain.removeprefix("no-")
        hint = did_you_mean(plain, form.options) or f"; its options are {', '.join(form.options)}"
        if opposite in form.options and form.options[opposite].has_opposite:
            hint = f"; write {opposite}: false"
        yield f"no such option of {form.name} in a batch{hint}"
    elif not isinstance(value, _VALUES):
        return  # the form of the file is checked elsewhere
    elif option.flag and not isinstance(value, bool):
        yield f"expected true or false, found {value}"
    elif isinstance(value, bool) and not option.flag:
        yield f"expected a value, found {str(value).lower()}"
    elif value is False and not option.has_opposite:
        yield "expected true; leave the option out where it is not wanted"
    elif option.file:
        paths = [folder / str(one) for one in (value if isinstance(value, list) else (value,))]
        yield from (f"no such file: {path}" for path in paths if not path.exists())
