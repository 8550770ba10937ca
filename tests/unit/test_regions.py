"""Regions of a part: found on the mesh, cut along their borders, and reflecting in their own way."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from mesh_surface import surface_of

from lightopt import build_scene, load_part, load_rig
from lightopt.config import copied_text, input_hashes
from lightopt.core.errors import InputError
from lightopt.estimate.reflectance._result import FitResult, FittedValue, RegionFit, _part_text
from lightopt.geometry import (
    BoxRegion,
    ColouredRegion,
    MaskRegion,
    NamedRegion,
    RegionAtPoints,
    SurfaceFinder,
    TriangleMesh,
    box_mesh,
    face_areas,
    load_mesh,
    mesh_with_regions,
    sphere_mesh,
)
from lightopt.geometry._load_mesh import LoadedMesh
from lightopt.images import write_png
from lightopt.optics import Reflectance, SpecularModel
from lightopt.preflight import check_scene
from lightopt.rendering import (
    cast_rays_at,
    panel_to_shade,
    render_posture,
    shade_isolated,
    shade_variants,
    surface_variants,
    trace_pixels,
)
from lightopt.scene import scene_of_region
from lightopt.scene._scene import PartRegion

ROOT = Path(__file__).resolve().parents[2]
KNOB = ROOT / "configs" / "parts" / "cover-knob.step"
RED, GREEN = (255, 0, 0, 255), (0, 128, 0, 255)


def load(path: Path, unit: float | None = 1.0) -> LoadedMesh:
    return load_mesh(path, unit_mm=unit, normals="smooth", crease_angle=0.5, pieces=True)


def found(loaded: LoadedMesh, *regions, most: int = 10**6) -> TriangleMesh:
    return mesh_with_regions(loaded, regions, most=most, place=str)


def areas(mesh: TriangleMesh) -> list[float]:
    assert mesh.material is not None
    return np.bincount(mesh.material, face_areas(mesh)).tolist()


def two_boxes() -> tuple[trimesh.Trimesh, trimesh.Trimesh]:
    first, second = trimesh.creation.box(extents=(1, 1, 1)), trimesh.creation.box(extents=(2, 2, 2))
    second.apply_translation((5, 0, 0))
    return first, second


OBJ = """\
o cover
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
f 1 2 3
usemtl paint
f 1 3 4
g label
usemtl chrome
f 1 2 4
o other
f 2 3 4
"""


@pytest.mark.parametrize(("name", "count"), [("cover", 3), ("other", 1), ("paint", 1), ("chrome", 2), ("label", 2)])
def test_objects_groups_and_materials_of_obj_files(tmp_path, name, count):
    path = tmp_path / "part.obj"
    path.write_text(OBJ)
    assert int(NamedRegion(name).faces(load(path)).sum()) == count


def test_nodes_and_colours_of_glb_files(tmp_path):
    """A material's linear 0.2159 is 128 of 255 as programs show it."""
    scene = trimesh.Scene()
    for name, box, colour in zip(("small", "large"), two_boxes(), (RED, GREEN), strict=True):
        linear = [((c / 255 + 0.055) / 1.055) ** 2.4 if c > 10 else c / 255 / 12.92 for c in colour[:3]]
        material = trimesh.visual.material.PBRMaterial(name=f"paint-{name}", baseColorFactor=[*linear, 1.0])
        box.visual = trimesh.visual.TextureVisuals(material=material)
        scene.add_geometry(box, node_name=name, geom_name=name)
    path = tmp_path / "part.glb"
    scene.export(path)
    loaded = load(path, 1.0)
    assert areas(found(loaded, NamedRegion("large"))) == pytest.approx([6.0, 24.0], rel=1e-6)
    assert areas(found(loaded, NamedRegion("paint-small"))) == pytest.approx([24.0, 6.0], rel=1e-6)
    assert areas(found(loaded, ColouredRegion("#ff0000"))) == pytest.approx([24.0, 6.0], rel=1e-6)
    shown = {piece.colour for piece in loaded.pieces}
    assert "#FF0000" in shown
    assert len(shown) == 2


