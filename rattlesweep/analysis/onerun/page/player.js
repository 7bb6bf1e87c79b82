"use strict";
// The player: data, time, controls, the spin curve and the numbers beside it.
(() => {
  const get = (id) => document.getElementById(id);
  const D = JSON.parse(get("data").textContent);
  const buffer = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer;
  const floats = (text) => new Float32Array(buffer(text));
  const names = D.columns;
  const width = names.length;
  const table = floats(D.table);
  const theory = floats(D.theory);
  const rows = table.length / width;
  const tStart = D.start;
  const tEnd = tStart + D.step * (rows - 1);
  const at = Object.fromEntries(names.map((name, k) => [name, k]));

  // Hermite's cubic through the rows, with slopes from four neighbours: what moves has no corners at
  // any speed, and slips twenty times less than with slopes from two.
  const row = new Float64Array(width);
  function sample(t, out = row, first = 0, last = width) {
    const x = Math.min(Math.max((t - tStart) / D.step, 0), rows - 1);
    const i = Math.min(Math.floor(x), Math.max(rows - 2, 0));
    const f = x - i;
    const f2 = f * f, f3 = f2 * f;
    const a = 2 * f3 - 3 * f2 + 1, b = f3 - 2 * f2 + f, c = 3 * f2 - 2 * f3, d = f3 - f2;
    const one = i * width, two = Math.min(i + 1, rows - 1) * width;
    const zero = i > 0 ? one - width : -1, three = i + 2 < rows ? two + width : -1;
    const inner = i > 1 && i + 3 < rows;
    for (let k = first; k < last; k++) {
      const y1 = table[one + k], y2 = table[two + k];
      // Beyond the ends the curve goes on straight.
      const y0 = zero < 0 ? 2 * y1 - y2 : table[zero + k];
      const y3 = three < 0 ? 2 * y2 - y1 : table[three + k];
      let left = (y2 - y0) / 2, right = (y3 - y1) / 2;
      if (inner) {
        left = (16 * left - y3 + table[zero - width + k]) / 12;
        right = (16 * right - table[three + width + k] + y0) / 12;
      }
      out[k] = a * y1 + b * left + c * y2 + d * right;
    }
    return out;
  }

  // Attitude (scalar first), contact point on the plane, centre of mass: the body touches the plane
  // at the lowest point of its surface, at every time and not at the rows alone.
  const b = D.body;
  const cos = Math.cos(b.xi), sin = Math.sin(b.xi);
  const bxx = (cos * cos) / b.theta + (sin * sin) / b.phi;
  const bxy = (-sin * cos * (b.theta - b.phi)) / (b.theta * b.phi);
  const byy = (sin * sin) / b.theta + (cos * cos) / b.phi;
  function pose(t, out = { q: [0, 0, 0, 0], contact: [0, 0, 0], centre: [0, 0, 0] }) {
    const y = sample(t);
    let [q0, q1, q2, q3] = [y[at.q0], y[at.q1], y[at.q2], y[at.q3]];
    const size = Math.hypot(q0, q1, q2, q3);
    q0 /= size; q1 /= size; q2 /= size; q3 /= size;
    // The vertical in the body's frame is the last row of the turn.
    const ux = 2 * (q1 * q3 - q0 * q2), uy = 2 * (q2 * q3 + q0 * q1);
    const uz = 1 - 2 * (q1 * q1 + q2 * q2);
    const p = ux / uz, q = uy / uz;
    let rx = bxx * p + bxy * q, ry = bxy * p + byy * q;
    // An ellipsoid of vertical semi-axis c is narrower than the paraboloid by the factor 1 / root.
    const square = rx * p + ry * q, root = b.c ? Math.sqrt(1 + square / b.c) : 1;
    const rz = 1 - square / (root * (1 + root));
    rx /= root;
    ry /= root;
    const [cx, cy] = [y[at.trace_x], y[at.trace_y]];
    out.q[0] = q0; out.q[1] = q1; out.q[2] = q2; out.q[3] = q3;
    out.contact[0] = cx; out.contact[1] = cy;
    out.centre[0] = cx - ((1 - 2 * (q2 * q2 + q3 * q3)) * rx + 2 * (q1 * q2 - q0 * q3) * ry
      + 2 * (q1 * q3 + q0 * q2) * rz);
    out.centre[1] = cy - (2 * (q1 * q2 + q0 * q3) * rx + (1 - 2 * (q1 * q1 + q3 * q3)) * ry
      + 2 * (q2 * q3 - q0 * q1) * rz);
    out.centre[2] = -(ux * rx + uy * ry + uz * rz);
    return out;
  }
  const contact = new Float64Array(width);
  function trace(t, out, place) {
    sample(t, contact, at.trace_x, at.trace_y + 1);
    out[place] = contact[at.trace_x];
    out[place + 1] = contact[at.trace_y];
  }

  // ---------------------------------------------------------------- state
  const still = matchMedia("(prefers-reduced-motion: reduce)");
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const SLOWEST = 1, FASTEST = 200;
  const state = {
    t: tStart, playing: false, speed: D.speed, follow: true, glass: false, frames: 0, busy: 0, longest: 0,
  };
  let dirty = true;
  const solid = D.solid && { vertices: floats(D.solid.vertices), faces: new Uint16Array(buffer(D.solid.faces)) };
  const scene = makeScene(get("view"), { body: b, solid, rise: D.rise, trail: D.trail,
    start: tStart, slides: D.slides,
    changed: () => { dirty = true; } });
  if (scene.error) {
    get("message").textContent = scene.error;
    get("message").hidden = false;
    get("view").hidden = get("legend").hidden = true;
    for (const id of ["follow", "glass", "reset"]) get(id).disabled = true;
  }

  // ---------------------------------------------------------------- numbers
  const fixed = (value, digits) => value.toFixed(digits).replace("-", "−");
  const plain = (value) => String(Number(value.toPrecision(4))).replace("-", "−");
  // Units in which times and spins are shown: their sizes and their names.
  const [second, timeUnit] = D.units.t, [turn, spinUnit] = D.units.n;
  document.querySelectorAll(".time-unit").forEach((e) => { e.textContent = timeUnit; });
  document.querySelectorAll(".spin-unit").forEach((e) => { e.textContent = spinUnit; });
  const places = Math.min(2, Math.max(0, 5 - Math.ceil(Math.log10(tEnd * second)) - (second === 1)));
  const spinPlaces = turn === 1 ? 4 : 2;
  const shares = ["spin", "pitch", "roll", "lost"];
  const bars = shares.map((name) => document.querySelector(`#bar .${name}`));
  const percents = shares.map((name) => get(`share-${name}`));
  const scrub = get("scrub");
  scrub.min = tStart;
  scrub.max = tEnd;
  function write(out, text) { if (out.textContent !== text) out.textContent = text; }
  function numbers() {
    const y = sample(state.t);
    const n = y[at.n];
    write(get("t"), fixed(state.t * second, places));
    write(get("n"), fixed(n * turn, spinPlaces));
    const unsteady = n * -b.xi > 0;
    write(get("way"), `${n > 0 ? "counterclockwise" : "clockwise"}, the `
      + `${unsteady ? "unsteady" : "steady"} direction`);
    const pitch = Math.max(0, y[at.E_p]) / D.energy, roll = Math.max(0, y[at.E_r]) / D.energy;
    const left = D.lossy ? y[at.energy] / D.energy : 1;
    const parts = [Math.max(0, left - pitch - roll), pitch, roll, Math.max(0, 1 - left)];
    const sum = parts.reduce((whole, part) => whole + part);
    parts.forEach((part, k) => {
      bars[k].style.width = `${(100 * part) / sum}%`;
      write(percents[k], `${fixed((100 * part) / sum, 1)} %`);
    });
    get("bar").setAttribute("aria-label",
      shares.map((name, k) => `${name} ${percents[k].textContent}`).join(", "));
    scrub.value = state.t;
    scrub.setAttribute("aria-valuetext", `time ${get("t").textContent}, spin ${get("n").textContent}`);
    cursor(state.t, n);
  }

  // ---------------------------------------------------------------- the curve
  const canvas = get("curve");
  const box = { left: 46, right: 8, top: 8, bottom: 24 };
  let most = 0;
  for (let i = 0; i < rows; i++) most = Math.max(most, Math.abs(table[i * width + at.n]));
  for (const value of theory) most = Math.max(most, Math.abs(value));
  most *= 1.08;
  const chart = { width: 1, height: 1, x: (t) => t, y: (n) => n };
  const nice = (span, count) => {
    const raw = span / count, ten = 10 ** Math.floor(Math.log10(raw));
    return ten * [1, 2, 5, 10].find((m) => m * ten >= raw * 0.999);
  };
  function curve() {
    const ratio = Math.min(devicePixelRatio || 1, 3);
    const { clientWidth: w, clientHeight: h } = get("chart");
    if (!w || !h) return;
    Object.assign(chart, { width: w, height: h,
      x: (t) => box.left + ((t - tStart) / (tEnd - tStart)) * (w - box.left - box.right),
      y: (n) => box.top + (0.5 - n / (2 * most)) * (h - box.top - box.bottom) });
    canvas.width = Math.round(w * ratio);
    canvas.height = Math.round(h * ratio);
    const g = canvas.getContext("2d");
    g.scale(ratio, ratio);
    const css = getComputedStyle(document.documentElement);
    const ink = (name) => css.getPropertyValue(`--${name}`).trim();
    g.font = `11px ${getComputedStyle(document.body).fontFamily}`;
    g.lineWidth = 1;
    g.fillStyle = ink("slipping");
    for (const [begin, end] of D.slides) {
      const x = chart.x(Math.max(begin, tStart));
      g.fillRect(x, box.top, Math.max(chart.x(end) - x, 0.5), h - box.top - box.bottom);
    }
    const step = nice(2 * most * turn, 5) / turn;
    g.textAlign = "right";
    g.textBaseline = "middle";
    for (let k = -Math.floor(most / step); k * step <= most; k++) {
      const y = Math.round(chart.y(k * step)) + 0.5;
      g.strokeStyle = ink(k === 0 ? "soft" : "line");
      g.beginPath(); g.moveTo(box.left, y); g.lineTo(w - box.right, y); g.stroke();
      g.fillStyle = ink("soft");
      g.fillText(plain(k * step * turn), box.left - 6, y);
    }
    const tick = nice((tEnd - tStart) * second, 4) / second;
    g.textBaseline = "top";
    for (let t = Math.ceil(tStart / tick) * tick; t <= tEnd * 1.0001; t += tick) {
      const label = plain(t * second), half = g.measureText(label).width / 2;
      g.textAlign = "center";
      g.fillText(label, Math.min(chart.x(t), w - half), h - box.bottom + 8);
    }
    g.strokeStyle = ink("soft");
    g.setLineDash([2, 3]);
    const marks = D.reversals.length <= 12 ? D.reversals : D.reversals.slice(0, 1);
    for (const t of marks) {
      const x = Math.round(chart.x(t)) + 0.5;
      g.beginPath(); g.moveTo(x, box.top); g.lineTo(x, h - box.bottom); g.stroke();
    }
    // Each column of pixels from its least to its largest value.
    g.setLineDash([]);
    g.strokeStyle = ink("spin");
    g.lineWidth = 1.6;
    g.lineJoin = "round";
    g.beginPath();
    let pixel = -1, low = 0, high = 0;
    const flush = (x) => { g.lineTo(x, chart.y(low)); g.lineTo(x, chart.y(high)); };
    for (let i = 0; i < rows; i++) {
      const value = table[i * width + at.n];
      const x = Math.round(chart.x(tStart + i * D.step) * 2) / 2;
      if (x !== pixel) {
        if (pixel < 0) g.moveTo(x, chart.y(value)); else flush(pixel);
        pixel = x; low = high = value;
      }
      low = Math.min(low, value); high = Math.max(high, value);
    }
    flush(pixel);
    g.stroke();
    g.strokeStyle = ink("theory");
    g.setLineDash([5, 4]);
    g.lineWidth = 1.3;
    g.beginPath();
    theory.forEach((value, k) => g.lineTo(chart.x(tStart + ((tEnd - tStart) * k) / (theory.length - 1)), chart.y(value)));
    g.stroke();
  }
  function cursor(t, n) {
    get("cursor").style.transform = `translateX(${chart.x(t)}px)`;
    get("dot").style.transform = `translate(${chart.x(t)}px, ${chart.y(n)}px)`;
  }
  const count = D.reversals.length;
  const said = count === 0 ? "no reversal" : count === 1
    ? `turn at ${plain(D.reversals[0] * second)} ${timeUnit}`
    : `${count} turns, the first at ${plain(D.reversals[0] * second)} ${timeUnit}`;
  canvas.setAttribute("aria-label",
    `Spin over time, from ${plain(table[at.n])} at time ${plain(tStart)} to time ${plain(tEnd)}: ${said}`);
  if (count) {
    get("mark").hidden = false;
    get("mark").querySelector("span").textContent = said;
  }
  for (const id of ["slip", "slipping"]) get(id).hidden = !D.slides.length;
  get("lost").hidden = !D.lossy;
  for (const [name, value] of D.facts) {
    const line = document.createElement("div");
    for (const [tag, text] of [["dt", name], ["dd", value]]) {
      const cell = document.createElement(tag);
      cell.textContent = text;
      line.append(cell);
    }
    get("facts").append(line);
  }

  // ---------------------------------------------------------------- controls
  const speedOf = (x) => SLOWEST * (FASTEST / SLOWEST) ** x;
  const show = (button, on) => button.setAttribute("aria-pressed", String(on));
  function setPlaying(on) {
    if (on && state.t >= tEnd) state.t = tStart;
    state.playing = on;
    get("icon").setAttribute("d", on ? "M6 4h4v16H6zM14 4h4v16h-4z" : "M7 4l13 8-13 8z");
    get("play").setAttribute("aria-label", on ? "Pause" : "Play");
    dirty = true;
  }
  function goTo(t) {
    state.t = Math.min(Math.max(t, tStart), tEnd);
    dirty = true;
  }
  function setSpeed(speed) {
    state.speed = Math.min(Math.max(speed, SLOWEST), FASTEST);
    get("speed").value = Math.log(state.speed / SLOWEST) / Math.log(FASTEST / SLOWEST);
    const shown = state.speed * second;
    const text = `${shown < 10 ? shown.toFixed(second === 1 ? 1 : 2) : shown.toFixed(0)} ${timeUnit}`;
    get("rate").textContent = `${text} per s`;
    get("speed").setAttribute("aria-valuetext", `${text} per second`);
  }
  function setFollow(on) { state.follow = on; show(get("follow"), on); dirty = true; }
  function setGlass(on) { state.glass = on; show(get("glass"), on); dirty = true; }
  function reset() { scene.reset(); setFollow(true); }
  get("play").addEventListener("click", () => setPlaying(!state.playing));
  scrub.addEventListener("input", () => goTo(scrub.valueAsNumber));
  get("speed").addEventListener("input", (e) => setSpeed(speedOf(e.target.valueAsNumber)));
  get("follow").addEventListener("click", () => setFollow(!state.follow));
  get("glass").addEventListener("click", () => setGlass(!state.glass));
  get("reset").addEventListener("click", reset);
  const point = (e) => {
    const x = e.clientX - get("chart").getBoundingClientRect().left;
    goTo(tStart + ((tEnd - tStart) * (x - box.left)) / (chart.width - box.left - box.right));
  };
  get("chart").addEventListener("pointerdown", (e) => {
    get("chart").setPointerCapture(e.pointerId);
    point(e);
  });
  get("chart").addEventListener("pointermove", (e) => { if (e.buttons & 1) point(e); });
  const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
  addEventListener("keydown", (e) => {
    if (e.ctrlKey || e.metaKey || e.altKey) return;
    const on = e.target;
    const speed = on === get("speed");
    const view = on === get("view");
    let done = true;
    if (e.key === " ") {
      // A button in focus is pressed by the browser itself.
      if (on.closest("button, summary")) return;
      setPlaying(!state.playing);
    } else if (e.key in arrows && (e.shiftKey || view)) scene.turn(...arrows[e.key]);
    else if ((e.key === "ArrowLeft" || e.key === "ArrowRight") && !speed) {
      goTo(state.t + arrows[e.key][0] * state.speed);
    } else if (e.key === "Home" && !speed) goTo(tStart);
    else if (e.key === "End" && !speed) goTo(tEnd);
    else if (e.key === ",") setSpeed(state.speed / 1.25);
    else if (e.key === ".") setSpeed(state.speed * 1.25);
    else if (e.key === "+" || e.key === "=") scene.zoom(1 / 1.15);
    else if (e.key === "-") scene.zoom(1.15);
    else if (e.key.toLowerCase() === "f") setFollow(!state.follow);
    else if (e.key.toLowerCase() === "x") setGlass(!state.glass);
    else if (e.key.toLowerCase() === "r") reset();
    else done = false;
    if (done) e.preventDefault();
  });

  // ---------------------------------------------------------------- frames
  const now = pose(0);
  function draw() {
    pose(state.t, now);
    numbers();
    scene.draw(now, state, trace);
  }
  let last = 0;
  function frame(time) {
    requestAnimationFrame(frame);
    // A tab that slept does not leap.
    const passed = Math.min((time - last) / 1000, 0.1);
    last = time;
    if (state.playing) {
      goTo(state.t + passed * state.speed);
      if (state.t >= tEnd) setPlaying(false);
    }
    if (!dirty) return;
    dirty = false;
    const start = performance.now();
    draw();
    const spent = performance.now() - start;
    state.frames += 1;
    state.busy += spent;
    state.longest = Math.max(state.longest, spent);
  }
  function resize() {
    curve();
    scene.resize();
    dirty = true;
  }
  new ResizeObserver(resize).observe(document.querySelector("main"));
  const repaint = () => { scene.paint(); resize(); };
  dark.addEventListener("change", repaint);
  setSpeed(state.speed);
  repaint();
  draw();
  setPlaying(!still.matches);
  // For a console, and for whoever checks what is drawn.
  globalThis.show = { data: D, state, pose, scene, goTo, setPlaying, rows, tEnd };
  requestAnimationFrame((time) => { last = time; frame(time); });
})();
