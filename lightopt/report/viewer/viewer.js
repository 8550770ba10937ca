// The surface of a report, to turn with mouse, finger or keys. Data: see _surface_data.py. THREE is three.bundle.min.js.
"use strict";
(() => {
  const FIELD_OF_VIEW = 30; // [°]; the still picture has the same, see _surface.py
  const TURN = Math.PI / 36;

  async function inflate(text) {
    const packed = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Response(stream).arrayBuffer();
  }

  // columns of differences back to rows of values
  function summed(columns, rows) {
    const values = new columns.constructor(columns.length);
    for (let axis = 0; axis < 3; axis++) {
      let sum = 0;
      for (let k = 0; k < rows; k++) {
        sum += columns[axis * rows + k];
        values[3 * k + axis] = sum;
      }
    }
    return values;
  }

  function geometryOf(head, buffer) {
    const triangles = summed(new Int32Array(buffer, 0, 3 * head.triangles), head.triangles);
    const vertices = summed(new Int16Array(buffer, 12 * head.triangles, 3 * head.vertices), head.vertices);
    const corners = new Float32Array(9 * head.triangles);
    for (let corner = 0; corner < triangles.length; corner++) {
      for (let axis = 0; axis < 3; axis++) {
        corners[3 * corner + axis] = vertices[3 * triangles[corner] + axis] * head.step_mm;
      }
    }
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(corners, 3));
    geometry.setAttribute("color", new THREE.BufferAttribute(new Uint8Array(corners.length), 3, true));
    geometry.computeBoundingSphere();
    return geometry;
  }

  function paint(geometry, head, buffer, layer) {
    const first = 12 * head.triangles + 6 * head.vertices + layer * head.triangles;
    const classes = new Uint8Array(buffer, first, head.triangles);
    const colours = head.layers[layer].map((text) => [1, 3, 5].map((k) => parseInt(text.slice(k, k + 2), 16)));
    const attribute = geometry.getAttribute("color");
    for (let corner = 0; corner < 3 * head.triangles; corner++) {
      attribute.array.set(colours[classes[Math.floor(corner / 3)]], 3 * corner);
    }
    attribute.needsUpdate = true;
  }

  async function show(figure) {
    const head = JSON.parse(figure.querySelector("script.head").textContent);
    const buffer = await inflate(figure.querySelector("script.data").textContent);
    const canvas = figure.querySelector("canvas");
    const still = figure.querySelector("img.still");
    THREE.ColorManagement.enabled = false; // colours as in the legend
    const renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
    renderer.outputColorSpace = THREE.LinearSRGBColorSpace;
    renderer.setClearColor(0xffffff);
    const geometry = geometryOf(head, buffer);
    const material = new THREE.MeshLambertMaterial({ vertexColors: true, flatShading: true, side: THREE.DoubleSide });
    const scene = new THREE.Scene();
    const camera = new THREE.PerspectiveCamera(FIELD_OF_VIEW, 3 / 2, 0.01 * head.distance_mm, 4 * head.distance_mm);
    const lamp = new THREE.DirectionalLight(0xffffff, 0.3 * Math.PI);
    lamp.position.set(0, 0, 0); // at the eye
    lamp.target.position.set(0, 0, -1);
    camera.add(lamp, lamp.target);
    scene.add(camera, new THREE.AmbientLight(0xffffff, 0.7 * Math.PI), new THREE.Mesh(geometry, material));
    camera.up.set(...head.up);
    const controls = new THREE.OrbitControls(camera, canvas);
    controls.enablePan = true;
    controls.minDistance = 0.1 * head.distance_mm;
    controls.maxDistance = 3 * head.distance_mm;

    const draw = () => renderer.render(scene, camera);
    const home = () => {
      controls.target.set(0, 0, 0);
      camera.position.set(...head.toward).multiplyScalar(head.distance_mm);
      controls.update();
      draw();
    };
    const fit = () => {
      const width = figure.querySelector(".stage").clientWidth;
      if (!width) return;
      renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2));
      renderer.setSize(width, Math.round((2 / 3) * width), false);
      draw();
    };
    // about the axis that points up, in the frame where three.js' spherical coordinates have it
    const turn = (sideways, upwards, nearer) => {
      const toY = new THREE.Vector3(...head.up).normalize();
      const offset = camera.position.clone().sub(controls.target);
      const right = new THREE.Vector3().crossVectors(toY, offset).normalize();
      const angle = Math.acos(Math.max(-1, Math.min(1, toY.dot(offset) / offset.length())));
      const tilt = Math.max(0.02, Math.min(Math.PI - 0.02, angle - upwards)) - angle;
      offset.applyAxisAngle(right, tilt).applyAxisAngle(toY, sideways).multiplyScalar(nearer);
      camera.position.copy(controls.target).add(offset);
      controls.update();
      draw();
    };
    const keys = {
      ArrowLeft: () => turn(-TURN, 0, 1),
      ArrowRight: () => turn(TURN, 0, 1),
      ArrowUp: () => turn(0, TURN, 1),
      ArrowDown: () => turn(0, -TURN, 1),
      "+": () => turn(0, 0, 0.9),
      "-": () => turn(0, 0, 1 / 0.9),
      Home: home,
    };
    canvas.addEventListener("keydown", (event) => {
      const key = event.key === "=" ? "+" : event.key;
      if (!(key in keys) || event.ctrlKey || event.altKey || event.metaKey) return;
      event.preventDefault();
      keys[key]();
    });
    controls.addEventListener("change", draw);
    figure.querySelector("button.home").addEventListener("click", home);
    const choose = (layer) => {
      paint(geometry, head, buffer, layer);
      figure.querySelectorAll(".legend").forEach((list) => (list.hidden = list.dataset.layer !== String(layer)));
      draw();
    };
    figure.querySelectorAll("input[type=radio]").forEach((input) => {
      input.addEventListener("change", () => choose(Number(input.value)));
    });
    // on paper: what the canvas shows
    const snap = () => {
      draw();
      still.src = canvas.toDataURL("image/png");
    };
    window.addEventListener("beforeprint", snap);
    const chosen = figure.querySelector("input[type=radio]:checked");
    paint(geometry, head, buffer, chosen ? Number(chosen.value) : 0);
    figure.classList.add("live");
    new ResizeObserver(fit).observe(figure.querySelector(".stage"));
    fit();
    home();
    choose(chosen ? Number(chosen.value) : 0);
    figure.dataset.state = "live";
  }

  document.querySelectorAll("figure.surface").forEach((figure) => {
    show(figure).catch((error) => {
      // no WebGL, or a browser that cannot inflate: the still picture stays
      figure.dataset.state = "still";
      figure.querySelector(".reason").textContent = ` (${error.message || error})`;
      figure.querySelector(".fallback").hidden = false;
    });
  });
})();