@pytest.mark.parametrize("of", ["faces", "vertices"])
@pytest.mark.parametrize("encoding", ["binary", "ascii"])
def test_colours_of_ply_files(tmp_path, of, encoding):
    box = trimesh.creation.box(extents=(1, 2, 3))
    if of == "faces":
        own = box.face_normals[:, 0] > 0.5
        box.visual.face_colors = np.where(own[:, None], RED, GREEN)
        area = 6.0
    else:
        own = box.vertices[:, 0] > 0.0
        box.visual.vertex_colors = np.where(own[:, None], RED, GREEN)
        area = 6.0 + 0.5 * (22.0 - 2 * 6.0)  # of the sides, whose triangles have two corners of one colour
    path = tmp_path / "part.ply"
    box.export(path, encoding=encoding)
    assert areas(found(load(path), ColouredRegion("#FF0000")))[1] == pytest.approx(area, rel=1e-6)


def test_cad_faces_of_step_files():
    """The face at a point, with the tessellation that the file has without regions."""
    loaded = load(KNOB, None)
    plain = load_mesh(KNOB, unit_mm=None, normals="smooth", crease_angle=0.5)
    assert len(loaded.mesh.faces) == len(plain.mesh.faces)
    assert len(loaded.pieces) == 22
    top = loaded.mesh.vertices[np.argmax(loaded.mesh.vertices[:, 2])]
    own = RegionAtPoints((tuple(top + np.array([0.0, 0.0, 0.1])),), cad=True).faces(loaded)
    assert loaded.piece is not None
    (piece,) = np.unique(loaded.piece[own])
    assert np.array_equal(own, loaded.piece == piece)
    with pytest.raises(InputError, match=r"is 5 mm from the surface, at most 0.5 mm are accepted; the nearest place"):
        RegionAtPoints((tuple(top + np.array([0.0, 0.0, 5.0])),), cad=True).faces(loaded)


def test_colours_of_step_files(tmp_path):
    """A face of the sample part gets a colour as CAD programs write it (ISO 10303-46)."""
    text = KNOB.read_text()
    face = next(line.split("=")[0].strip() for line in text.splitlines() if "ADVANCED_FACE" in line)
    context = next(
        line.split("=")[0].strip() for line in text.splitlines() if "GEOMETRIC_REPRESENTATION_CONTEXT" in line
    )
    first = 900_000
    lines = [
        "COLOUR_RGB('',0.,0.5,1.)",
        f"FILL_AREA_STYLE_COLOUR('',#{first})",
        f"FILL_AREA_STYLE('',(#{first + 1}))",
        f"SURFACE_STYLE_FILL_AREA(#{first + 2})",
        f"SURFACE_SIDE_STYLE('',(#{first + 3}))",
        f"SURFACE_STYLE_USAGE(.BOTH.,#{first + 4})",
        f"PRESENTATION_STYLE_ASSIGNMENT((#{first + 5}))",
        f"STYLED_ITEM('color',(#{first + 6}),{face})",
        f"MECHANICAL_DESIGN_GEOMETRIC_PRESENTATION_REPRESENTATION('',(#{first + 7}),{context})",
    ]
    styled = "".join(f"#{first + i}={line};\n" for i, line in enumerate(lines))
    at = text.rindex("ENDSEC;")
    path = tmp_path / "part.step"
    path.write_text(text[:at] + styled + text[at:])
    loaded = load(path, None)
    own = ColouredRegion("#0080FF").faces(loaded)
    assert loaded.piece is not None
    assert len(np.unique(loaded.piece[own])) == 1
    assert 0 < own.sum() < len(own) / 2


def test_surfaces_up_to_creases_of_meshes():
    plain = LoadedMesh(box_mesh(np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]])), ())
    own = RegionAtPoints(((0.5, 1.0, 3.0), (1.0, 1.0, 1.0)), cad=False)
    assert areas(found(plain, own)) == pytest.approx([22.0 - 8.0, 8.0])


