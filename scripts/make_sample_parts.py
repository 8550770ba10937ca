"""Make the two sample parts, as STEP (exact surfaces) and as STL (facets), in mm, +Z up, standing on Z = 0.

    python -m pip install ".[parts]"
    python scripts/make_sample_parts.py [FOLDER]          # default: configs/parts

`cover-knob` is a plated cover of 52 x 46 x 18 mm whose visible surface is four doubly curved faces of
different radii that meet at soft ridges. `spout` is 50 x 43 x 34 mm, a bowl that opens into a mouth, with a
handle over it that throws its shadow into the bowl. Existing files of these names are replaced. The same
version of the CAD kernel writes the same bytes every time: header and product name are ours, and coordinates
are rounded.
"""

from __future__ import annotations

import argparse
import math
import re
import struct
import tempfile
from pathlib import Path

import cadquery as cq
from cadquery import Vector

HERE = Path(__file__).resolve().parent
STEP_HEADER = """HEADER;
FILE_DESCRIPTION(('lightopt sample part'),'2;1');
FILE_NAME('{name}','2000-01-01T00:00:00',(''),(''),'make_sample_parts.py','cadquery','');
FILE_SCHEMA(('AUTOMOTIVE_DESIGN {{ 1 0 10303 214 1 1 1 1 }}'));
ENDSEC;
"""
STEP_DECIMALS = 7  # of coordinates [mm]: the kernel's own tolerance is 1e-7 mm


# ---------- building blocks
def barrel(*, top: Vector, normal: Vector, axis: Vector, along: float, around: float, half: float) -> cq.Workplane:
    """Solid of revolution whose surface passes through `top` with outward `normal`.

    Its radius of curvature there is `along` [mm] in the direction of `axis` (its axis of revolution, at right
    angles to the normal) and `around` [mm] across it; it extends `half` [mm] along the axis to both sides.
    """
    end = around - along + math.sqrt(along**2 - half**2)
    plane = cq.Plane(origin=(top - normal * around).toTuple(), xDir=axis.toTuple(), normal=axis.cross(normal).toTuple())
    # The profile lies on the side away from the normal: the seam of the surface of revolution, which the
    # kernel's fillets cannot cross, then stays out of the part.
    profile = cq.Workplane(plane).moveTo(-half, 0)
    if end > 1e-9:
        profile = profile.lineTo(-half, -end).threePointArc((0, -around), (half, -end)).lineTo(half, 0)
    else:
        profile = profile.threePointArc((0, -around), (half, 0))
    return profile.close().revolve(360, (0, 0), (1, 0))


def leaning(*, azimuth_deg: float, tilt_deg: float) -> tuple[Vector, Vector]:
    """Unit normal that leans from +Z towards an azimuth, and the unit tangent that points downhill."""
    a, t = math.radians(azimuth_deg), math.radians(tilt_deg)
    normal = Vector(math.sin(t) * math.cos(a), math.sin(t) * math.sin(a), math.cos(t))
    downhill = Vector(math.cos(t) * math.cos(a), math.cos(t) * math.sin(a), -math.sin(t))
    return normal, downhill


def edges_between(solid: cq.Solid, *pairs: tuple[str, str]) -> list[cq.Edge]:
    """Edges above the underside whose two faces are of the given kinds (geomType, in any order)."""
    wanted = [sorted(pair) for pair in pairs]
    faces = [(face.geomType(), face.Edges()) for face in solid.Faces()]

    def kinds(edge: cq.Edge) -> list[str]:
        return sorted(kind for kind, edges in faces if any(edge.isSame(other) for other in edges))

    return [edge for edge in solid.Edges() if edge.Center().z > 1 and kinds(edge) in wanted]


def only_solid(shape: cq.Workplane | cq.Shape) -> cq.Solid:
    """Return the one valid solid that a shape must consist of."""
    found = (shape.val() if isinstance(shape, cq.Workplane) else shape).Solids()
    if len(found) != 1 or not found[0].isValid():
        raise RuntimeError(f"expected one valid solid, found {len(found)}: change the dimensions")
    return found[0]


# ---------- the two parts
def cover_knob() -> cq.Solid:
    """Elliptical body with draft, cut by four barrels; ridges rounded with 8 mm, the rim with 3 mm.

    The ridges fold the surface by 5 to 20 degrees only, so that a radius of 8 mm makes them 1 to 3 mm wide.
    """
    body = cq.Workplane().ellipse(26.0, 23.0).workplane(offset=30).ellipse(24.6, 21.6).loft(ruled=True)
    for azimuth, tilt, along, around in (
        (46, 22.0, 40, 47),
        (135, 23.5, 37, 43),
        (224, 21.0, 43, 52),
        (316, 24.0, 36, 42),
    ):
        normal, downhill = leaning(azimuth_deg=azimuth, tilt_deg=tilt)
        a = math.radians(azimuth)
        top = Vector(12.43 * math.cos(a), 11.0 * math.sin(a), 15.8)
        half = along * math.sin(math.radians(75))
        body = body.intersect(barrel(top=top, normal=normal, axis=downhill, along=along, around=around, half=half))
    solid = only_solid(body)
    solid = solid.fillet(8.0, edges_between(solid, ("REVOLUTION", "REVOLUTION")))
    wall = max((face for face in solid.Faces() if face.geomType() == "BSPLINE"), key=lambda face: face.Area())
    rim = [e for e in wall.Edges() if e.startPoint().z > 1 and e.endPoint().z > 1]
    return only_solid(solid.fillet(3.0, rim))


