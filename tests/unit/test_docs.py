"""What the documentation shows is what the program does: its Python runs, its messages are the program's."""

from __future__ import annotations

import re
import runpy
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
from reference import specular

from lightopt.config import ReflectanceConfig
from lightopt.images import read_image_set, write_png
from lightopt.optics import Reflectance, SpecularModel

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
SNIPPETS = [
    pytest.param(text, id=f"{page.name}-{i}")
    for page in PAGES
    for i, text in enumerate(re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.M | re.S))
]


@pytest.fixture(scope="module")
def clone(shared_bench, tmp_path_factory) -> Path:
    """A folder with what the pages tell to make, under the names they use; the rig's camera is a small one."""
    from lightopt.cli._main import run

    folder = tmp_path_factory.mktemp("docs")
    rig, part = Path("configs/rigs/four-panel.yaml"), Path("configs/parts/cover-knob.yaml")
    for own, name in (
        (shared_bench.rig, rig),
        (shared_bench.part, part),
        (shared_bench.mesh, part.parent / "knob.stl"),
    ):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(own, folder / name)
    for name in (rig, part):
        assert (ROOT / name).is_file()
    for out in ("demo", "mine"):
        arguments = ["render", folder / rig, folder / part, "-o", folder / "out" / out, "-q", "--patches", "500"]
        assert run(list(map(str, arguments))) == 0
    return folder


