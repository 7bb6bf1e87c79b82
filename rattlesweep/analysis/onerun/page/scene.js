"use strict";
// What is drawn: the body's true shape, the plane, shadow and trace. Lengths are in units of a.
function makeScene(canvas, { body, solid: mesh, rise, trail, start, slides, changed }) {
  const T = THREE;
  const nothing = () => {};
  const absent = (error) => ({ error, draw: nothing, resize: nothing, paint: nothing,
    reset: nothing, turn: nothing, zoom: nothing });
  const sorry = "This browser offers no WebGL 2, so the body cannot be drawn. "
    + "The spin curve and the numbers beside it work all the same.";
  if (!document.createElement("canvas").getContext("webgl2")) return absent(sorry);
  let renderer;
  try {
    renderer = new T.WebGLRenderer({ canvas, antialias: true, preserveDrawingBuffer: true });
  } catch {
    return absent(sorry);
  }
  renderer.shadowMap.enabled = true;
  renderer.shadowMap.type = T.PCFShadowMap;
  renderer.toneMapping = T.NeutralToneMapping;
  renderer.toneMappingExposure = 1.0;

  // -------------------------------------------------------------- the body
  // Its paraboloid (Eq. def-z), or ellipsoid of vertical semi-axis body.c, cut off at a height that
  // every contact of the run stays below: where theta x^2 + phi y^2 = q, the surface has risen by
  // q / (1 + sqrt(1 - q / c)).
  // Body axes: z points down to the contact; curvature theta lies along (cos xi, sin xi).
  const perC = body.c ? 1 / body.c : 0, rim = rise * (2 - rise * perC);
  let short = Math.sqrt(rim / body.theta), long = Math.sqrt(rim / body.phi);
  const c = Math.cos(body.xi), s = Math.sin(body.xi);
  const lip = 0.12 * rise;
  let dome = 0.34 * rise;
  let top = 1 - rise - lip;
  const deckAt = (rho) => top - dome * (1 - rho * rho);
  const place = (u, v, z) => [c * u - s * v, s * u + c * v, z];

  // A profile (rho, z) with normals, drawn out around the ellipse of the rim.
  function hull(profile, around) {
    const position = [], normal = [], index = [];
    for (const [rho, z, nr, nz] of profile) {
      for (let k = 0; k <= around; k++) {
        const angle = (2 * Math.PI * k) / around, x = Math.cos(angle), y = Math.sin(angle);
        position.push(...place(short * rho * x, long * rho * y, z));
        const n = [(nr * x) / short, (nr * y) / long, nz];
        const size = Math.hypot(...n) || 1;
        normal.push(...place(n[0] / size, n[1] / size, n[2] / size));
      }
    }
    const row = around + 1;
    for (let i = 0; i + 1 < profile.length; i++) {
      for (let k = 0; k < around; k++) {
        const a = i * row + k;
        index.push(a, a + row, a + 1, a + 1, a + row, a + row + 1);
      }
    }
    const shape = new T.BufferGeometry();
    shape.setAttribute("position", new T.BufferAttribute(new Float32Array(position), 3));
    shape.setAttribute("normal", new T.BufferAttribute(new Float32Array(normal), 3));
    shape.setIndex(index);
    return shape;
  }
  const RINGS = 56, AROUND = 160;
  const lower = [];
  // The gradient is outward and downward.
  for (let k = 0; k <= RINGS; k++) {
    const rho = k / RINGS, q = rim * rho * rho, root = Math.sqrt(1 - q * perC);
    lower.push([rho, 1 - q / (1 + root), (rim * rho) / root, 1]);
  }
  const edge = [];
  const round = 0.025;
  for (let k = 0; k <= 10; k++) {
    const angle = (Math.PI * k) / 10;
    edge.push([1 + round * Math.sin(angle), 1 - rise - (lip * (1 - Math.cos(angle))) / 2,
      Math.sin(angle) / round, Math.cos(angle) / (lip / 2)]);
  }
  const upper = [];
  for (let k = 24; k >= 0; k--) upper.push([k / 24, deckAt(k / 24), (2 * dome * k) / 24, -1]);

  // A mesh; its edges are sharp where the triangles of a corner differ by more than CREASE.
  const CREASE = Math.cos((40 * Math.PI) / 180);
  function meshShape({ vertices, faces }) {
    const corner = (i) => new T.Vector3().fromArray(vertices, 3 * i);
    const normals = [], around = Array.from({ length: vertices.length / 3 }, () => []);
    for (let f = 0; f < faces.length / 3; f++) {
      const [a, b, d] = [0, 1, 2].map((k) => corner(faces[3 * f + k]));
      normals.push(b.sub(a).cross(d.sub(a)));
      for (let k = 0; k < 3; k++) around[faces[3 * f + k]].push(f);
    }
    // Triangles that look up are painted as a deck; z points down.
    const deck = [], bottom = [];
    normals.forEach((n, f) => (n.z < -0.9 * n.length() ? deck : bottom).push(f));
    const position = [], normal = [];
    for (const f of [...bottom, ...deck]) {
      for (let k = 0; k < 3; k++) {
        const i = faces[3 * f + k], sum = new T.Vector3();
        for (const other of around[i]) {
          const cosine = normals[other].dot(normals[f]);
          if (cosine >= CREASE * normals[other].length() * normals[f].length()) sum.add(normals[other]);
        }
        position.push(...vertices.subarray(3 * i, 3 * i + 3));
        normal.push(...sum.normalize().toArray());
      }
    }
    const shape = new T.BufferGeometry();
    shape.setAttribute("position", new T.BufferAttribute(new Float32Array(position), 3));
    shape.setAttribute("normal", new T.BufferAttribute(new Float32Array(normal), 3));
    shape.addGroup(0, 3 * bottom.length, 0);
    shape.addGroup(3 * bottom.length, 3 * deck.length, 1);
    return shape;
  }
  // Half of its extent across and along the axes of curvature, and its highest point.
  if (mesh) {
    short = long = dome = 0;
    top = Infinity;
    for (let i = 0; i < mesh.vertices.length; i += 3) {
      const [x, y, z] = mesh.vertices.subarray(i, i + 3);
      short = Math.max(short, Math.abs(c * x + s * y));
      long = Math.max(long, Math.abs(-s * x + c * y));
      top = Math.min(top, z);
    }
  }

  const scene = new T.Scene();
  const solid = new T.Group();
  scene.add(solid);
  const hullPaint = new T.MeshPhysicalMaterial({ roughness: 0.42, clearcoat: 0.7,
    clearcoatRoughness: 0.18, side: T.DoubleSide });
  const deckPaint = new T.MeshPhysicalMaterial({ roughness: 0.6, clearcoat: 0.25,
    clearcoatRoughness: 0.4, side: T.DoubleSide });
  const lowerMesh = mesh ? new T.Mesh(meshShape(mesh), [hullPaint, deckPaint])
    : new T.Mesh(hull(lower, AROUND), hullPaint);
  const parts = [lowerMesh];
  if (!mesh) {
    parts.push(new T.Mesh(hull(edge, AROUND), hullPaint), new T.Mesh(hull(upper, AROUND), deckPaint));
  }
  const inertiaPaint = new T.MeshStandardMaterial({ roughness: 0.55, side: T.DoubleSide });
  const curvaturePaint = new T.MeshStandardMaterial({ roughness: 0.55, side: T.DoubleSide });
  // A stripe on the deck along a direction, from `from` to `to` of its reach.
  function stripe(angle, broad, from, to, lift, paint) {
    const dx = Math.cos(angle), dy = Math.sin(angle);
    const u = c * dx + s * dy, v = -s * dx + c * dy;
    const reach = 1 / Math.hypot(u / short, v / long);
    const position = [], index = [];
    const COUNT = 20;
    for (let k = 0; k <= COUNT; k++) {
      const along = reach * (from + ((to - from) * k) / COUNT);
      for (const side of [-0.5, 0.5]) {
        const x = along * dx - side * broad * dy, y = along * dy + side * broad * dx;
        const rho = Math.hypot((c * x + s * y) / short, (-s * x + c * y) / long);
        position.push(x, y, deckAt(Math.min(rho, 1)) - lift);
      }
      if (k) index.push(2 * k - 2, 2 * k - 1, 2 * k, 2 * k - 1, 2 * k + 1, 2 * k);
    }
    const shape = new T.BufferGeometry();
    shape.setAttribute("position", new T.BufferAttribute(new Float32Array(position), 3));
    shape.setIndex(index);
    shape.computeVertexNormals();
    return new T.Mesh(shape, paint);
  }
  const broad = 0.055 * short;
  parts.push(stripe(Math.PI / 2, broad * 1.5, -0.94, 0.94, 0.012 * rise, inertiaPaint));
  const DASHES = 15;
  for (let k = 0; k < DASHES; k++) {
    const from = -0.94 + (1.88 * k) / DASHES;
    parts.push(stripe(Math.PI / 2 + body.xi, broad * 1.5, from, from + 1.13 / DASHES, 0.02 * rise,
      curvaturePaint));
  }
  for (const part of parts) {
    part.castShadow = true;
    part.receiveShadow = part.material !== hullPaint;
    solid.add(part);
  }

  // -------------------------------------------------------------- plane, shadow, light
  const span = Math.max(long, 2);
  const tile = span > 10 ? 5 : 2;
  const extent = tile * Math.ceil((14 * span) / tile);
  const pattern = document.createElement("canvas");
  pattern.width = pattern.height = 256;
  const grid = new T.CanvasTexture(pattern);
  grid.wrapS = grid.wrapT = T.RepeatWrapping;
  grid.repeat.set((2 * extent) / tile, (2 * extent) / tile);
  grid.anisotropy = renderer.capabilities.getMaxAnisotropy();
  grid.colorSpace = T.SRGBColorSpace;
  const floor = new T.Mesh(new T.PlaneGeometry(2 * extent, 2 * extent),
    new T.MeshStandardMaterial({ map: grid, roughness: 1 }));
  floor.receiveShadow = true;
  scene.add(floor);
  scene.fog = new T.Fog(0, 4 * span, 13 * span);

  const blot = document.createElement("canvas");
  blot.width = blot.height = 128;
  const pen = blot.getContext("2d");
  const fade = pen.createRadialGradient(64, 64, 2, 64, 64, 64);
  fade.addColorStop(0, "rgba(0,0,0,0.62)");
  fade.addColorStop(0.25, "rgba(0,0,0,0.36)");
  fade.addColorStop(0.6, "rgba(0,0,0,0.1)");
  fade.addColorStop(1, "rgba(0,0,0,0)");
  pen.fillStyle = fade;
  pen.fillRect(0, 0, 128, 128);
  const shade = new T.Mesh(new T.PlaneGeometry(1, 1), new T.MeshBasicMaterial({
    map: new T.CanvasTexture(blot), transparent: true, depthWrite: false, toneMapped: false }));
  shade.scale.set(2.1 * short, 1.7 * long, 1);
  shade.renderOrder = 1;
  scene.add(shade);

  const sky = new T.HemisphereLight(0xf4f7ff, 0xb0a898, 1.75);
  sky.position.set(0, 0, 1);
  scene.add(sky);
  const key = new T.DirectionalLight(0xfff2de, 1.9);
  const lamp = new T.Vector3(-0.9, -0.7, 1.9).multiplyScalar(2 * span);
  key.castShadow = true;
  key.shadow.mapSize.set(2048, 2048);
  key.shadow.radius = 5;
  key.shadow.bias = -0.0006;
  key.shadow.normalBias = 0.02;
  Object.assign(key.shadow.camera, { left: -1.4 * span, right: 1.4 * span, top: 1.4 * span,
    bottom: -1.4 * span, near: 0.1 * span, far: 8 * span });
  scene.add(key, key.target);
  const fill = new T.DirectionalLight(0xdce8ff, 0.8);
  fill.position.set(1, -0.2, 0.25);
  scene.add(fill);

  // -------------------------------------------------------------- trace of the contact
  const POINTS = 720;
  const ribbon = new T.BufferGeometry();
  const corners = new Float32Array(POINTS * 6), colours = new Float32Array(POINTS * 8);
  ribbon.setAttribute("position", new T.BufferAttribute(corners, 3));
  ribbon.setAttribute("color", new T.BufferAttribute(colours, 4));
  const faces = [];
  for (let k = 0; k + 1 < POINTS; k++) {
    faces.push(2 * k, 2 * k + 1, 2 * k + 2, 2 * k + 1, 2 * k + 3, 2 * k + 2);
  }
  ribbon.setIndex(faces);
  const ink = { vertexColors: true, transparent: true, depthWrite: false, side: T.DoubleSide,
    toneMapped: false, fog: false };
  const onFloor = new T.Mesh(ribbon, new T.MeshBasicMaterial(ink));
  onFloor.renderOrder = 2;
  // The same once more through the body, which would hide most of it.
  const FAINT = 0.3;
  const through = new T.Mesh(ribbon, new T.MeshBasicMaterial({ ...ink, depthTest: false, opacity: FAINT }));
  through.renderOrder = 5;
  const spot = new T.Mesh(new T.CircleGeometry(0.055 * short, 24), new T.MeshBasicMaterial({
    depthTest: false, transparent: true, toneMapped: false, fog: false }));
  spot.renderOrder = 6;
  for (const one of [onFloor, through]) {
    one.frustumCulled = false;
    scene.add(one);
  }
  scene.add(spot);
  const line = new Float64Array(2 * POINTS);
  const tint = new T.Color(), slipTint = new T.Color();
  // Index of the last slide that has begun at a time, -1 before the first.
  function slideAt(t) {
    let low = 0, high = slides.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (slides[middle][0] <= t) low = middle + 1; else high = middle;
    }
    return low - 1;
  }
  function drawTrace(t, trace) {
    const from = Math.max(start, t - trail);
    for (let k = 0; k < POINTS; k++) trace(from + ((t - from) * k) / (POINTS - 1), line, 2 * k);
    const half = 0.028 * short;
    let nx = 1, ny = 0;
    let slide = slideAt(from);
    for (let k = 0; k < POINTS; k++) {
      const i = 2 * Math.max(k - 1, 0), j = 2 * Math.min(k + 1, POINTS - 1);
      const dx = line[j] - line[i], dy = line[j + 1] - line[i + 1];
      const size = Math.hypot(dx, dy);
      if (size > 1e-9) { nx = -dy / size; ny = dx / size; }
      const age = k / (POINTS - 1);
      const time = from + (t - from) * age;
      while (slide + 1 < slides.length && slides[slide + 1][0] <= time) slide++;
      const colour = slide >= 0 && time <= slides[slide][1] ? slipTint : tint;
      const wide = half * (0.35 + 0.65 * age);
      for (const side of [0, 1]) {
        const sign = side ? 1 : -1, v = 3 * (2 * k + side);
        corners[v] = line[2 * k] + sign * wide * nx;
        corners[v + 1] = line[2 * k + 1] + sign * wide * ny;
        corners[v + 2] = 0.004 * rise;
        colours.set([colour.r, colour.g, colour.b, age * age * 0.95], 4 * (2 * k + side));
      }
    }
    ribbon.attributes.position.needsUpdate = ribbon.attributes.color.needsUpdate = true;
  }

  // -------------------------------------------------------------- camera
  const camera = new T.PerspectiveCamera(36, 1, 0.05 * span, 60 * span);
  camera.up.set(0, 0, 1);
  const orbit = new T.OrbitControls(camera, canvas);
  orbit.enablePan = false;
  orbit.minDistance = 0.6 * span;
  orbit.maxDistance = 9 * span;
  orbit.minPolarAngle = 0.02;
  orbit.maxPolarAngle = Math.PI / 2 - 0.02;
  orbit.addEventListener("change", changed);
  const target = new T.Vector3(0, 0, 0.5);
  let seen = false;
  function reset() {
    // Far enough for the whole body, also where the picture is narrow.
    const away = span * Math.max(2.9, 3.5 / Math.max(camera.aspect, 0.3));
    orbit.target.copy(target);
    camera.position.set(0.72, -0.5, 0.62).normalize().multiplyScalar(away).add(target);
    orbit.update();
    changed();
  }
  const offset = new T.Vector3();
  function turn(right, up) {
    offset.copy(camera.position).sub(orbit.target);
    const away = offset.length();
    const azimuth = Math.atan2(offset.y, offset.x) + 0.09 * right;
    const height = Math.asin(offset.z / away) + 0.07 * up;
    const lifted = Math.min(Math.max(height, Math.PI / 2 - orbit.maxPolarAngle), Math.PI / 2 - 0.021);
    camera.position.set(Math.cos(azimuth) * Math.cos(lifted), Math.sin(azimuth) * Math.cos(lifted),
      Math.sin(lifted)).multiplyScalar(away).add(orbit.target);
    orbit.update();
    changed();
  }
  function zoom(factor) {
    offset.copy(camera.position).sub(orbit.target);
    const away = Math.min(Math.max(offset.length() * factor, orbit.minDistance), orbit.maxDistance);
    camera.position.copy(orbit.target).add(offset.setLength(away));
    orbit.update();
    changed();
  }

  // -------------------------------------------------------------- what the page calls
  function paint() {
    const css = getComputedStyle(document.documentElement);
    const colour = (name) => css.getPropertyValue(`--${name}`).trim();
    const g = pattern.getContext("2d");
    g.fillStyle = colour("floor");
    g.fillRect(0, 0, 256, 256);
    g.strokeStyle = colour("grid");
    g.lineWidth = 3;
    g.strokeRect(0, 0, 256, 256);
    grid.needsUpdate = true;
    scene.background = new T.Color(colour("sky"));
    scene.fog.color.set(colour("sky"));
    hullPaint.color.set(colour("hull"));
    deckPaint.color.set(colour("deck"));
    inertiaPaint.color.set(colour("pitch"));
    curvaturePaint.color.set(colour("spin"));
    tint.set(colour("roll"));
    spot.material.color.copy(tint);
    slipTint.set(colour("slip"));
  }
  function resize() {
    const { clientWidth: w, clientHeight: h } = canvas;
    if (!w || !h) return;
    renderer.setPixelRatio(Math.min(devicePixelRatio || 1, 2));
    renderer.setSize(w, h, false);
    camera.aspect = w / h;
    camera.updateProjectionMatrix();
    if (!seen) { seen = true; reset(); }
  }
  function draw(pose, state, trace) {
    const { q, centre, contact } = pose;
    solid.quaternion.set(q[1], q[2], q[3], q[0]);
    solid.position.set(centre[0], centre[1], centre[2]);
    if (state.follow) {
      offset.set(centre[0], centre[1], 0.5).sub(target);
      target.add(offset);
      orbit.target.add(offset);
      camera.position.add(offset);
      camera.lookAt(orbit.target);
    }
    shade.position.set(contact[0], contact[1], 0.002 * rise);
    // Along the body's y axis as seen from above.
    shade.rotation.z = Math.atan2(1 - 2 * (q[1] * q[1] + q[3] * q[3]), 2 * (q[1] * q[2] - q[0] * q[3]))
      - Math.PI / 2;
    spot.position.set(contact[0], contact[1], 0.005 * rise);
    key.position.copy(lamp).add(solid.position);
    key.target.position.set(centre[0], centre[1], 0);
    floor.position.set(tile * Math.round(centre[0] / tile), tile * Math.round(centre[1] / tile), 0);
    if (hullPaint.transparent !== state.glass) {
      for (const paintOf of [hullPaint, deckPaint]) {
        paintOf.transparent = state.glass;
        paintOf.opacity = state.glass ? 0.28 : 1;
        paintOf.depthWrite = !state.glass;
        paintOf.needsUpdate = true;
      }
      through.material.opacity = state.glass ? 0.8 : FAINT;
    }
    drawTrace(state.t, trace);
    renderer.render(scene, camera);
  }
  canvas.addEventListener("webglcontextlost", (e) => e.preventDefault());
  canvas.addEventListener("webglcontextrestored", changed);
  return { draw, resize, paint, reset, turn, zoom, camera, solid, lower: lowerMesh, orbit };
}
