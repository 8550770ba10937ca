"""The process of a peer, ``python -m benchmarks._peer_server NAME SIZE PART``.

It reads ``build`` and ``images`` from standard input, one a line, does it, and answers each with the seconds that it
took; ``save PATH`` writes the images.
"""

from __future__ import annotations

import gc
import json
import os
import sys
import time

import numpy as np

from benchmarks._case import FULL, QUICK, SCENES, TOY, Size
from benchmarks.peers import PEERS, Float32


def _serve(name: str, size: Size, part: str) -> None:
    # libraries may print: what they print to standard output must not be taken for an answer
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)

    def answer(found: object) -> None:
        answers.write(json.dumps(found) + "\n")
        answers.flush()

    peer = PEERS[name](SCENES[part](size))
    built: object = None
    images: list[Float32] = []
    answer("ready")
    for line in sys.stdin:
        what, _, path = line.rstrip("\n").partition(" ")
        gc.collect()
        begun = time.perf_counter()
        if what == "build":
            built = peer.build()
        elif what == "images":
            images = peer.images(built)
        else:
            np.save(path, np.stack(images))
        answer(time.perf_counter() - begun)


if __name__ == "__main__":
    _serve(sys.argv[1], {size.name: size for size in (FULL, QUICK, TOY)}[sys.argv[2]], sys.argv[3])