def test_boxes_cut_faces_where_their_sides_are():
    plain = LoadedMesh(box_mesh(np.array([[0.0, 0.0, 0.0], [20.0, 20.0, 5.0]])), ())
    mesh = found(plain, BoxRegion((5.0, -1.0, 4.0), (6.0, 7.0, 9.0)))
    assert areas(mesh)[1] == pytest.approx(7.0 + 1.0)  # of the top, and of the front side
    assert surface_of(mesh).open_edges == 0
    # the part of a sphere between two parallel planes has the area 2πRh
    ball = LoadedMesh(sphere_mesh(10.0), ())
    mesh = found(ball, BoxRegion((-99.0, -99.0, 2.0), (99.0, 99.0, 5.0)))
    assert areas(mesh)[1] == pytest.approx(2.0 * math.pi * 10.0 * 3.0, rel=1e-3)
    assert sum(areas(mesh)) == pytest.approx(face_areas(ball.mesh).sum(), rel=1e-9)
    assert surface_of(mesh).open_edges == 0
    assert mesh.normals is not None
    directions = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1)[:, None]
    assert np.abs(mesh.normals - directions).max() < 2e-4


def test_masks_cut_faces_down_to_their_pixels():
    """A disc of radius 6 mm on a box's top; nothing on the bottom, nor outside the depth."""
    y, x = (np.mgrid[:200, :200] + 0.5) * 0.1
    mask = (x - 12.0) ** 2 + (y - 10.0) ** 2 < 36.0
    plain = LoadedMesh(box_mesh(np.array([[0.0, 0.0, 0.0], [20.0, 20.0, 5.0]])), ())
    disc = MaskRegion(mask, axis=2, positive=True, corner=(0.0, 0.0), pixel=0.1)
    mesh = found(plain, disc)
    assert areas(mesh)[1] == pytest.approx(math.pi * 36.0, rel=0.01)
    assert surface_of(mesh).open_edges == 0
    assert mesh.material is not None
    middles, weights = mesh.vertices[mesh.faces].mean(axis=1), face_areas(mesh) * (mesh.material == 1)
    assert np.average(middles, axis=0, weights=weights) == pytest.approx((12.0, 10.0, 5.0), abs=0.02)
    with pytest.raises(InputError, match="0: no surface of the part is in this region"):
        found(plain, replace(disc, depth=(6.0, 9.0)))
    with pytest.raises(InputError, match="0: the mask's border cuts the mesh into more than 500 triangles"):
        found(plain, disc, most=500)


def test_what_several_regions_have_is_of_the_first():
    plain = LoadedMesh(box_mesh(np.array([[0.0, 0.0, 0.0], [4.0, 1.0, 1.0]])), ())
    left, middle = BoxRegion((-1.0, -1.0, -1.0), (2.0, 2.0, 2.0)), BoxRegion((1.0, -1.0, -1.0), (3.0, 2.0, 2.0))
    assert areas(found(plain, left, middle)) == pytest.approx([5.0, 9.0, 4.0])
    assert areas(found(plain, middle, left)) == pytest.approx([5.0, 8.0, 5.0])
    with pytest.raises(InputError, match="1: all of its surface is in regions before it; place it before them"):
        found(plain, left, BoxRegion((-1.0, -1.0, -1.0), (1.0, 2.0, 2.0)))


@pytest.mark.parametrize(
    ("region", "message"),
    [
        (NamedRegion("lid"), r'0: no group "lid" in the mesh file; it has cover, chrome, label, other, paint|0: no gr'),
        (ColouredRegion("#123456"), "0: no faces of colour #123456 in the mesh file; it has none"),
        (BoxRegion((7.0, 7.0, 7.0), (8.0, 8.0, 8.0)), "0: no surface of the part is in this region"),
    ],
)
def test_regions_that_a_mesh_does_not_have(tmp_path, region, message):
    path = tmp_path / "part.obj"
    path.write_text(OBJ)
    with pytest.raises(InputError, match=message):
        found(load(path), region)


