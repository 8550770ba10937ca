"""Several devices dealt with at a time, so that none waits for one that does not answer."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import TypeVar

T = TypeVar("T")


def run_in_parallel(work: Mapping[str, Callable[[], T]]) -> dict[str, T]:
    """Run the work of each device in a thread of its own; results in the order of the devices.

    All of it is done, whatever fails; then the first error in the order of the devices is raised, and Ctrl-C once all
    has ended. While the interpreter shuts down, when no thread can be started any more, one is done after the other.
    """
    results: dict[str, T] = {}
    errors: dict[str, BaseException] = {}

    def do(name: str) -> None:
        try:
            results[name] = work[name]()
        except BaseException as error:  # noqa: BLE001  (raised below)
            errors[name] = error

    threads = [_started(lambda name=name: do(name)) for name in [*work][1:]]
    try:
        if work:
            do(next(iter(work)))
    finally:
        _joined([thread for thread in threads if thread is not None])
    for name in work:
        if name in errors:
            raise errors[name]
    return {name: results[name] for name in work}


def _started(action: Callable[[], None]) -> threading.Thread | None:
    """Do it in a thread, or at once where none can be started."""
    thread = threading.Thread(target=action)
    try:
        thread.start()
    except RuntimeError:
        action()
        return None
    return thread


def _joined(threads: list[threading.Thread]) -> None:
    """Wait for all of them; what interrupts that is raised afterwards."""
    try:
        for thread in threads:
            thread.join()
    except BaseException:
        for thread in threads:
            thread.join()
        raise
