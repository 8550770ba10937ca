"""Tasks done one after the other beside the work that gives them."""

from __future__ import annotations

import threading
import time

import pytest

from lightopt.core.threads import BackgroundTasks


def test_tasks_are_done_in_order_by_one_thread():
    done = []
    with BackgroundTasks() as tasks:
        for number in range(20):
            tasks.add(lambda k: (time.sleep(0.001), done.append((k, threading.get_ident())))[0], number)
        tasks.wait()
        assert [k for k, _ in done] == list(range(20))
        tasks.add(done.append, (20, done[0][1]))
    assert len({thread for _, thread in done}) == 1
    assert threading.get_ident() not in {thread for _, thread in done}
    assert len(done) == 21


def fail():
    raise OSError("the disk is full")


@pytest.mark.parametrize("waits", [True, False])
def test_an_error_of_a_task_reaches_the_thread_that_gave_it_and_drops_the_rest(waits):
    done = []

    def work():
        with BackgroundTasks() as tasks:
            tasks.add(fail)
            tasks.add(done.append, "never")
            if waits:
                tasks.wait()

    with pytest.raises(OSError, match="disk is full"):
        work()
    assert not done


def test_what_stops_the_work_drops_the_tasks_that_wait_and_finishes_the_one_at_work():
    begun, done = threading.Event(), []

    def slow():
        begun.set()
        time.sleep(0.1)
        done.append("slow")

    def work():
        with BackgroundTasks() as tasks:
            tasks.add(slow)
            tasks.add(done.append, "never")
            begun.wait()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        work()
    assert done == ["slow"]
