"""Where rays meet triangles: geometry only, knows no light. The one home of embreex.

Rays go in and come out in float64 in the frame of the mesh; centring, scaling to Embree's float32, the offset that
keeps a ray from hitting the surface it starts on, and the exact solution on the triangle's plane live here.
"""

from lightopt.raycast._caster import RayCaster
from lightopt.raycast._hits import Hits, resolve_hits

__all__ = ["Hits", "RayCaster", "resolve_hits"]
