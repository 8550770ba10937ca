"""Work spread over threads: the first exception ends it, soon where tasks ask whether they are stopped."""

from __future__ import annotations

import time

import pytest

from lightopt import build_scene, load_part, load_rig
from lightopt.core import threads as _threads
from lightopt.core.threads import end_if_stopped, in_threads, run_all
from lightopt.estimate.registration import read_observations, refuse_useless_images
from lightopt.images import read_image_set
from lightopt.rendering import _images, cast_rays_at


def endless() -> None:
    """A minute of work, unless it is stopped."""
    for _ in range(6000):
        end_if_stopped()
        time.sleep(0.01)


def test_running_tasks_end_where_another_fails():
    def fail() -> None:
        time.sleep(0.05)
        raise KeyboardInterrupt

    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        run_all([(endless, ()), (fail, ()), (endless, ())], threads=2)
    with pytest.raises(KeyboardInterrupt):
        in_threads(lambda start: fail() if start else endless(), [0, 1], 2)
    assert time.monotonic() - began < 40.0


def test_running_tasks_end_where_progress_raises():
    def tell() -> None:
        raise KeyboardInterrupt

    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        run_all([(endless, ()), (time.sleep, (0.01,))], threads=2, done=tell)
    assert time.monotonic() - began < 40.0


def test_nobody_is_stopped_elsewhere():
    end_if_stopped()
    with pytest.raises(ZeroDivisionError):
        run_all([(divmod, (1, 0))], threads=1)
    seen = []
    run_all([(lambda: (end_if_stopped(), seen.append(1)), ())], threads=1)
    assert seen == [1]
    assert in_threads(lambda start: end_if_stopped() or start, [1, 2, 3], 2) == [1, 2, 3]


@pytest.mark.slow
def test_one_thread_is_one_thread_whatever_is_done(cli, bench, monkeypatch):
    """With --threads 1 no work is spread over the machine's processors, not even the reading of images."""
    images = bench.folder / "images"
    ran = cli("render", bench.rig, bench.part, "-o", images, "--posture", "0,0", "--patches", "500", "-q")
    assert ran.status == 0, ran.err

    def all_of_them():
        raise AssertionError("work was spread over all the machine's processors")

    # whether or not these few pixels are more than one piece of work
    for module in (_threads, _images):
        monkeypatch.setattr(module, "available_processors", all_of_them)
    few = ("--threads", "1", "--pixels", "2000", "-q")
    ran = cli("fit-diffuse", bench.rig, bench.part, images, "-o", bench.out, *few)
    assert ran.status == 0, ran.err
    ran = cli(
        "fit-specular", bench.rig, bench.part, images, "-o", bench.folder / "specular", "--joint", *few
    )  # fmt: skip
    assert ran.status == 0, ran.err
    observations = read_observations(read_image_set(images), load_rig(bench.rig), load_part(bench.part), threads=1)
    scene = build_scene(bench.rig, bench.part)
    refuse_useless_images(scene, observations, caster=cast_rays_at(scene), threads=1)
