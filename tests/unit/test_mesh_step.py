"""STEP files: through the worker process, with the CAD surface's normals, units, assemblies and limits."""

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from mesh_surface import surface_of

from lightopt.core.errors import InputError
from lightopt.geometry import NamedRegion, _step, _step_worker, load_mesh
from lightopt.geometry._glb import MeshPiece
from lightopt.geometry._load_mesh import LoadedMesh
from lightopt.geometry._step import declared_unit_mm
from lightopt.geometry._step_bodies import name_bodies

pytestmark = pytest.mark.usefixtures("real_step_files")

KNOB = Path(__file__).parents[2] / "configs" / "parts" / "cover-knob.step"

MILLIMETRE = "#30=(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.));"
INCH = """#30=(CONVERSION_BASED_UNIT('INCH',#35)LENGTH_UNIT()NAMED_UNIT(#34));
#34=DIMENSIONAL_EXPONENTS(1.,0.,0.,0.,0.,0.,0.);
#35=LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE(25.4),#36);
#36=(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.));"""


def si(prefix: str) -> str:
    return MILLIMETRE.replace(".MILLI.", prefix)


def ball(*, unit: str = MILLIMETRE, radius: float = 10.0, centre=(1.0, 2.0, 3.0), more: str = "") -> str:
    """STEP text of a solid bounded by one whole spherical face, the smallest solid there is."""
    x, y, z = centre
    return f"""ISO-10303-21;
HEADER;
FILE_DESCRIPTION(('ball'),'2;1');
FILE_NAME('ball','2020-01-01T00:00:00',(''),(''),'','','');
FILE_SCHEMA(('AUTOMOTIVE_DESIGN {{ 1 0 10303 214 1 1 1 1 }}'));
ENDSEC;
DATA;
#1=APPLICATION_CONTEXT('core data');
#2=APPLICATION_PROTOCOL_DEFINITION('international standard','automotive_design',2000,#1);
#3=PRODUCT_CONTEXT('',#1,'mechanical');
#4=PRODUCT('ball','ball','',(#3));
#5=PRODUCT_DEFINITION_FORMATION('','',#4);
#6=PRODUCT_DEFINITION_CONTEXT('part definition',#1,'design');
#7=PRODUCT_DEFINITION('design','',#5,#6);
#8=PRODUCT_DEFINITION_SHAPE('','',#7);
#9=SHAPE_DEFINITION_REPRESENTATION(#8,#10);
#10=ADVANCED_BREP_SHAPE_REPRESENTATION('',(#11,#20),#29);
#11=AXIS2_PLACEMENT_3D('',#12,#13,#14);
#12=CARTESIAN_POINT('',(0.,0.,0.));
#13=DIRECTION('',(0.,0.,1.));
#14=DIRECTION('',(1.,0.,0.));
#20=MANIFOLD_SOLID_BREP('',#21);
#21=CLOSED_SHELL('',(#22));
#22=ADVANCED_FACE('',(#23),#26,.T.);
#23=FACE_BOUND('',#24,.T.);
#24=VERTEX_LOOP('',#25);
#25=VERTEX_POINT('',#28);
#26=SPHERICAL_SURFACE('',#27,{radius});
#27=AXIS2_PLACEMENT_3D('',#37,#13,#14);
#37=CARTESIAN_POINT('',({x},{y},{z}));
#28=CARTESIAN_POINT('',({x},{y},{z - radius}));
#29=(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT((#33))
GLOBAL_UNIT_ASSIGNED_CONTEXT((#30,#31,#32))REPRESENTATION_CONTEXT('',''));
{unit}
#31=(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.RADIAN.));
#32=(NAMED_UNIT(*)SI_UNIT($,.STERADIAN.)SOLID_ANGLE_UNIT());
#33=UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE(1.E-06),#30,'distance_accuracy_value','');
{more}ENDSEC;
END-ISO-10303-21;
"""