def spout_outline() -> cq.Workplane:
    """Plan of the spout: a round back of radius 21.5 mm, concave flanks, a mouth of 29 mm at X = 25."""
    radius, centre_x, mouth_x, mouth_y = 21.5, -3.5, 25.0, 14.5
    ux, uy = math.cos(math.radians(62)), math.sin(math.radians(62))
    x, y = centre_x + radius * ux, radius * uy  # where back and flank touch, with one tangent
    dx, dy = x - mouth_x, y - mouth_y
    flank = -(dx * dx + dy * dy) / (2 * (dx * ux + dy * uy))
    cx, cy = x + flank * ux, y + flank * uy
    half_way = Vector(x + mouth_x - 2 * cx, y + mouth_y - 2 * cy, 0).normalized() * flank
    mx, my = cx + half_way.x, cy + half_way.y
    return (
        cq.Workplane()
        .moveTo(mouth_x, -mouth_y)
        .lineTo(mouth_x, mouth_y)
        .threePointArc((mx, my), (x, y))
        .threePointArc((centre_x - radius, 0), (x, -y))
        .threePointArc((mx, -my), (mouth_x, -mouth_y))
        .close()
    )


def spout() -> cq.Solid:
    """Domed body with a boat-shaped bowl cut into it, edges rounded with 1.5 mm, a leaning ring as handle."""
    normal, forward = leaning(azimuth_deg=0, tilt_deg=4)
    crown = barrel(top=Vector(0, 0, 20.5), normal=normal, axis=forward, along=75, around=38, half=64.95)
    down, forward = (Vector(0, 0, 0) - leaning(azimuth_deg=0, tilt_deg=12)[0], leaning(azimuth_deg=0, tilt_deg=12)[1])
    length = math.sqrt(55.0**2 - (55.0 - 11.5) ** 2)  # the bowl's barrel closes to a point at both ends
    bowl = barrel(top=Vector(14, 0, 7.5), normal=down, axis=forward, along=55, around=11.5, half=length)
    prism = spout_outline().extrude(40).edges("|Z and >X").fillet(2.0)
    solid = only_solid(prism.intersect(crown).cut(bowl))
    sharp = edges_between(solid, ("CYLINDER", "REVOLUTION"), ("REVOLUTION", "REVOLUTION"), ("PLANE", "REVOLUTION"))
    solid = solid.fillet(1.5, sharp)

    lean = math.radians(18)
    ring = cq.Solid.makeTorus(15, 3.5, Vector(-4, 0, 16.5), Vector(math.cos(lean), 0, -math.sin(lean)))
    ring = ring.intersect(cq.Solid.makeBox(60, 60, 40, Vector(-30, -30, 10)))
    solid = only_solid(solid.fuse(ring).clean())
    return only_solid(solid.fillet(1.5, edges_between(solid, ("TORUS", "REVOLUTION"))))


# ---------- the files
def step_text(solid: cq.Solid, name: str) -> str:
    """STEP AP214 text of a solid, in mm, without time stamps and session counters."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "part.step"
        solid.exportStep(str(path), write_pcurves=False)
        text = path.read_text(encoding="ascii")
    text = re.sub(r"\n +", "", text)  # one entity per line
    text = re.sub(r"(?m)^(#\d+) = ", r"\1=", text)
    text = re.sub(r"HEADER;.*?ENDSEC;\n", STEP_HEADER.format(name=name), text, count=1, flags=re.DOTALL)
    text = re.sub(r"=PRODUCT\('[^']*','[^']*'", f"=PRODUCT('{name}','{name}'", text)

    def rounded(number: re.Match[str]) -> str:
        shown = f"{float(number[0]):.{STEP_DECIMALS}f}".rstrip("0")
        return "0." if shown == "-0." else shown

    def point(line: re.Match[str]) -> str:
        return re.sub(r"-?\d+\.\d*(?:E[-+]?\d+)?", rounded, line[0])

    return re.sub(r"(?m)^#\d+=CARTESIAN_POINT.*$", point, text)


def stl_bytes(solid: cq.Solid, name: str, *, tolerance: float, angular_tolerance: float) -> bytes:
    """Binary STL of a solid, in mm, with the given chord tolerance [mm] and angular tolerance [rad]."""
    corners, triangles = solid.tessellate(tolerance, angular_tolerance)
    points = [struct.unpack("<3f", struct.pack("<3f", *corner.toTuple())) for corner in corners]
    facets: list[bytes] = []
    for a, b, c in triangles:
        pa, pb, pc = points[a], points[b], points[c]
        if len({pa, pb, pc}) < 3:
            continue  # a triangle whose corners coincide in single precision
        normal = (Vector(*pb) - Vector(*pa)).cross(Vector(*pc) - Vector(*pa))
        unit = normal.normalized() if normal.Length > 0 else normal
        facets.append(struct.pack("<12fH", *unit.toTuple(), *pa, *pb, *pc, 0))
    header = f"lightopt sample part {name}, mm".encode("ascii").ljust(80)
    return header + struct.pack("<I", len(facets)) + b"".join(facets)


def main() -> None:
    parser = argparse.ArgumentParser(description="Make the sample parts (STEP and STL).")
    parser.add_argument("folder", nargs="?", type=Path, default=HERE.parent / "configs" / "parts")
    folder: Path = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    parts = {"cover-knob": (cover_knob(), 0.02, 0.2), "spout": (spout(), 0.06, 0.45)}
    for name, (solid, tolerance, angular) in parts.items():
        # STEP before STL: the kernel stores the tessellation in the shape.
        files = {
            "step": step_text(solid, name).encode("ascii"),
            "stl": stl_bytes(solid, name, tolerance=tolerance, angular_tolerance=angular),
        }
        for suffix, data in files.items():
            path = folder / f"{name}.{suffix}"
            path.write_bytes(data)
            print(f"{path}: {len(data) / 1000:.0f} kB")


if __name__ == "__main__":
    main()
