"""Bundle three.js for lightopt/report/viewer anew: two pinned npm packages in, one file out. Needs npm.

The same versions give the same bytes; the README beside the bundle has their SHA-256.
"""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

THREE, ESBUILD = "0.180.0", "0.28.2"
VIEWER = Path(__file__).resolve().parent.parent / "lightopt" / "report" / "viewer"
BUNDLE, LICENSE = VIEWER / "three.bundle.min.js", VIEWER / "LICENSE.three.txt"
ENTRY = """\
export {
  AmbientLight, BufferAttribute, BufferGeometry, ColorManagement, DirectionalLight, DoubleSide, LinearSRGBColorSpace,
  Mesh, MeshLambertMaterial, PerspectiveCamera, Scene, Spherical, Vector3, WebGLRenderer,
} from "three";
export { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
"""


def main() -> None:
    npm = shutil.which("npm") or sys.exit("npm: not found; install Node.js (https://nodejs.org)")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "entry.js").write_text(ENTRY, encoding="utf-8")
        packages = (f"three@{THREE}", f"esbuild@{ESBUILD}")
        subprocess.run([npm, "install", "--ignore-scripts", "--no-save", *packages], check=True, cwd=folder)
        license_text = (folder / "node_modules/three/LICENSE").read_text(encoding="utf-8")
        subprocess.run(
            [
                npm, "exec", "--no", "--", "esbuild", "entry.js", "--bundle", "--minify", "--format=iife",
                "--global-name=THREE", "--target=es2020", "--charset=utf8", "--legal-comments=inline",
                f"--banner:js=/*! three.js {THREE}\n{license_text.strip()}\n*/", "--outfile=bundle.js",
            ],
            check=True,
            cwd=folder,
        )  # fmt: skip
        BUNDLE.write_bytes((folder / "bundle.js").read_bytes())
        LICENSE.write_text(license_text, encoding="utf-8", newline="\n")
    print(f"{hashlib.sha256(BUNDLE.read_bytes()).hexdigest()}  {BUNDLE.name}")


if __name__ == "__main__":
    main()