def two_balls() -> str:
    """Assembly that places the ball of radius 2 at (10, 0, 0), and turned and moved to (0, 20, 5)."""
    more = """#100=PRODUCT('pair','pair','',(#3));
#101=PRODUCT_DEFINITION_FORMATION('','',#100);
#102=PRODUCT_DEFINITION('design','',#101,#6);
#103=PRODUCT_DEFINITION_SHAPE('','',#102);
#104=SHAPE_DEFINITION_REPRESENTATION(#103,#105);
#105=SHAPE_REPRESENTATION('',(#11,#110,#120),#29);
"""
    places = {110: ("10.,0.,0.", "0.,0.,1.", "1.,0.,0."), 120: ("0.,20.,5.", "1.,0.,0.", "0.,1.,0.")}
    for n, (origin, axis, reference) in places.items():
        more += f"""#{n}=AXIS2_PLACEMENT_3D('',#{n + 1},#{n + 2},#{n + 3});
#{n + 1}=CARTESIAN_POINT('',({origin}));
#{n + 2}=DIRECTION('',({axis}));
#{n + 3}=DIRECTION('',({reference}));
#{n + 4}=NEXT_ASSEMBLY_USAGE_OCCURRENCE('{n}','','',#102,#7,$);
#{n + 5}=PRODUCT_DEFINITION_SHAPE('','',#{n + 4});
#{n + 6}=CONTEXT_DEPENDENT_SHAPE_REPRESENTATION(#{n + 7},#{n + 5});
#{n + 7}=(REPRESENTATION_RELATIONSHIP('','',#10,#105)
REPRESENTATION_RELATIONSHIP_WITH_TRANSFORMATION(#{n + 8})SHAPE_REPRESENTATION_RELATIONSHIP());
#{n + 8}=ITEM_DEFINED_TRANSFORMATION('','',#11,#{n});
"""
    return ball(radius=2.0, centre=(1.0, 0.0, 0.0), more=more)


def with_bodies(*bodies: tuple[str, float, float]) -> str:
    """The ball without a name, and in the same product others of a name, an X and a radius [mm]."""
    text, items = ball(radius=3.0), "#20"
    for n, (name, x, radius) in enumerate(bodies, start=3):
        items += f",#{n}20"
        text = text.replace(
            "ENDSEC;\nEND-ISO",
            f"""#{n}20=MANIFOLD_SOLID_BREP('{name}',#{n}21);
#{n}21=CLOSED_SHELL('',(#{n}22));
#{n}22=ADVANCED_FACE('',(#{n}23),#{n}26,.T.);
#{n}23=FACE_BOUND('',#{n}24,.T.);
#{n}24=VERTEX_LOOP('',#{n}25);
#{n}25=VERTEX_POINT('',#{n}28);
#{n}26=SPHERICAL_SURFACE('',#{n}27,{radius});
#{n}27=AXIS2_PLACEMENT_3D('',#{n}37,#13,#14);
#{n}37=CARTESIAN_POINT('',({x},2.,3.));
#{n}28=CARTESIAN_POINT('',({x},2.,{3.0 - radius}));
ENDSEC;
END-ISO""",
        )
    return text.replace("(#11,#20),#29", f"(#11,{items}),#29")


def load(tmp_path: Path, text: str, name: str = "part.step", **changes) -> LoadedMesh:
    path = tmp_path / name
    path.write_text(text)
    options = {"unit_mm": None, "normals": "smooth", "crease_angle": 0.5, **changes}
    return load_mesh(path, **options)


def refused(tmp_path: Path, text: str, match: str, **changes) -> None:
    with pytest.raises(InputError, match=match) as caught:
        load(tmp_path, text, **changes)
    assert "part.step" in str(caught.value)


def test_ball_keeps_the_normals_of_the_cad_surface(tmp_path):
    loaded = load(tmp_path, ball(), chord_tolerance_mm=0.05, angular_tolerance=0.3)
    assert loaded.warnings == ()
    assert surface_of(loaded.mesh).watertight
    from_centre = loaded.mesh.vertices - (1, 2, 3)
    distance = np.linalg.norm(from_centre, axis=1)
    assert distance == pytest.approx(10.0, abs=1e-5)
    # coarse triangles, exact normals: nothing that averages facets comes near
    assert loaded.mesh.normals == pytest.approx(from_centre / distance[:, None], abs=1e-6)
    middle = loaded.mesh.vertices[loaded.mesh.faces].mean(axis=1) - (1, 2, 3)
    assert np.linalg.norm(middle, axis=1).min() > 10 - 0.05


