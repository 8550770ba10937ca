"""Small scenes and the command line in process, for the tests of every tier."""

from __future__ import annotations

import hashlib
import os
import pickle
import shutil
import signal
import sys
from collections import Counter
from collections.abc import Callable, Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# NumPy and OpenCV read these when they are first imported, here and in commands that tests start. Their threads wait
# for one another by spinning, which takes as much time again of processors that all workers share
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OPENCV_FOR_THREADS_NUM", "1")

import pytest
from browsers import close_browsers
from forked_benches import ForkingProcess
from hypothesis import settings

from lightopt.cli._main import run
from lightopt.core.threads import available_processors
from lightopt.estimate.reflectance import _fit
from lightopt.estimate.registration import _image_checks, _refinement
from lightopt.geometry import _load_mesh
from lightopt.geometry._step import read_step
from lightopt.inspection.prediction import _prediction_cache
from lightopt.inspection.prediction._template_bank import template_bank

# a busy machine is no reason for an example to fail; CI draws the same every time, make test-nightly 15 times as many
settings.register_profile("developer", deadline=None, max_examples=20)
settings.register_profile("ci", deadline=None, max_examples=20, derandomize=True, database=None, print_blob=True)
settings.register_profile("nightly", deadline=None, max_examples=300)
settings.load_profile("ci" if os.environ.get("CI") else "developer")

ROOT = Path(__file__).resolve().parents[1]
MOST_BANKS = 6  # that are kept by `template_banks_once`


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """Twice as many as there are processors: many tests wait for simulated devices."""
    return 2 * available_processors()


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Modules of many slow tests come first; one that waits for simulated devices after every two that compute.

    So no worker is left alone with slow tests at the end, and the processors have work while others wait. This is the
    last of these hooks, so that tests that are not run do not count.
    """
    slow = Counter(item.path for item in items if item.get_closest_marker("slow"))
    tests = Counter(item.path for item in items)
    modules = sorted(tests, key=lambda path: (-slow[path], -tests[path]))
    computing = [path for path in modules if path.parent.name != "hardware"]
    waiting = [path for path in modules if path.parent.name == "hardware"]
    place = {path: 2.0 * number + 1.5 for number, path in enumerate(waiting)}
    place |= {path: float(number) for number, path in enumerate(computing)}
    items.sort(key=lambda item: place[item.path])


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol() -> Generator[None, object, object]:
    """Every test begins with Python's own Ctrl-C, whatever the shell ignores and earlier tests left."""
    numbers = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
    before = {number: signal.getsignal(number) for number in numbers}
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        return (yield)
    finally:
        for number, handler in before.items():
            if handler is not None:  # one that was not set from Python
                signal.signal(number, handler)


# One key a line where a test wants to see its line number. 160 × 120 pixels of 44 µm see 70 × 53 mm of the table.
RIG = """\
format: lightopt-rig/1
name: small
camera:
  distance_mm: 550
  elevation_deg: 90
  resolution_px: [160, 120]
  pixel_size_um: 44
  image_distance_mm: 55
  sensor: {bit_depth: 8, read_noise_levels: 0.8, electrons_per_level: 60}
light_source: {size_mm: [60, 60], points: 4}
lights:
  - {name: light1, distance_mm: 330, elevation_deg: 60, azimuth_deg: 45}
  - {name: light3, distance_mm: 330, elevation_deg: 45, azimuth_deg: 225, gain: 0.8}
stage: {elevation_range_deg: [-45, 45], rotation_range_deg: [0, 360]}
"""

PART = """\
format: lightopt-part/1
name: knob
mesh: {file: knob.stl, units: mm}
placement: {anchor: rest_on_table, translate_mm: [0, 0, 0]}
postures: [{elevation_deg: 0, rotation_deg: 0}, {elevation_deg: -10, rotation_deg: 170}]
reflectance: {R_d: 45.0, R_s: 12500, sigma_rad: 0.0475}
"""


@dataclass(frozen=True)
class Ran:
    """What a command left: exit status, standard output, standard error."""

    status: int
    out: str
    err: str


@dataclass(frozen=True)
class Bench:
    """A folder with a small rig, a part and its mesh, to render from and to spoil."""

    folder: Path

    @property
    def rig(self) -> Path:
        return self.folder / "rig.yaml"

    @property
    def part(self) -> Path:
        return self.folder / "part.yaml"

    @property
    def mesh(self) -> Path:
        return self.folder / "knob.stl"

    @property
    def out(self) -> Path:
        return self.folder / "out"

    def edit(self, name: str, old: str, new: str) -> None:
        """Replace the only place in a file that reads `old`."""
        path = self.folder / name
        text = path.read_text(encoding="utf-8")
        assert text.count(old) == 1, f"{old!r} stands {text.count(old)} times in {name}"
        path.write_text(text.replace(old, new), encoding="utf-8", newline="\n")

    @staticmethod
    def make(folder: Path) -> Bench:
        folder.mkdir(parents=True, exist_ok=True)
        bench = Bench(folder)
        bench.rig.write_text(RIG, encoding="utf-8", newline="\n")
        bench.part.write_text(PART, encoding="utf-8", newline="\n")
        shutil.copyfile(ROOT / "configs" / "parts" / "cover-knob.stl", bench.mesh)
        return bench


