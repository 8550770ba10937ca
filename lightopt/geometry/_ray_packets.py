"""Embree's own functions, of the library that the embreex wheel brings, called by kernels; rays in packets.

embreex asks Embree for one ray after another. Shadow rays to one target, and camera rays of neighbouring pixels, take
much the same way through the hierarchy, and Embree takes as many of them at once as the processor has lanes. The
answers are the same: Embree computes each ray's with the same arithmetic. Of triangles that are met at exactly the same
distance, however, it takes any; where that may be, a ray is cast alone.
"""

import ctypes
import os
import threading
from functools import cache
from pathlib import Path
from typing import Any

import embreex
import numpy as np
from embreex import rtcore_scene  # noqa: F401  # pyright: ignore[reportUnusedImport]  # loads the library
from numpy.typing import NDArray

from lightopt.core.arrays import Bool, Float32, Float64, Int32
from lightopt.core.kernels import call_address, kernel

_POINTER, _INT, _UNSIGNED, _SIZE = ctypes.c_void_p, ctypes.c_int, ctypes.c_uint, ctypes.c_size_t
_OF_ONE, _SETTING = (None, [_POINTER]), (None, [_POINTER, _INT])
_FUNCTIONS: dict[str, tuple[Any, list[Any]]] = {
    "rtcNewDevice": (_POINTER, [ctypes.c_char_p]),
    "rtcGetDeviceError": (_INT, [_POINTER]),
    "rtcGetDeviceProperty": (ctypes.c_ssize_t, [_POINTER, _INT]),
    "rtcNewScene": (_POINTER, [_POINTER]),
    "rtcNewGeometry": (_POINTER, [_POINTER, _INT]),
    **dict.fromkeys(("rtcCommitScene", "rtcCommitGeometry", "rtcReleaseScene", "rtcReleaseGeometry"), _OF_ONE),
    **dict.fromkeys(("rtcSetSceneFlags", "rtcSetSceneBuildQuality", "rtcSetGeometryBuildQuality"), _SETTING),
    "rtcAttachGeometry": (_UNSIGNED, [_POINTER, _POINTER]),
    "rtcSetSharedGeometryBuffer": (None, [_POINTER, _INT, _UNSIGNED, _INT, _POINTER, _SIZE, _SIZE, _SIZE]),
}

_MAJOR = 4  # version of Embree whose functions these are

# numbers of its headers
_TRIANGLES = 0
_INDEX, _VERTEX = 0, 1
_UINT3, _FLOAT3 = 0x5003, 0x9003
_ROBUST = 4
_LOW, _MEDIUM = 0, 1
_COHERENT, _INCOHERENT = 1 << 16, 0
_ALL_FEATURES = 0xFFFFFFFF
_VERSION_MAJOR = 1
# rays of a packet, and the property of a device that says whether the processor has so many lanes
_NATIVE_WIDTHS = ((16, 34), (8, 33), (4, 32))

# a packet is rows of one number of each ray: origin, nearest distance, direction, time, furthest distance, mask,
# number, flags; then, of what it hits, normal, coordinates, triangle, geometry, instances
_ROWS = 36
_FURTHEST, _MASK, _U, _V, _TRIANGLE, _GEOMETRY = 8, 9, 15, 16, 17, 18
_ALIGNMENT = 64

# barycentric coordinate below which a ray may meet an edge exactly, and the triangle beyond it as well
EDGE_SHARE = np.float32(1e-6)