def test_tolerances_reach_the_kernel(tmp_path):
    coarse = load(tmp_path, ball(), chord_tolerance_mm=0.5, angular_tolerance=0.5).mesh
    fine = load(tmp_path, ball(), chord_tolerance_mm=0.02, angular_tolerance=0.5).mesh
    assert len(fine.faces) > 3 * len(coarse.faces)


@pytest.mark.parametrize(
    ("unit", "radius", "mm"), [(INCH, 0.5, 12.7), (si(".CENTI."), 1.0, 10.0), (si("$"), 0.01, 10.0)]
)
def test_declared_unit_is_converted(tmp_path, unit, radius, mm):
    loaded = load(tmp_path, ball(unit=unit, radius=radius, centre=(0.0, 0.0, 0.0)), chord_tolerance_mm=0.1)
    assert np.linalg.norm(loaded.mesh.vertices, axis=1) == pytest.approx(mm, rel=1e-6)


def test_declared_unit_is_read_without_the_kernel():
    assert declared_unit_mm(ball().encode()) == 1.0
    assert declared_unit_mm(ball(unit=INCH).encode()) == 25.4
    assert declared_unit_mm(ball(unit=si("$")).replace("=(", "= ( ").encode()) == 1000.0
    assert declared_unit_mm(ball(unit=si(".ATTO.")).encode()) is None
    assert declared_unit_mm(b"") is None


def test_size_that_looks_like_a_unit_mistake_is_refused_quickly(tmp_path):
    refused(tmp_path, ball(unit=si("$")), r"2e\+04 mm \(the file declares m\).* 20 mm with a unit mistake of 1000")
    refused(tmp_path, ball(radius=0.01), "declares mm.* 20 mm with a unit mistake of 1000")


def test_assembly_is_put_together(tmp_path):
    loaded = load(tmp_path, two_balls(), chord_tolerance_mm=0.01)
    assert surface_of(loaded.mesh).components == 2
    # the second placement takes x to +Y: the ball's centre (1, 0, 0) goes to (0, 21, 5)
    centres = np.array([[11.0, 0, 0], [0, 21, 5]])
    from_centre = loaded.mesh.vertices[:, None] - centres
    distance = np.linalg.norm(from_centre, axis=2)
    assert distance.min(axis=1) == pytest.approx(2.0, abs=1e-5)
    own = np.argmin(distance, axis=1)
    rows = np.arange(len(own))
    assert loaded.mesh.normals == pytest.approx(from_centre[rows, own] / 2.0, abs=1e-5)
    assert set(own) == {0, 1}


def test_facets_of_a_step_file(tmp_path):
    loaded = load(tmp_path, ball(), normals="facet", chord_tolerance_mm=0.5, angular_tolerance=0.5)
    assert loaded.mesh.normals is None


def test_stp_and_names_that_need_care(tmp_path):
    assert len(load(tmp_path, ball(), name="-part ü.STP", chord_tolerance_mm=0.5).mesh.faces)


@pytest.mark.slow
def test_sample_part_same_bytes_twice():
    first, second = (
        load_mesh(KNOB, unit_mm=1.0, normals="smooth", crease_angle=0.5, chord_tolerance_mm=0.1, angular_tolerance=0.3)
        for _ in range(2)
    )
    assert first.mesh.vertices.tobytes() == second.mesh.vertices.tobytes()
    assert first.mesh.faces.tobytes() == second.mesh.faces.tobytes()
    assert first.mesh.normals is not None
    assert np.ptp(first.mesh.bounds, axis=0).max() == pytest.approx(50, rel=0.2)
    assert surface_of(first.mesh).watertight