def anchors_of(page: Path) -> set[str]:
    """Anchors of a page's headings, as MkDocs and GitHub make them."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    titles = (re.sub(r"[^\w\- ]", "", title.lower()) for title in re.findall(r"^#+ (.*)$", text, re.M))
    return {title.strip().replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", PAGES, ids=[page.relative_to(ROOT).as_posix() for page in PAGES])
def test_links_lead_somewhere(page):
    text = re.sub(r"^```.*?^```|^ {4}.*?$|`[^`]*`", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match("[a-z]+:", link):
            continue
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), link
        assert not anchor or anchor in anchors_of(target), link


def test_every_page_is_in_the_sites_navigation():
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    pages = {page.relative_to(ROOT / "docs").as_posix() for page in (ROOT / "docs").rglob("*.md")}
    assert pages == set(re.findall(r"- ([\w/-]+\.md)$", text, re.M))


def test_the_command_line_reference_is_what_the_commands_say():
    program = runpy.run_path(str(ROOT / "scripts" / "write_cli_reference.py"))
    page = ROOT / "docs" / "reference" / "command-line.md"
    assert page.read_text(encoding="utf-8") == program["page"]()


def test_there_are_snippets():
    assert len(SNIPPETS) >= 3


@pytest.mark.parametrize("snippet", SNIPPETS)
def test_snippets_run_as_they_stand(clone, monkeypatch, capsys, snippet):
    monkeypatch.chdir(clone)
    exec(compile(snippet, "snippet", "exec"), {"__name__": "snippet"})
    assert capsys.readouterr().out


def test_the_error_that_getting_started_quotes_is_the_programs(cli, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli("init", "myrig").status == 0
    rig = tmp_path / "myrig" / "rig.yaml"
    text = rig.read_text(encoding="utf-8").replace("elevation_deg", "elevaton_deg", 1)
    rig.write_text(text, encoding="utf-8")
    ran = cli("check", "myrig/rig.yaml", "myrig/part.yaml")
    assert ran.status == 2
    page = (ROOT / "docs" / "tutorial" / "getting-started.md").read_text(encoding="utf-8")
    assert f"```text\n{ran.err.replace(chr(92), '/')}```\n" in page


def test_the_manifest_that_the_conventions_show_is_enough(tmp_path):
    text = (ROOT / "docs" / "reference" / "conventions.md").read_text(encoding="utf-8")
    shown = re.search(r"^```json\n(.*?)^```", text, re.M | re.S)
    assert shown is not None
    (tmp_path / "manifest.json").write_text(shown[1], encoding="utf-8")
    for name in ("first.png", "first-short.png"):
        write_png(tmp_path / name, np.zeros((3, 4), np.uint8), metadata={})
    images = read_image_set(tmp_path)
    assert [image.exposure for image in images.images] == [1, 0.0625]
    assert images.load(images.images[0]).levels.shape == (3, 4)
    assert images.manifest.kind == "captured"


def test_the_hardware_that_a_rig_from_zero_is_tried_with_is_one(cli, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = (ROOT / "docs" / "how-to" / "rig-from-zero.md").read_text(encoding="utf-8")
    (section,) = re.findall(r"^```yaml\n(hardware:\n.*?)^```", text, re.M | re.S)
    assert cli("init", "myrig").status == 0
    rig = tmp_path / "myrig" / "rig.yaml"
    own = rig.read_text(encoding="utf-8")
    assert own.count("  # exposure_us: 10000 ") == 1
    own = own.replace("  # exposure_us: 10000 ", "  exposure_us: 10000 ")
    # what the simulated GigE camera needs is not on every computer
    section = section.replace("driver: aravis, port: virtual", "driver: virtual")
    rig.write_text(f"{own}\n{section}", encoding="utf-8", newline="\n")
    ran = cli("capture", "myrig/rig.yaml", "myrig/part.yaml", "--dry-run", "--check-repeatability")
    assert ran.status == 0
    moves = re.findall(r"move to \((.*?)\)", ran.out)
    assert moves == ["0°, 0°", "0°, 82°", "0°, 180°", "0°, 278°", "0°, 0°"]


def test_finishes_are_reflectances_of_part_files():
    page = (ROOT / "docs" / "reference" / "finishes.md").read_text(encoding="utf-8")
    lines = re.findall(r"^reflectance: .*$", page, re.MULTILINE)
    assert len(lines) >= 5
    for line in lines:
        own = ReflectanceConfig.model_validate(yaml.safe_load(line)["reflectance"])
        gaussian = own.brushing and not line.endswith("# brushed steel")
        assert own.model == ("torrance-sparrow" if gaussian else "ggx")


def test_satin_finishes_have_the_gloss_that_they_name():
    """By drawn directions of the meter's apertures (ISO 2813), the plain formula of GGX, and glass by Fresnel's."""
    page = (ROOT / "docs" / "reference" / "finishes.md").read_text(encoding="utf-8")
    lines = re.findall(r"^(reflectance: .*)   # .*, (\d+) gloss units$", page, re.MULTILINE)
    assert len(lines) == 6
    random = np.random.default_rng(5)

    def drawn(sides, sign):
        axis, aside = [sign * np.sqrt(0.75), 0.0, 0.5], [sign * 0.5, 0.0, -np.sqrt(0.75)]
        a, b = (np.tan(np.radians(side) * random.uniform(-0.5, 0.5, (40_000, 1))) for side in sides)
        found = axis + a * np.array(aside) + b * np.array([0.0, 1.0, 0.0])
        return found / np.linalg.norm(found, axis=1, keepdims=True)

    light, view = drawn((0.75, 2.5), 1.0), drawn((4.4, 11.7), -1.0)
    n, c = 1.567, 0.5
    t = np.sqrt(1.0 - 0.75 / n**2)
    glass = 0.5 * (((c - n * t) / (c + n * t)) ** 2 + ((n * c - t) / (n * c + t)) ** 2)
    for line, reading in lines:
        own = ReflectanceConfig.model_validate(yaml.safe_load(line)["reflectance"])
        reflectance = Reflectance(R_d=0.0, R_s=own.R_s, sigma=0.5 * own.alpha, model=SpecularModel(name="ggx"))
        lobe = specular(np.array([0.0, 0.0, 1.0]), view, light, reflectance)
        share = np.mean(own.R_s * lobe * view[:, 2] / light[:, 2]) / (np.pi * own.white_level)
        found = 100.0 * share * np.radians(4.4) * np.radians(11.7) / glass
        assert found == pytest.approx(float(reading), rel=0.015), line
