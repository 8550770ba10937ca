"""Benches forked from a process that has imported all that they need, which saves each the two seconds of importing it.

Before the first bench with a camera it renders a small scene, so that the kernels of rendering are loaded for all.

The process of a bench is otherwise what `lightopt.rig.simulated` starts: a session, pipes and a temporary file of its
own. How it is started from nothing is tested in tests/hardware/test_bench_process.py, which does not use this.

As a script, this file is that process: it takes requests from the socket whose number is its argument.
"""

from __future__ import annotations

import gc
import json
import os
import select
import signal
import socket
import subprocess
import sys
from pathlib import Path
from typing import BinaryIO

from lightopt.rig.simulated import _bench_process

MOST_BYTES = 1 << 18
"""Longest request."""


class ForkedProcess:
    """What a bench's client uses of :class:`subprocess.Popen`."""

    def __init__(self, pid: int, stdin: int, stdout: int, status: int) -> None:
        self.pid = pid
        self.stdin = os.fdopen(stdin, "wb", buffering=0)
        self.stdout = os.fdopen(stdout, "rb")
        self.returncode: int | None = None
        self._status = os.fdopen(status, "rb", buffering=0)

    def poll(self) -> int | None:
        """Exit status; None while it runs."""
        if self.returncode is None and select.select([self._status], [], [], 0)[0]:
            self.returncode = int(self._status.readline())
            self._status.close()
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Exit status, once there is one."""
        if self.poll() is None and not select.select([self._status], [], [], timeout)[0]:
            raise subprocess.TimeoutExpired("bench", timeout or 0.0)
        found = self.poll()
        assert found is not None
        return found

    def kill(self) -> None:
        """Kill it, if it still runs."""
        if self.poll() is None:
            os.kill(self.pid, signal.SIGKILL)


class ForkingProcess:
    """The process that benches are forked from; started with the first of them, ends with this object."""

    def __init__(self) -> None:
        self._requests: socket.socket | None = None
        self._process: subprocess.Popen[bytes] | None = None

    def start(self, spec: str, errors: BinaryIO) -> ForkedProcess:
        """Start a bench, as `lightopt.rig.simulated._bench_process.start_process` does."""
        if self._requests is None:
            self._requests, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            command = [sys.executable, __file__, str(theirs.fileno())]
            # what this process finds its modules by; each bench has the environment of its request instead
            places = os.pathsep.join(place or str(Path.cwd()) for place in sys.path)
            self._process = subprocess.Popen(
                command, pass_fds=[theirs.fileno()], start_new_session=True, env={**os.environ, "PYTHONPATH": places}
            )
            theirs.close()
        request = {"spec": spec, "folder": str(Path.cwd()), "environment": dict(os.environ)}
        request["faulty"] = "faulty_bench" in _bench_process._START
        stdin, our_stdin = os.pipe()
        our_stdout, stdout = os.pipe()
        our_status, status = os.pipe()
        theirs_all = [stdin, stdout, errors.fileno(), status]
        try:
            socket.send_fds(self._requests, [json.dumps(request).encode()], theirs_all)
        finally:
            for descriptor in (stdin, stdout, status):
                os.close(descriptor)
        pid = int(_line(our_status))
        return ForkedProcess(pid, our_stdin, our_stdout, our_status)

    def close(self) -> None:
        """End it; benches that run go on."""
        if self._requests is not None and self._process is not None:
            self._requests.close()
            self._requests = None
            self._process.wait()


def _line(descriptor: int) -> bytes:
    line = b""
    while not line.endswith(b"\n"):
        piece = os.read(descriptor, 1)
        assert piece, "the process that benches are forked from has ended"
        line += piece
    return line


def _serve(requests: socket.socket) -> None:
    import embreex.rtcore_scene
    import trimesh

    import lightopt.rendering
    import lightopt.rig.simulated._host
    import lightopt.rig.simulated._optics

    sys.path.append(str(Path(__file__).resolve().parent / "hardware"))
    import faulty_bench

    _ = embreex, trimesh, lightopt, faulty_bench
    signal.signal(signal.SIGCHLD, _reap)
    gc.freeze()
    has_rendered = False
    while True:
        message, descriptors, _, _ = socket.recv_fds(requests, MOST_BYTES, 4)
        if not message:
            return
        if not has_rendered and "camera" in json.loads(json.loads(message)["spec"]):
            _render_small_scene()
            gc.freeze()
            has_rendered = True
        if os.fork() == 0:
            _watch(json.loads(message), descriptors, requests)
        for descriptor in descriptors:
            os.close(descriptor)


def _reap(*_: object) -> None:
    """Wait for what has ended, so that its processor time counts as that of the tests."""
    try:
        while os.waitpid(-1, os.WNOHANG) != (0, 0):
            pass
    except ChildProcessError:
        pass


def _render_small_scene() -> None:
    from lightopt.rendering import cast_rays_at, render_posture
    from lightopt.scene import build_scene

    scenes = Path(__file__).resolve().parent / "regression" / "golden" / "scenes"
    scene = build_scene(scenes / "rig.yaml", scenes / "knob.yaml")
    render_posture(scene, scene.postures[0], caster=cast_rays_at(scene), threads=1)


def _watch(request: dict, descriptors: list[int], requests: socket.socket) -> None:
    """Fork the bench and tell its process id and, in the end, its exit status; does not return."""
    requests.close()
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    stdin, stdout, stderr, status = descriptors
    pid = os.fork()
    if pid == 0:
        os.close(status)
        _become_bench(request, stdin, stdout, stderr)
    for descriptor in (stdin, stdout, stderr):
        os.close(descriptor)
    os.write(status, b"%d\n" % pid)
    code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    os.write(status, b"%d\n" % code)
    os._exit(0)


def _become_bench(request: dict, stdin: int, stdout: int, stderr: int) -> None:
    import runpy
    import traceback

    os.setsid()
    for number, descriptor in enumerate((stdin, stdout, stderr)):
        os.dup2(descriptor, number)
        os.close(descriptor)
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update(request["environment"])
    sys.argv[:] = ["bench", request["spec"]]
    if request["faulty"]:
        import faulty_bench

        faulty_bench.install()
    code = 0
    try:
        runpy.run_module("lightopt.rig.simulated", run_name="__main__", alter_sys=True)
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 1 if end.code else 0
    except BaseException:  # noqa: BLE001  (as an interpreter does)
        traceback.print_exc()
        code = 1
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


if __name__ == "__main__":
    _serve(socket.socket(fileno=int(sys.argv[1])))