def test_cut_off_damaged_and_empty_files(tmp_path):
    text = ball()
    refused(tmp_path, text[: len(text) // 2], "cut off: .* bytes without END-ISO-10303-21")
    refused(tmp_path, "solid x\nendsolid x\n", "not a STEP file: expected it to begin with ISO-10303-21")
    refused(tmp_path, "ISO-10303-21;\nHEADER;\nENDSEC;\nDATA;\nENDSEC;\nEND-ISO-10303-21;\n", "could not be read")
    refused(tmp_path, text.replace("SPHERICAL_SURFACE", "NO_SUCH_SURFACE"), "no surfaces or solids")


def test_complaints_of_the_kernel_are_passed_on(tmp_path):
    loaded = load(tmp_path, ball(more="#99=((;\n"), chord_tolerance_mm=0.5)
    assert len(loaded.warnings) == 1
    assert "the CAD kernel reported while reading the STEP file: ERR StepFile" in loaded.warnings[0]


def test_timeout_says_what_was_tried_and_what_to_do(tmp_path, monkeypatch):
    monkeypatch.setattr(_step, "TIMEOUT_S", 1.5)
    refused(
        tmp_path,
        ball(),
        r"(fine tessellation \(chord tolerance 0.0001 mm|coarse).* stopped after 1.5 s in all. Use a coarser",
        chord_tolerance_mm=1e-4,
        angular_tolerance=1e-3,
    )


def test_a_tolerance_by_the_footprint_of_a_wrong_camera_is_refused_at_once(tmp_path):
    """A camera whose distance is in metres has pixels of nanometres; the kernel would take hours, and say nothing."""
    begun = time.monotonic()
    refused(tmp_path, ball(), "check distance_mm and pixel_size_um of the camera", chord_tolerance_mm=1e-5)
    assert time.monotonic() - begun < 120.0


def test_a_wrong_unit_ends_the_fine_tessellation_at_once(tmp_path, monkeypatch):
    """The part is 20 m large: at this tolerance the worker would take hours."""
    workers: list[subprocess.Popen[bytes]] = []

    class Worker(subprocess.Popen):
        def __init__(self, *arguments, **options):
            super().__init__(*arguments, **options)
            workers.append(self)

    monkeypatch.setattr(_step.subprocess, "Popen", Worker)
    begun = time.monotonic()
    refused(
        tmp_path, ball(unit=si("$")), "with a unit mistake of 1000", chord_tolerance_mm=1e-4, angular_tolerance=1e-3
    )
    assert time.monotonic() - begun < 120.0
    assert [worker.poll() is not None for worker in workers] == [True, True]


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no limit that a process can set for itself")
def test_memory_limit(tmp_path, monkeypatch):
    monkeypatch.setattr(_step, "MEMORY_GB", 0.05)
    refused(tmp_path, ball(), "memory")


def test_too_many_triangles(tmp_path):
    refused(tmp_path, ball(), "triangles, at most 100 are accepted", max_triangles=100)


def test_worker_reports_a_file_that_the_kernel_refuses(tmp_path):
    command = [sys.executable, _step_worker.__file__, str(tmp_path / "none.step"), str(tmp_path / "o.glb")]
    done = subprocess.run([*command, "0.1", "0.5", "0", "0", str(4 * 10**9)], capture_output=True, check=False)
    assert done.returncode == _step_worker.EXIT_READ
    assert not (tmp_path / "o.glb").exists()


def bodies_of(loaded: LoadedMesh) -> dict[str, tuple[int, int]]:
    """Least and greatest X of the triangles of each name but the product's [mm], rounded."""
    assert loaded.piece is not None
    x = loaded.mesh.vertices[loaded.mesh.faces][:, :, 0]
    found: dict[str, tuple[int, int]] = {}
    for number, piece in enumerate(loaded.pieces):
        own = x[loaded.piece == number]
        found |= {name: (round(own.min()), round(own.max())) for name in piece.names if name not in ("ball", "pair")}
    return found


def test_bodies_of_a_product_have_their_names(tmp_path):
    """Also where two bodies touch, and as other letters than ASCII are written."""
    text = with_bodies(
        ("lid", 20.0, 2.0), ("it''s", 24.0, 2.0), ("D\\X2\\00FC\\X0\\se \\X\\E9", 40.0, 5.0), ("", 60.0, 1.0)
    )
    loaded = load(tmp_path, text, pieces=True)
    assert bodies_of(loaded) == {"lid": (18, 22), "it's": (22, 26), "Düse é": (35, 45)}
    assert not [one for one in loaded.warnings if "bodies" in one]
    assert [piece.names for piece in loaded.pieces][::4] == [("ball",), ("ball",)]
    assert load(tmp_path, text.replace("'lid'", "'ball'"), pieces=True).pieces[1].names == ("ball",)


def test_bodies_in_an_assembly_are_found_in_each_place(tmp_path):
    loaded = load(tmp_path, two_balls().replace("BREP('',#21)", "BREP('core',#21)"), pieces=True)
    assert [piece.names for piece in loaded.pieces] == [("110", "ball", "core"), ("120", "ball", "core")]


def test_comments_are_no_part_of_bodies_and_quotes_no_comments(tmp_path):
    text = with_bodies(("/* lid */", 20.0, 2.0), ("cap", 40.0, 2.0))
    text = text.replace("(#322)", "(#322 /* first; of 'all' */)").replace("BREP('cap'", "BREP(/* it's */'cap'")
    loaded = load(tmp_path, text, pieces=True)
    assert bodies_of(loaded) == {"/* lid */": (18, 22), "cap": (38, 42)}
    assert not [one for one in loaded.warnings if "bodies" in one]


SECOND_UNIT = """#90=(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNIT_ASSIGNED_CONTEXT((#91))
REPRESENTATION_CONTEXT('',''));
#91=(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.CENTI.,.METRE.));
ENDSEC;
END-ISO"""


@pytest.mark.parametrize(
    ("spoilt", "reason"),
    [
        # another place of a vertex, and two bodies in one place
        (
            with_bodies(("lid", 20.0, 2.0)).replace(
                "328=CARTESIAN_POINT('',(20.0,2.,1.0))", "328=CARTESIAN_POINT('',(20.,2.,1.1))"
            ),
            "ball: its named bodies do not match the faces that the CAD kernel finds",
        ),
        (with_bodies(("lid", 20.0, 2.0), ("cap", 20.0, 2.0)), "or not in one way only: names not read"),
        (
            with_bodies(("lid", 20.0, 2.0)).replace("ENDSEC;\nEND-ISO", SECOND_UNIT),
            "names of bodies not read: the file declares several units of length",
        ),
    ],
)
def test_names_of_bodies_are_not_guessed(tmp_path, spoilt, reason):
    """The warning is also in the error of a region of such a name, which ends the command before warnings are shown."""
    loaded = load(tmp_path, spoilt, pieces=True)
    assert bodies_of(loaded) == {}
    (warning,) = [one for one in loaded.warnings if "bodies" in one]
    assert reason in warning
    with pytest.raises(InputError, match='no group "lid" in the mesh file; it has ball; ') as refused:
        NamedRegion("lid").faces(loaded)
    assert str(refused.value).endswith(warning)


def test_names_of_as_many_bodies_as_are_read():
    """Without the kernel: each face has one triangle, at the vertex of its ball."""
    own = [(f"body {n}", float(n), 0.25) for n in range(1, 501)]
    places = [(1.0, 2.0, 0.0), *((x, 2.0, 3.0 - radius) for _, x, radius in own)]
    parts = [{"node": 0, "piece": MeshPiece(("ball",)), "local": 1e-3 * np.tile(at, (3, 1))} for at in places]
    assert name_bodies(parts[:-1], with_bodies(*own[:-1]).encode(), 1000.0) == ()
    assert [part["piece"].names[1:] for part in parts[:-1]] == [(), *((name,) for name, _, _ in own[:-1])]
    (warning,) = name_bodies(parts, with_bodies(*own).encode(), 1000.0)
    assert warning == "names of bodies not read: the file has 501 bodies, names are read of at most 500"
