"""Tables summed from mixed differences: each thread scatters into an array of its own; running sums complete them.

Where a number c fills the box [a, b) × [a', b') × … of a table, the array of its mixed differences has ±c at the box's
corners and 0 elsewhere. So a box costs a few numbers, however many cells it has.
"""

import math
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from queue import Empty, SimpleQueue

import numpy as np

from lightopt.core.arrays import Int64

MOST_DIFFERENCES = 1 << 25  # most numbers in the arrays of all threads: 256 MiB


class Differences:
    """Arrays of mixed differences of `tables` tables over axes of `sizes`, one per thread on demand.

    workers: Threads that memory allows, at least 1.
    strides: Of the axes in a table as one row, shape (axes,).
    """

    def __init__(self, sizes: Sequence[int], threads: int, *, tables: int = 1) -> None:
        self._sizes = tuple(sizes)
        self._shape = tables, math.prod(sizes)
        self.workers = max(1, min(threads, MOST_DIFFERENCES // math.prod(self._shape)))
        self.strides: Int64 = np.array([math.prod(sizes[i + 1 :]) for i in range(len(sizes))], np.int64)
        self._free: SimpleQueue[Int64] = SimpleQueue()
        self._made: list[Int64] = []

    @contextmanager
    def borrowed(self) -> Generator[Int64, None, None]:
        """An array for differences that no other thread uses, shape (tables, cells)."""
        try:
            array = self._free.get_nowait()
        except Empty:
            array = np.zeros(self._shape, np.int64)
            self._made.append(array)
        yield array
        self._free.put(array)

    def summed(self) -> Int64:
        """The tables, shape (tables, cells), the last axis varying fastest; the arrays are consumed."""
        total = self._made[0] if self._made else np.zeros(self._shape, np.int64)
        for array in self._made[1:]:
            total += array
        for size, stride in zip(self._sizes, self.strides, strict=True):
            if size > 1:
                along = total.reshape(-1, size, int(stride))
                np.cumsum(along, axis=1, out=along)
        return total
