"""Tables that are added up as differences: each thread scatters into an array of its own, and running sums end it.

Where a number c fills the box [a, b) × [a', b') × … of a table, the array of its mixed differences has ±c at the box's
corners and 0 elsewhere. So whatever fills boxes costs a few numbers, however many cells the table has.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from queue import Empty, SimpleQueue

import numpy as np
from numpy.typing import NDArray

Int64 = NDArray[np.int64]

MOST_DIFFERENCES = 1 << 25
"""Most numbers in the arrays of all threads: 256 MiB."""


class Differences:
    """Arrays of mixed differences of tables over the same axes, made as threads ask for them.

    Parameters
    ----------
    sizes
        Of the tables' axes.
    threads
        That may ask at the same time, as far as memory allows.
    tables
        How many tables each array is of.

    Attributes
    ----------
    workers
        Threads that memory allows, at least 1.
    strides
        Of the axes in a table as one row, shape (axes,).
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
        """An array to add differences to that no other thread has, shape (tables, cells)."""
        try:
            array = self._free.get_nowait()
        except Empty:
            array = np.zeros(self._shape, np.int64)
            self._made.append(array)
        yield array
        self._free.put(array)

    def summed(self) -> Int64:
        """The tables, shape (tables, cells), the last axis varying fastest; the arrays are used up."""
        total = self._made[0] if self._made else np.zeros(self._shape, np.int64)
        for array in self._made[1:]:
            total += array
        for size, stride in zip(self._sizes, self.strides, strict=True):
            if size > 1:
                along = total.reshape(-1, size, int(stride))
                np.cumsum(along, axis=1, out=along)
        return total
