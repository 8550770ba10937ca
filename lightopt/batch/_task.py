"""One task of a batch, wherever it runs: a command whose results appear as a whole folder or not at all.

``task.json`` in the folder says what the results are of. A folder whose key is that of the task is never made again.
"""

import json
import os
import platform
import re
import shutil
import threading
import uuid
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import Any, Literal

from lightopt.batch._cluster import version_problems
from lightopt.core.errors import InputError, error_text, refuse
from lightopt.core.provenance import file_sha256, files_sha256
from lightopt.images import make_folder, write_text_atomic

RECORD_NAME, TERMINAL_NAME = "task.json", "terminal.txt"
_FORMAT, _UNREADABLE = "lightopt-task/1", "unreadable"
_CHECK_FAILED, _INTERRUPTED = 1, 130  # exit statuses of a command

RunCommand = Callable[[list[str]], tuple[int, str, str]]
"""Runs a command line in this process: exit status, standard output, standard error. Importable by its name."""

_ALONE = threading.Lock()  # what a command prints is the process's, so that one runs at a time


@dataclass(frozen=True)
class FromTask:
    """An argument: the folder of another task, or the one file in it that a pattern matches."""

    folder: str
    pattern: str = ""


@dataclass(frozen=True, kw_only=True)
class Task:
    job: str
    rig: str
    part: str
    place: str  # folder of the results, below that of the batch
    folder: Path
    key: str  # SHA-256 of all that the results depend on
    command: tuple[str | FromTask, ...]
    tail: tuple[str, ...]  # words that change no result
    writes_folder: bool
    files: tuple[tuple[str, str], ...]  # path and SHA-256 of what is read
    needs: tuple[str, ...]  # places of other tasks
    computed_by: str  # JSON of what computes, where the batch was started


State = Literal["done", "kept", "failed", "skipped"]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    place: str
    state: State
    seconds: float = 0.0
    answer: str = ""  # what the command printed first
    messages: tuple[str, ...] = ()  # errors and warnings
    worker: str = ""

    @property
    def succeeded(self) -> bool:
        return self.state in ("done", "kept")


@dataclass(frozen=True, kw_only=True)
class _Record:
    # of results that are there: also of a command whose check failed, which would fail again
    key: str
    succeeded: bool
    seconds: float
    answer: str
    messages: list[str]
    files: dict[str, int] = field(default_factory=dict[str, int])  # bytes of each file
    format: str = _FORMAT


def published(task: Task) -> Outcome | None:
    """What became of a task whose results are there, complete and of the same inputs; None where it has to be run.

    Raises InputError: Something else is in its place
    """
    try:
        found: dict[str, Any] = json.loads((task.folder / RECORD_NAME).read_text(encoding="utf-8"))
        record = _Record(**found)
    except FileNotFoundError:
        if task.folder.exists() and any(task.folder.iterdir()):
            raise InputError(f"{task.folder}: exists, and is not a result of a batch; move it away") from None
        return None
    except (OSError, ValueError, TypeError):
        return None
    if record.key != task.key or record.format != _FORMAT:
        _require_own_files(task.folder, record)
        return None
    with suppress(OSError):
        if all((task.folder / name).stat().st_size == size for name, size in record.files.items()):
            messages, state = tuple(record.messages), "kept" if record.succeeded else "failed"
            return Outcome(place=task.place, state=state, answer=record.answer, messages=messages)
    return None


def _require_own_files(folder: Path, record: _Record) -> None:
    # results of earlier inputs are replaced; what else lies beside them is not
    own = {RECORD_NAME, *record.files}
    names = (path.relative_to(folder).as_posix() for path in sorted(folder.rglob("*")) if path.is_file())
    if other := [name for name in names if name not in own]:
        names = ", ".join(other[:3])
        raise InputError(f"{folder}: has files that the batch did not write ({names}); move them away")


def run_task(task: Task, run_command: RunCommand, *needed: Outcome) -> Outcome:
    """Run a task after those that it needs; whatever goes wrong is in the outcome."""
    failed = [one.place for one in needed if not one.succeeded]
    if failed:
        return Outcome(place=task.place, state="skipped", messages=(f"needs {', '.join(failed)}",))
    begun, worker = perf_counter(), f"{platform.node()} {os.getpid()}"
    try:
        there = published(task)
        if there is not None:
            return there
        refuse(worker_problems(task.computed_by, task.files))
        with _ALONE:
            outcome = _run(task, run_command)
    except (OSError, InputError) as error:
        outcome = Outcome(place=task.place, state="failed", messages=tuple(error_text(error).splitlines()))
    if outcome.state == "failed":
        with suppress(InputError):
            # another worker, which this task was given to as well, may have removed what this one was writing
            there = published(task)
            if there is not None and there.succeeded:
                return there
    return replace(outcome, seconds=perf_counter() - begun, worker=worker)