BOX = "    box_mm: {low: [-100, -100, -100], high: [100, 0, 100]}"
REGIONS = f"""
regions:
  - name: paint
{BOX}
    reflectance: {{R_d: 80, R_s: 2000, sigma_rad: 0.1}}
"""
PAINT = Reflectance(R_d=80.0, R_s=2000.0, sigma=0.1)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (f"{BOX}\n", "", 'missing key "colour", "group"'),
        ("    box_mm", "    group: lid\n    box_mm", "is given|group and box_mm are given|only one"),
        ("high: [100, 0, 100]", "high: [100, -200, 100]", "expected three numbers above those of low"),
        ("sigma_rad: 0.1}", "sigma_rad: 0.1, full_scale: 99}", "regions have full_scale of the part's own reflectance"),
        (
            "    box_mm: {low: [-100, -100, -100], high: [100, 0, 100]}",
            '    colour: "red"',
            "expected a colour such as",
        ),
        (f"{BOX}", "    colour: #97FFB5", 'expected a colour such as "#97FFB5", in quotes: without them # begins a'),
        (
            "    box_mm: {low: [-100, -100, -100], high: [100, 0, 100]}",
            "    mask: {file: gone.png, onto: +z, corner_mm: [0, 0], pixel_mm: 0.1}",
            "no such file",
        ),
    ],
)
def test_regions_that_are_refused(bench, old, new, message):
    text = bench.part.read_text() + REGIONS
    assert text.count(old) == 1
    bench.part.write_text(text.replace(old, new))
    with pytest.raises(InputError) as refused:
        load_part(bench.part)
    texts = " ".join(refused.value.args)
    assert any(part in texts for part in message.split("|"))
    assert "part.yaml:" in texts
    assert "regions[0]" in texts


def test_masks_are_copied_and_hashed_with_the_part(bench, tmp_path):
    """A mask that marks the half with y < 0, black below a level of one half."""
    picture = np.full((40, 100), 127, np.uint8)
    picture[20:] = 200  # the last rows are those with the least y
    write_png(bench.folder / "mask.png", picture, metadata={})
    mask = "    mask: {file: mask.png, onto: +z, corner_mm: [-50, -20], pixel_mm: 1, depth_mm: [-50, 50]}"
    bench.part.write_text(bench.part.read_text() + REGIONS.replace(BOX, mask))
    part, rig = load_part(bench.part), load_rig(bench.rig)
    mesh = build_scene(rig, part).mesh
    assert mesh.material is not None
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    assert 0.0 < (mesh.material == 1).mean() < 1.0
    file_y = middles[:, 1] - build_scene(rig, part).placement.translation[1]
    assert file_y[mesh.material == 1].max() < 0.01
    assert 'file: "../part/mask.png"' in copied_text(part, tmp_path / "copy").replace(bench.folder.name, "part")
    before = input_hashes(rig, part)
    write_png(bench.folder / "mask.png", 255 - picture, metadata={})
    assert input_hashes(rig, part) != before
    picture[:] = 0
    write_png(bench.folder / "mask.png", picture, metadata={})
    with pytest.raises(InputError, match=r'part.yaml:\d+: regions\[0\]: region "paint": no surface of the part is in'):
        build_scene(rig, part)


def scenes(bench):
    # the part with a painted half, the same part without, and painted all over; the mesh is the same
    bench.part.write_text(bench.part.read_text() + REGIONS)
    mixed = build_scene(bench.rig, bench.part)
    mesh = replace(mixed.mesh, material=None)
    chrome = replace(mixed, mesh=mesh, regions=())
    return mixed, chrome, replace(chrome, reflectance=PAINT)


@pytest.mark.parametrize("points", ["4", "auto"])
def test_images_of_a_region_are_those_of_a_part_of_its_reflectance(bench, points):
    bench.edit("rig.yaml", "points: 4", f"points: {points}")
    mixed, chrome, painted = scenes(bench)
    posture = mixed.postures[1]
    images = [render_posture(one, posture, caster=cast_rays_at(one), layers=True) for one in (mixed, chrome, painted)]
    material = images[0].geometry.material
    assert material is not None
    assert 1000 < (material == 1).sum() < images[0].geometry.hit.sum() - 1000
    for found_image, plain, other in zip(*(one.lights for one in images), strict=True):
        own = material == 1
        # penumbrae of a converged panel are interpolated between samples of one reflectance
        close = {"rtol": 1e-3, "atol": 0.1} if points == "auto" else {"rtol": 0.0, "atol": 0.0}
        assert np.allclose(found_image.level[~own], plain.level[~own], **close)
        assert np.allclose(found_image.level[own], other.level[own], **close)
        assert found_image.specular is not None
        assert other.specular is not None
        assert np.allclose(found_image.specular[own], other.specular[own], rtol=1e-3, atol=0.1)


