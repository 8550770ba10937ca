"""Worker process: tessellate a STEP file into a GLB file within a memory limit.

Run as a script by its path, so that it imports nothing but cascadio:

    python _step_worker.py STEP GLB TOL_LINEAR TOL_ANGULAR RELATIVE FACES MEMORY_BYTES

It stands in a process of its own because the CAD kernel can run for hours, take all memory or crash on a
file, and none of that can be stopped from inside Python.
"""

import sys
from types import ModuleType

EXIT_READ = 3
EXIT_MEMORY = 4


def main(arguments: list[str]) -> int:
    """Tessellate; the exit status is 0, `EXIT_READ` (the kernel refused the file) or `EXIT_MEMORY`."""
    step, glb, linear, angular, relative, faces, memory = arguments
    _limit_memory(int(memory))
    # cascadio's extension of trimesh takes longer to import than many a part to tessellate
    sys.modules["cascadio.extension"] = ModuleType("cascadio.extension")
    try:
        import cascadio

        # one thread, so that the same file gives the same triangles in the same order
        status = cascadio.step_to_glb(
            step,
            glb,
            float(linear),
            float(angular),
            tol_relative=relative == "1",
            merge_primitives=faces == "0",
            use_parallel=False,
        )
    except MemoryError:
        return EXIT_MEMORY
    return EXIT_READ if status else 0


def _limit_memory(limit: int) -> None:
    if sys.platform == "win32":  # Windows has no such limit for a process that limits itself
        return
    import resource

    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