def worker_problems(expected: str, files: tuple[tuple[str, str], ...]) -> tuple[str, ...]:
    """Why this process cannot compute what the one that started the batch would: another version, other files."""
    if other := version_problems(expected):
        return other
    changed = [path for path, sha256 in files if content_sha256(Path(path)) != sha256]
    reason = f"changed since the batch was started, or another file or none on {platform.node()}"
    return tuple(f"{path}: {reason}; workers need the same files at the same paths" for path in changed)


def content_sha256(path: Path) -> str:
    """SHA-256 in hex of a file, or of all files of a folder with their names; a word where it cannot be read."""
    try:
        if not path.is_dir():
            return file_sha256(path)
        inner = (file.relative_to(path).as_posix() for file in path.rglob("*") if file.is_file())
        return files_sha256(path, sorted(inner))
    except OSError:
        return _UNREADABLE


def _run(task: Task, run_command: RunCommand) -> Outcome:
    """Run the command into a folder beside the results, which relative paths in them are right for."""
    make_folder(task.folder.parent)
    temporary = task.folder.with_name(f".{task.folder.name}@{uuid.uuid4().hex[:12]}")
    begun = perf_counter()
    try:
        temporary.mkdir()
        words = [word if isinstance(word, str) else _resolved(word) for word in task.command]
        words += [*task.tail, *(["-o", str(temporary)] if task.writes_folder else [])]
        status, out, err = run_command(words)
        if status == _INTERRUPTED:
            raise KeyboardInterrupt
        out, err = (text.replace(str(temporary), str(task.folder)) for text in (out, err))
        answer, messages = _answer(out.splitlines()), tuple(err.splitlines())
        done = status == 0
        if status in (0, _CHECK_FAILED):
            write_text_atomic(temporary / TERMINAL_NAME, out + err)
            files = (path for path in sorted(temporary.rglob("*")) if path.is_file())
            record = _Record(
                key=task.key,
                succeeded=done,
                seconds=round(perf_counter() - begun, 3),
                answer=answer,
                messages=list(messages),
                files={path.relative_to(temporary).as_posix(): path.stat().st_size for path in files},
            )
            text = json.dumps(asdict(record), indent=1, ensure_ascii=False) + "\n"
            write_text_atomic(temporary / RECORD_NAME, text)
            _publish(task, temporary)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return Outcome(place=task.place, state="done" if done else "failed", answer=answer, messages=messages)


def _answer(lines: Sequence[str]) -> str:
    # the first line that was printed, or of a table the first row, with the names of its columns
    if len(lines) < 2 or "  " not in lines[0]:
        return " ".join(lines[0].split()) if lines else ""
    names, cells = (re.split(r"\s{2,}", line.strip()) for line in lines[:2])
    if len(names) != len(cells):  # with empty cells
        return " ".join(lines[1].split())
    return "; ".join(f"{name}: {cell}" for name, cell in zip(names, cells, strict=True))


def _resolved(argument: FromTask) -> str:
    folder = Path(argument.folder)
    if not argument.pattern:
        return str(folder)
    found = sorted(folder.glob(argument.pattern))
    if len(found) != 1:
        names = ", ".join(path.name for path in found) or "none"
        raise InputError(f"{folder}: expected one file {argument.pattern}, found {names}")
    return str(found[0])


def _publish(task: Task, temporary: Path) -> None:
    """Put results in their place, unless another worker has put the same there; remove what killed ones left."""
    if published(task) is None:
        if task.folder.exists():
            task.folder.rename(task.folder.with_name(f".{task.folder.name}@{uuid.uuid4().hex[:12]}"))
        try:
            temporary.rename(task.folder)
        except OSError:
            if published(task) is None:
                raise
    remove_leftovers(task)


def remove_leftovers(task: Task) -> None:
    """Remove folders that workers were writing for a task whose results are there, or which no process runs."""
    with suppress(OSError):
        for path in task.folder.parent.iterdir():
            if path.name.rpartition("@")[0] == f".{task.folder.name}":
                shutil.rmtree(path, ignore_errors=True)