def test_levels_and_variants_are_those_of_each_region(bench):
    mixed, chrome, painted = scenes(bench)
    caster = cast_rays_at(mixed)
    pixels = trace_pixels(mixed, mixed.postures[0], caster)
    some = np.flatnonzero(pixels.surface.front)[::37]
    surface, panels = pixels.surface.take(some), list(pixels.view.lights)
    material = surface.material
    assert material is not None
    plain = replace(surface, material=None)
    how = {"caster": caster, "shadows": True}
    found_levels = shade_isolated(surface, panels, reflectances=mixed.reflectances, **how)
    both = [shade_isolated(plain, panels, reflectances=one.reflectances, **how) for one in (chrome, painted)]
    for i, levels in enumerate(found_levels):
        assert np.array_equal(levels, np.where(material == 1, both[1][i], both[0][i]))
    lean = {"slope": np.array([0.0, 0.05]), "direction": np.array([0.0, 1.0])}
    lean |= {"R_d_factor": np.array([0.5, 1.0]), "sigma_factor": np.array([1.0, 1.5])}
    variants = surface_variants(**lean, reflectances=mixed.reflectances)
    references = np.cross(surface.normals, [0.3, 0.9, 0.1])
    references /= np.linalg.norm(references, axis=1)[:, None]
    sources = [panel_to_shade(panel, caster) for panel in panels]
    together = shade_variants(surface, references, sources, variants, caster=caster)
    for i, source in enumerate(sources):
        single = [shade_variants(plain, references, [source], [one], caster=caster)[0] for one in variants]
        assert np.array_equal(together[i].good, np.where(material == 1, single[1].good, single[0].good))
        assert np.array_equal(together[i].varied, np.where(material == 1, single[1].varied, single[0].varied))


def test_defects_in_a_region_change_its_own_reflectance(bench):
    """A stain of factor 0.5 halves the diffuse light of the paint."""
    bench.part.write_text(bench.part.read_text() + REGIONS.replace("R_s: 2000", "R_s: 0"))
    good = build_scene(bench.rig, bench.part)
    seen = trace_pixels(good, good.postures[0], cast_rays_at(good))
    at = seen.surface.points[seen.clean & (seen.surface.material == 1)].mean(axis=0)
    place = ", ".join(f"{x:.4g}" for x in good.placement.to_file(SurfaceFinder(good.mesh).nearest(at).point))
    stain = f"{{name: a, kind: stain, size_mm: 6, R_d_factor: 0.5, at_mm: [{place}]}}"
    bench.part.write_text(bench.part.read_text() + f"defects: [{stain}]\n")
    scene = build_scene(bench.rig, bench.part)
    caster, posture = cast_rays_at(scene), scene.postures[0]
    stained = render_posture(scene, posture, caster=caster)
    clean = render_posture(replace(scene, defects=()), posture, caster=caster)
    defect = stained.geometry.defect
    assert defect is not None
    own = defect == 0
    assert own.sum() > 20
    for a, b in zip(stained.lights, clean.lights, strict=True):
        assert np.allclose(a.level[own], 0.5 * b.level[own], rtol=1e-5)
        assert np.array_equal(a.level[~own], b.level[~own])


def test_borders_of_regions_are_left_out_as_edges_are(bench):
    mixed, chrome, _ = scenes(bench)
    caster, posture = cast_rays_at(mixed), mixed.postures[0]
    pixels, plain = (trace_pixels(one, posture, caster) for one in (mixed, chrome))
    lost = plain.clean & ~pixels.clean
    assert lost.any()
    y = pixels.surface.points[lost, 1] - mixed.placement.translation[1]
    assert np.abs(y).max() < 3.5 * 0.44
    near = np.abs(pixels.surface.points[:, 1] - mixed.placement.translation[1]) < 0.44
    assert not pixels.clean[near].any()


def test_a_region_s_scene_has_it_first():
    base, one, two = (Reflectance(R_d=float(i), R_s=1.0, sigma=0.1) for i in range(3))
    mesh = replace(sphere_mesh(1.0), material=np.arange(81920, dtype=np.uint8) % 3)
    scene = build_scene_like(mesh, base, one, two)
    swapped = scene_of_region(scene, 2)
    assert [own.R_d for own in swapped.reflectances] == [2.0, 1.0, 0.0]
    assert swapped.mesh.material is not None
    own = np.array([r.R_d for r in scene.reflectances])[mesh.material]
    assert np.array_equal(np.array([r.R_d for r in swapped.reflectances])[swapped.mesh.material], own)