@pytest.fixture(scope="session", autouse=True)
def one_thread_each() -> Generator[None]:
    """The workers keep the processors busy: in them, work is spread over threads only where a test asks for it."""
    with pytest.MonkeyPatch.context() as patch:
        if hasattr(os, "sched_getaffinity"):
            patch.setattr(os, "sched_getaffinity", lambda _: {0})
        yield


@pytest.fixture(scope="session", autouse=True)
def step_files_once(tmp_path_factory: pytest.TempPathFactory) -> Generator[None]:
    """A STEP file is tessellated once for all workers, which takes longer than most tests; see `real_step_files`."""
    folder = tmp_path_factory.getbasetemp()
    kept = folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder

    def once(path: Path, data: bytes, **requested: object) -> object:
        key = hashlib.sha256(data + repr(sorted(requested.items())).encode()).hexdigest()
        file = kept / f"step-{key}.pickle"
        if not file.exists():
            soup = read_step(path, data, **requested)  # type: ignore[arg-type]
            mine = file.with_suffix(f".{os.getpid()}")
            mine.write_bytes(pickle.dumps(soup))
            mine.replace(file)
        return pickle.loads(file.read_bytes())

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_load_mesh, "read_step", once)
        yield


@pytest.fixture
def real_step_files(monkeypatch: pytest.MonkeyPatch) -> None:
    """STEP files are tessellated as a command does it."""
    monkeypatch.setattr(_load_mesh, "read_step", read_step)


@pytest.fixture(scope="session", autouse=True)
def template_banks_once() -> Generator[None]:
    """What defects would change in a view, more than half of a small inspection, is computed once in each worker.

    That is for the same scene, catalogue, number of threads, and view but for the images, as the cache of a batch has
    it; see `real_template_banks`.
    """
    kept: dict[str, object] = {}

    def once(scene: object, view: Any, catalogue: object, caster: object, *, threads: int | None = None) -> object:
        of_view = (view.posture, view.lights, view.predicted, view.deviation, view.limit, view.wavy, view.prediction)
        key = hashlib.sha256(pickle.dumps((scene, of_view, catalogue, threads))).hexdigest()
        if key not in kept:
            while len(kept) >= MOST_BANKS:
                del kept[next(iter(kept))]
            kept[key] = template_bank(scene, view, catalogue, caster, threads=threads)  # type: ignore[arg-type]
        return kept[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_prediction_cache, "template_bank", once)
        yield


@pytest.fixture
def real_template_banks(monkeypatch: pytest.MonkeyPatch) -> None:
    """What defects would change is computed for each inspection, as a command does it."""
    monkeypatch.setattr(_prediction_cache, "template_bank", template_bank)


@pytest.fixture(scope="session", autouse=True)
def forked_benches() -> Generator[None]:
    """Benches that tests start in their own process are forked, where the system can."""
    if sys.platform != "linux":
        yield
        return
    process, patch = ForkingProcess(), pytest.MonkeyPatch()
    patch.setattr("lightopt.rig.simulated._bench_process.start_process", process.start)
    yield
    patch.undo()
    process.close()


@pytest.fixture(scope="module", autouse=True)
def browsers_end_with_their_module() -> Generator[None]:
    """The tests of a module share a browser."""
    yield
    close_browsers()


@pytest.fixture
def cli(capsys: pytest.CaptureFixture[str]) -> Callable[..., Ran]:
    """Run a command line in process."""

    def command(*arguments: object) -> Ran:
        capsys.readouterr()
        status = run([str(argument) for argument in arguments])
        said = capsys.readouterr()
        return Ran(status, said.out, said.err)

    return command


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    """A small rig and part of the test's own."""
    return Bench.make(tmp_path / "bench")


@pytest.fixture(scope="session")
def shared_bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    """A small rig and part that no test changes."""
    return Bench.make(tmp_path_factory.mktemp("shared") / "bench")


@pytest.fixture
def few_pixels_for_the_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    """Registration and second opinions on fits look at a quarter of their pixels: for tests of files and words."""
    monkeypatch.setattr(_fit, "SECOND_BUDGET", 80)
    monkeypatch.setattr(_image_checks, "PIXELS", 1000)
    monkeypatch.setattr(_refinement, "INNER_PIXELS", 3000)
    monkeypatch.setattr(_refinement, "FIRST_INNER_PIXELS", 750)


@pytest.fixture(scope="session")
def snapshot() -> Callable[[Path], dict[str, str]]:
    """All files below a folder by name, with the hash of their bytes; empty where there is no folder."""

    def files(folder: Path) -> dict[str, str]:
        return {
            path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
            for path in sorted(folder.rglob("*"))
            if path.is_file()
        }

    return files
