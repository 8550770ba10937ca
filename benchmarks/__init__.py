"""How fast and how exact lightopt is, as ratios measured in one run: ``python -m benchmarks.run [NAMES] [--quick]``.

``bare``
    lightopt against the ray caster it stands on: one BVH and a replay of the very same rays, nothing else.
``peers``
    The same scene in Open3D, Mitsuba 3 and trimesh (``make bench`` installs them), pictures compared before times.
``auto``
    ``points: auto`` against m = 4, and against 64 × 64 points.
``command``
    The whole command line: seconds, peak memory, and how long ``--help`` takes.
``growth``
    How the time of images and of the hierarchy grows with triangles, pixels, lights and points.
``search``
    Exact searches over light combinations against a plain NumPy loop, and the luminance matrix against its bare rays.
``plan``
    A hundred candidate postures planned with the lights, and tolerances: seconds, memory, and how near to the bound.

Ratios are given twice: of the least times, and the median of the ratios of the rounds. In a round everything that is
compared runs once, one after the other, so that a busy machine slows down both sides alike.
"""
