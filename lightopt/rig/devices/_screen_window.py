"""A full-screen window on a monitor that shows pictures: ``python _screen_window.py MONITOR WIDTH HEIGHT``.

A program of its own, without lightopt: a window belongs to one thread, which has to answer the desktop all the time. It
prints one line of JSON: the number of the ``port`` on which it takes pictures from one client (``_light_display.py``),
or the ``problem``. It shows black at first, and ends with its client, also if that is killed.
"""

import importlib
import json
import os
import select
import socket
import sys
import zlib

_TICK_S = 0.02
_CLIENT_S = 30.0  # longest wait for the client
_BYTES = 1 << 20
_NO_SCREENS = ("dummy", "offscreen")  # what the library falls back on


class _Window:
    def __init__(self, monitor: int, size: tuple[int, int]) -> None:
        os.environ |= {
            "PYGAME_HIDE_SUPPORT_PROMPT": "1",
            "SDL_VIDEO_MINIMIZE_ON_FOCUS_LOSS": "0",
            "SDL_WINDOWS_DPI_AWARENESS": "permonitorv2",  # no scaling
        }
        pygame = importlib.import_module("pygame")
        try:
            pygame.display.init()
        except pygame.error as error:
            raise ValueError(f"no desktop can be reached ({error}); run this in a session with a desktop") from None
        if pygame.display.get_driver() in _NO_SCREENS:
            raise ValueError("no desktop can be reached; run this in a session with a desktop")
        self._pygame = pygame
        self._monitor, self._size = monitor, size
        sizes = pygame.display.get_desktop_sizes()
        if monitor > len(sizes):
            there = ", ".join(f"{i} ({w} × {h})" for i, (w, h) in enumerate(sizes, 1))
            raise ValueError(f"no monitor {monitor}; there is {there}")
        if tuple(sizes[monitor - 1]) != size:
            width, height = sizes[monitor - 1]
            found = f"monitor {monitor} has {width} × {height} pixels, and resolution_px is {size[0]} × {size[1]}"
            raise ValueError(f"{found}; set the monitor to that, without scaling, or correct resolution_px")
        self._surface = pygame.display.set_mode(size, pygame.FULLSCREEN, display=monitor - 1)
        if tuple(self._surface.get_size()) != size:
            raise ValueError(f"the window has {self._surface.get_size()} pixels in place of {size}")
        pygame.mouse.set_visible(False)
        self.show(bytes(size[0] * size[1]))

    def show(self, levels: bytes) -> None:
        pygame = self._pygame
        if len(pygame.display.get_desktop_sizes()) < self._monitor:
            raise ValueError(f"monitor {self._monitor} is gone")
        if len(levels) != self._size[0] * self._size[1]:
            raise ValueError(f"expected {self._size[0]} x {self._size[1]} levels, found {len(levels)}")
        picture = pygame.image.frombuffer(levels, self._size, "P")
        picture.set_palette([(level, level, level) for level in range(256)])
        self._surface.blit(picture, (0, 0))
        pygame.display.flip()

    def answer_desktop(self) -> None:
        self._pygame.event.get()  # also requests to close it

    def close(self) -> None:
        self.show(bytes(self._size[0] * self._size[1]))
        self._pygame.quit()


def _serve(window: _Window) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        print(json.dumps({"port": listener.getsockname()[1]}), flush=True)  # noqa: T201
        listener.settimeout(_CLIENT_S)
        client, _ = listener.accept()
    received = b""
    with client:
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        while True:
            window.answer_desktop()
            if not select.select([client], [], [], _TICK_S)[0]:
                continue
            try:
                data = client.recv(_BYTES)
            except OSError:
                return
            if not data:
                return
            received += data
            head, end, rest = received.partition(b"\r\n")
            size = int(head.split()[3]) if end else 0
            if end and len(rest) >= size:
                received = rest[size:]
                try:
                    window.show(zlib.decompress(rest[:size]))
                except (ValueError, zlib.error) as error:
                    client.sendall(f"NG {error}\r\n".encode("ascii", "replace"))
                else:
                    client.sendall(b"OK\r\n")


def _main() -> None:
    try:
        monitor, width, height = map(int, sys.argv[1:])
        window = _Window(monitor, (width, height))
    except (ValueError, ImportError) as error:
        print(json.dumps({"problem": str(error)}))  # noqa: T201
        return
    try:
        _serve(window)
    finally:
        window.close()


if __name__ == "__main__":
    _main()
