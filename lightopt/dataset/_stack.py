"""Stacks of a pose as HDF5. The one home of h5py."""

import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.core.errors import InputError
from lightopt.images import write_bytes_atomic


def require_h5py() -> None:
    """Raise an InputError where the package that writes HDF5 is missing."""
    try:
        import h5py  # noqa: F401  # pyright: ignore[reportMissingImports, reportUnusedImport]
    except ImportError:
        raise InputError(
            "option 'stacks': needs the package h5py; install it with: pip install lightopt[hdf5]; or leave the option "
            "out"
        ) from None


def write_stack(path: Path, arrays: Mapping[str, NDArray[Any]], *, lights: Sequence[str], facts: object) -> None:
    """Write the arrays of a pose, whole or not at all, the same input the same bytes.

    arrays: Compressed image by image
    lights: Names of the lights, in the order of the arrays
    facts: JSON-able facts of the samples
    """
    import h5py  # pyright: ignore[reportMissingImports]

    memory = io.BytesIO()
    with h5py.File(memory, "w") as file:
        file.attrs["lights"] = list(lights)
        file.attrs["samples"] = json.dumps(facts)
        for name, values in arrays.items():
            chunk = (*np.ones(values.ndim - 2, np.intp).tolist(), *values.shape[-2:])
            file.create_dataset(
                name, data=values, chunks=chunk, compression="gzip", compression_opts=1, track_times=False
            )
    write_bytes_atomic(path, memory.getvalue())