@kernel
def _aligned(count: int) -> Float32:
    # so many zeros, aligned as packets have to be
    raw = np.zeros(count + _ALIGNMENT // 4, np.float32)
    begin = (-raw.ctypes.data % _ALIGNMENT) // 4
    return raw[begin : begin + count]


@kernel
def _packet(width: int) -> tuple[Float32, Int32]:
    # rows of a packet, and which of its rays are valid
    ray = _aligned(_ROWS * width)
    ray.view(np.int32)[_MASK * width : (_MASK + 1) * width] = -1
    return ray, _aligned(width).view(np.int32)


@kernel
def _load(ray: Float32, valid: Int32, first: int, origins: Float32, directions: Float32, furthest: float) -> None:
    # the rays from number `first` on into a packet; places beyond the last ray are not valid
    width, n = len(valid), len(origins)
    for j in range(width):
        i = min(first + j, n - 1)
        valid[j] = -1 if first + j < n else 0
        for axis in range(3):
            ray[axis * width + j] = origins[i, axis]
            ray[(4 + axis) * width + j] = directions[i, axis]
        ray[_FURTHEST * width + j] = furthest


@kernel
def _blocked(function: int, scene: int, arguments: int, width: int, origins: Float32, directions: Float32) -> Int32:
    # 0 where anything lies within the length of a direction, −1 where nothing does
    n = len(origins)
    found = np.empty(n, np.int32)
    ray, valid = _packet(width)
    for first in range(0, n, width):
        _load(ray, valid, first, origins, directions, 1.0)
        call_address(function, valid.ctypes.data, scene, ray.ctypes.data, arguments)
        for j in range(min(width, n - first)):
            # Embree's sign for a ray that is blocked
            found[first + j] = 0 if ray[_FURTHEST * width + j] < 0.0 else -1
    return found


@kernel
def _blocked_ways(
    function: int, scene: int, arguments: int, width: int, begins: Float64, target: Float64, cast: Bool, found: Bool
) -> None:
    # the same for the rays from some points to one target, of which those to cast fill packets in their order
    ray, valid = _packet(width)
    index = np.empty(width, np.int64)
    x, y, z = target
    n, lanes = len(cast), 0
    for i in range(n + 1):
        if i < n and cast[i]:
            bx, by, bz = begins[0, i], begins[1, i], begins[2, i]
            ray[lanes], ray[width + lanes], ray[2 * width + lanes] = bx, by, bz
            ray[4 * width + lanes], ray[5 * width + lanes], ray[6 * width + lanes] = x - bx, y - by, z - bz
            ray[_FURTHEST * width + lanes] = 1.0
            valid[lanes] = -1
            index[lanes] = i
            lanes += 1
        if lanes == width or (i == n and lanes > 0):
            valid[lanes:] = 0
            call_address(function, valid.ctypes.data, scene, ray.ctypes.data, arguments)
            for j in range(lanes):
                found[index[j]] = ray[_FURTHEST * width + j] < 0.0
            lanes = 0


@kernel
def _nearest(function: int, scene: int, arguments: int, ray: Float32, origin: Float32, direction: Float32) -> int:
    # the triangle that a ray meets first, −1 where none
    number = ray.view(np.int32)
    for axis in range(3):
        ray[axis] = origin[axis]
        ray[4 + axis] = direction[axis]
    ray[_FURTHEST] = np.inf
    number[_GEOMETRY] = -1
    # a function of three pointers; the fourth is not looked at
    call_address(function, scene, ray.ctypes.data, arguments, arguments)
    return number[_TRIANGLE] if number[_GEOMETRY] != -1 else -1


@kernel
def _nearest_of_each(function: int, scene: int, arguments: int, origins: Float32, directions: Float32) -> Int32:
    found = np.empty(len(origins), np.int32)
    ray, _ = _packet(1)
    for i in range(len(origins)):
        found[i] = _nearest(function, scene, arguments, ray, origins[i], directions[i])
    return found


@kernel
def _nearest_in_packets(
    functions: tuple[int, int, int, int], width: int, origins: Float32, directions: Float32, doubtful: Bool
) -> Int32:
    (packet, single, scene, arguments), n = functions, len(origins)
    found = np.empty(n, np.int32)
    (ray, valid), (alone, _) = _packet(width), _packet(1)
    number = ray.view(np.int32)
    for first in range(0, n, width):
        _load(ray, valid, first, origins, directions, np.inf)
        number[_GEOMETRY * width : (_GEOMETRY + 1) * width] = -1
        call_address(packet, valid.ctypes.data, scene, ray.ctypes.data, arguments)
        for j in range(min(width, n - first)):
            i = first + j
            found[i] = -1
            if number[_GEOMETRY * width + j] != -1:
                found[i] = number[_TRIANGLE * width + j]
                u, v = ray[_U * width + j], ray[_V * width + j]
                if min(u, v, np.float32(1.0) - u - v) <= EDGE_SHARE or doubtful[found[i]]:
                    found[i] = _nearest(single, scene, arguments, alone, origins[i], directions[i])
    return found


class PacketScene:
    """A hierarchy over triangles, queried by Embree's own functions; with `few_rays` built quicker, queried slower."""

    def __init__(self, vertices: Float32, faces: Int32, *, few_rays: bool = False) -> None:
        library, device, width = _embree(os.getpid())
        self._library, self._width = library, width
        self._single = _address(library.rtcIntersect1)
        self._packet = _address(getattr(library, f"rtcIntersect{width}"))
        self._shadow_packet = _address(getattr(library, f"rtcOccluded{width}"))
        # Embree reads these arrays as long as the scene is there, and 16 bytes at each vertex
        self._vertices = np.zeros(3 * len(vertices) + 4, np.float32)
        self._vertices[:-4] = vertices.ravel()
        self._faces = np.ascontiguousarray(faces, np.int32)
        self._arguments = [_query_arguments(flags) for flags in (_COHERENT, _INCOHERENT)]
        self._argument_address, self._scattered_address = (some.ctypes.data for some in self._arguments)
        geometry = library.rtcNewGeometry(device, _TRIANGLES)
        self._share(geometry, _VERTEX, _FLOAT3, self._vertices, len(vertices))
        self._share(geometry, _INDEX, _UINT3, self._faces, len(faces))
        quality = _LOW if few_rays else _MEDIUM
        library.rtcSetGeometryBuildQuality(geometry, quality)
        library.rtcCommitGeometry(geometry)
        self._scene: int = library.rtcNewScene(device)
        library.rtcSetSceneBuildQuality(self._scene, quality)
        library.rtcSetSceneFlags(self._scene, _ROBUST)
        library.rtcAttachGeometry(self._scene, geometry)
        library.rtcReleaseGeometry(geometry)
        library.rtcCommitScene(self._scene)
        if error := library.rtcGetDeviceError(device):
            raise MemoryError(f"Embree's error {error} while it built a hierarchy over {len(faces):,} triangles")

    def _share(self, geometry: int, kind: int, form: int, data: NDArray[Any], count: int) -> None:
        self._library.rtcSetSharedGeometryBuffer(geometry, kind, 0, form, data.ctypes.data, 0, 12, count)

    def __del__(self) -> None:
        if scene := getattr(self, "_scene", None):
            self._library.rtcReleaseScene(scene)

    def first_hit(
        self, origins: Float32, directions: Float32, *, doubtful: Bool | None = None, scattered: bool = False
    ) -> Int32:
        """Index of the first triangle that each ray meets, −1 where none; shape (k,).

        doubtful: Triangles that may be met at exactly the same distance as another one that does not share an edge
            with them, shape (m,): then packets are cast; None casts the rays one by one
        scattered: Whether rays of a packet go rather different ways, for which Embree has another way through
        """
        arguments = self._scattered_address if scattered else self._argument_address
        if doubtful is None:
            return _nearest_of_each(self._single, self._scene, arguments, origins, directions)
        functions = self._packet, self._single, self._scene, arguments
        return _nearest_in_packets(functions, self._width, origins, directions, doubtful)

    def occluded(self, origins: Float32, directions: Float32) -> Int32:
        """0 where anything lies within the length of a direction, −1 where nothing does; shape (k,)."""
        return _blocked(self._shadow_packet, self._scene, self._scattered_address, self._width, origins, directions)

    def blocked(self, begins: Float64, targets: Float64, cast: Bool, *, scattered: bool) -> Bool:
        """Whether anything lies on the ways from points (t, 3, n) to targets (t, 3), of those to `cast`; (t, n)."""
        arguments = self._scattered_address if scattered else self._argument_address
        found = np.zeros(cast.shape, np.bool_)
        for own, target, some, answer in zip(begins, targets, cast, found, strict=True):
            _blocked_ways(self._shadow_packet, self._scene, arguments, self._width, own, target, some, answer)
        return found


def _query_arguments(flags: int) -> NDArray[np.uint32]:
    arguments: NDArray[np.uint32] = _aligned(_ALIGNMENT // 4).view(np.uint32)
    arguments[:2] = flags, _ALL_FEATURES
    return arguments


def _address(function: Any) -> int:
    address = ctypes.cast(function, ctypes.c_void_p).value
    assert address is not None
    return address


def packet_scene(vertices: Float32, faces: Int32, *, few_rays: bool = False) -> PacketScene | None:
    """A hierarchy that is queried with packets; None where this Embree or processor takes none."""
    return PacketScene(vertices, faces, few_rays=few_rays) if _works(os.getpid()) else None


@cache
def _works(_process: int) -> bool:
    """Whether the library is the expected one: one triangle, one ray through it, one beside it, twice."""
    triangle = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    origins = np.array([[0.2, 0.2, 0.5], [0.8, 0.8, 0.5]], np.float32)
    down = np.array([[0, 0, -1], [0, 0, -1]], np.float32)
    try:
        scene = PacketScene(triangle, np.array([[0, 1, 2]], np.int32))
        nearest = [scene.first_hit(origins, down, doubtful=some) for some in (None, np.zeros(1, np.bool_))]
        answers = [answer.tolist() for answer in (*nearest, scene.occluded(origins, down))]
    except (OSError, AttributeError, NotImplementedError):  # no function of that name; numba compiles nothing
        return False
    return answers == [[0, -1]] * 3


_LOADING = threading.Lock()


@cache
def _embree(_process: int) -> tuple[Any, int, int]:
    # library, device and rays of a packet; of each process its own, since threads of a device do not survive a fork
    with _LOADING:
        library = ctypes.CDLL(str(_library_path()))
        for name, (result, arguments) in _FUNCTIONS.items():
            function = getattr(library, name)
            function.restype, function.argtypes = result, arguments
        device = library.rtcNewDevice(None)
        if not device:
            raise OSError(f"Embree makes no device: error {library.rtcGetDeviceError(None)}")
        major = library.rtcGetDeviceProperty(device, _VERSION_MAJOR)
        if major != _MAJOR:
            raise OSError(f"Embree {major}, expected {_MAJOR}")
        widths = [width for width, native in _NATIVE_WIDTHS if library.rtcGetDeviceProperty(device, native)]
        if not widths:
            raise OSError("Embree takes no packets on this processor")
        return library, device, widths[0]


def _library_path() -> Path:
    package = Path(embreex.__file__).parent
    places = (
        (package.parent / "embreex.libs", "libembree4*.so*"),
        (package.parent / "embreex.libs", "embree4*.dll"),
        (package / ".dylibs", "libembree4*.dylib"),
    )
    found = [path for folder, pattern in places for path in sorted(folder.glob(pattern))]
    if not found:
        raise OSError(f"no Embree library beside {package}")
    return found[0]