def build_scene_like(mesh, base, *regions):
    scene = build_scene(ROOT / "configs/rigs/four-panel.yaml", ROOT / "configs/parts/cover-knob.yaml")
    named = tuple(PartRegion(name=str(i), reflectance=one) for i, one in enumerate(regions))
    return replace(scene, mesh=mesh, reflectance=base, regions=named)


def test_the_sharpest_lobe_and_models_of_regions(bench):
    ggx = REGIONS.replace("{R_d: 80, R_s: 2000, sigma_rad: 0.1}", "{model: ggx, R_d: 80, R_s: 2000, alpha: 0.02}")
    bench.part.write_text(bench.part.read_text() + ggx)
    scene = build_scene(bench.rig, bench.part)
    own = scene.regions[0].reflectance
    assert own.model == SpecularModel(name="ggx")
    assert own.sigma == 0.01
    assert scene.sharpest is own
    assert scene.reflectance.white_level == own.white_level  # a white surface is the same for both


def test_check_says_how_large_regions_are_and_which_no_posture_shows(bench):
    bottom = """\
  - name: bottom
    box_mm: {low: [-5, 1, -100], high: [5, 5, 1]}
    reflectance: {R_d: 80, R_s: 2000, sigma_rad: 0.1}
"""
    bench.part.write_text(bench.part.read_text() + REGIONS + bottom)
    findings = check_scene(load_rig(bench.rig), load_part(bench.part)).findings
    shares, hidden = (finding for finding in findings if finding.topic == "regions")
    assert shares.level == "ok"
    assert 0.4 < shares.values["paint"] < 0.6
    assert hidden.level == "warning"
    assert "the camera does not see bottom" in hidden.text


def test_check_asks_no_lobe_of_matt_surface(bench):
    """A painted part whose own reflectance, that of chrome, is nowhere."""
    everything = REGIONS.replace("high: [100, 0, 100]", "high: [100, 100, 100]").replace("R_s: 2000", "R_s: 0")
    bench.part.write_text(bench.part.read_text() + everything)
    findings = check_scene(load_rig(bench.rig), load_part(bench.part)).findings
    topics = {finding.topic for finding in findings}
    assert "mirrored part" not in topics
    notes = [finding.text for finding in findings if finding.topic == "regions"]
    assert any("no surface is outside the regions" in text for text in notes)
    assert all(f.values["bright field"] == 0.0 for f in findings if f.topic == "bright field")
    (levels,) = (finding for finding in findings if finding.topic == "levels")
    assert levels.values["highlight_level"] == 0.0


def test_all_wrong_regions_are_named_at_once(bench):
    more = """\
  - {name: lid, group: lid, reflectance: {R_d: 9, R_s: 9, sigma_rad: 0.1}}
  - {name: far, faces_at_mm: [[0, 0, 99]], reflectance: {R_d: 9, R_s: 9, sigma_rad: 0.1}}
"""
    bench.part.write_text(bench.part.read_text() + REGIONS + more)
    with pytest.raises(InputError) as refused:
        build_scene(bench.rig, bench.part)
    assert len(refused.value.args) == 2
    assert 'regions[1]: region "lid": no group "lid" in the mesh file; it has no named groups' in refused.value.args[0]
    assert 'regions[2]: region "far": the point [0.0, 0.0, 99.0] is' in refused.value.args[1]


def test_a_surface_that_was_not_fitted_keeps_its_form(bench):
    """Only the region was fitted, and by Lambert's form; the part's own exponent stays."""
    bench.edit("part.yaml", "{R_d: 45.0,", "{R_d: 45.0, diffuse_exponent: 1.2,")
    bench.part.write_text(bench.part.read_text() + REGIONS)
    kind: dict[str, Any] = {"kind": "specular", "method": "likelihood", "model": SpecularModel(), "points": 4}
    own = FitResult(**kind, values=(FittedValue("R_s", 1234.0),), fitted=("R_s",))
    whole = FitResult(**kind, values=(), fitted=(), regions=(RegionFit(name="paint", result=own),))
    text = _part_text(bench.folder, whole, load_part(bench.part))
    assert "{R_d: 45.0, diffuse_exponent: 1.2, R_s: 12500, sigma_rad: 0.0475}" in text
    assert "{R_d: 80, R_s: 1234, sigma_rad: 0.1}" in text
