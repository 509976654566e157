// The measured surface, to turn. Orthographic, so that the ruler holds everywhere; starts with the camera's view (x right, y up,
// z to the viewer). Draws only when something changed.
(() => {
  const figure = document.getElementById("viewer");
  const stage = figure.querySelector(".stage");
  const canvas = figure.querySelector("canvas");
  const ruler = figure.querySelector(".ruler");
  const fallback = figure.querySelector(".fallback");
  const gl = canvas.getContext("webgl2", { antialias: true, alpha: true });
  if (!gl) return;

  const vertexShader = `#version 300 es
    in vec3 position; in vec3 normal; in vec3 colour;
    uniform mat3 turn; uniform vec3 scale; uniform vec2 shift; uniform float rise;
    out vec3 viewNormal; out vec3 ownNormal; out vec3 paint;
    void main() {
      vec3 p = turn * (position * vec3(1.0, 1.0, rise));
      viewNormal = turn * normalize(normal * vec3(rise, rise, 1.0));
      ownNormal = normal; paint = colour;
      gl_Position = vec4(p.xy * scale.xy + shift, -p.z * scale.z, 1.0);
    }`;
  const fragmentShader = `#version 300 es
    precision highp float;
    in vec3 viewNormal; in vec3 ownNormal; in vec3 paint;
    uniform int mode;
    out vec4 result;
    void main() {
      vec3 n = normalize(viewNormal);
      // A sliver of a thinned mesh may be turned over while its normal is right: only where both agree is it the back.
      bool back = !gl_FrontFacing && n.z < 0.0;
      if (back) n = -n;
      // A headlight, and a light from the upper left that shows which way a slope goes.
      float light = 0.04 + 0.56 * max(n.z, 0.0) + 0.48 * max(dot(n, vec3(-0.5, 0.5, 0.70711)), 0.0);
      vec3 base = mode == 1 ? pow(paint, vec3(2.2)) : vec3(0.62, 0.605, 0.575);
      vec3 c = pow(base * light, vec3(1.0 / 2.2));
      if (mode == 2) c = normalize(ownNormal) * 0.5 + 0.5;
      if (back) c = mix(c, vec3(0.25, 0.29, 0.36), 0.75);
      result = vec4(c, 1.0);
    }`;

  const header = JSON.parse(figure.querySelector(".mesh-header").textContent);
  const extent = Math.max(...header.span) || 1;
  const state = { yaw: 0, pitch: 0, zoom: 1, x: 0, y: 0, mode: 0, rise: 1 };
  let locations = null;
  let arrays = null;
  let pending = false;

  async function unpack() {
    const buffer = await packed.inflate(figure.querySelector(".mesh-data"));
    const n = header.vertices;
    let offset = 0;
    const plane = (Type, length) => {
      const part = new Type(buffer, offset, length);
      offset += part.byteLength;
      for (let i = 1; i < length; i++) part[i] += part[i - 1];
      return part;
    };
    const index = plane(Uint32Array, header.triangles * 3);
    const position = new Float32Array(3 * n);
    const normal = new Float32Array(3 * n);
    const colour = new Float32Array(3 * n).fill(0.7);
    for (let axis = 0; axis < 3; axis++) {
      const steps = plane(Uint16Array, n);
      // Centred, and divided by the largest side: numbers near 1 whatever the unit.
      for (let i = 0; i < n; i++) position[3 * i + axis] = (steps[i] / 65535 - 0.5) * (header.span[axis] / extent);
    }
    for (let axis = 0; axis < 3; axis++) {
      const steps = new Int16Array(plane(Uint16Array, n));
      for (let i = 0; i < n; i++) normal[3 * i + axis] = steps[i] / 2047;
    }
    if (header.colours) {
      for (let axis = 0; axis < 3; axis++) {
        const steps = plane(Uint8Array, n);
        for (let i = 0; i < n; i++) colour[3 * i + axis] = steps[i] / 255;
      }
    }
    return { index, position, normal, colour };
  }

  function build() {
    const program = gl.createProgram();
    for (const [type, source] of [[gl.VERTEX_SHADER, vertexShader], [gl.FRAGMENT_SHADER, fragmentShader]]) {
      const shader = gl.createShader(type);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program) || "no program");
    gl.useProgram(program);
    for (const name of ["position", "normal", "colour"]) {
      const place = gl.getAttribLocation(program, name);
      gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ARRAY_BUFFER, arrays[name], gl.STATIC_DRAW);
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, 3, gl.FLOAT, false, 0, 0);
    }
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, arrays.index, gl.STATIC_DRAW);
    gl.enable(gl.DEPTH_TEST);
    locations = Object.fromEntries(["turn", "scale", "shift", "rise", "mode"].map((name) => [name, gl.getUniformLocation(program, name)]));
  }

  // CSS pixels per unit of the normalised mesh: at zoom 1 the front view fills 84 % of the stage, and a deep mesh stays in it when turned.
  function pixels() {
    const [w, h] = [stage.clientWidth, stage.clientHeight];
    const [sx, sy, sz] = header.span.map((side, axis) => (side / extent) * (axis === 2 ? state.rise : 1));
    return 0.84 * state.zoom * Math.min(w / Math.max(sx, sz, 1e-6), h / Math.max(sy, 0.75 * Math.hypot(sy, sz), 1e-6));
  }

  function measure() {
    const factor = header.unit === "m" ? 1000 : 1;
    const perPixel = (extent / pixels()) * factor;
    const power = 10 ** Math.floor(Math.log10(perPixel * 140));
    const length = [5, 2, 1].map((m) => m * power).find((value) => value <= perPixel * 140);
    ruler.hidden = false;
    ruler.querySelector("i").style.width = `${length / perPixel}px`;
    const plain = (value) => String(Number(value.toPrecision(3)));
    const text = header.unit === "m" ? (length >= 1000 ? `${plain(length / 1000)} m` : length < 0.1 ? `${plain(length * 1000)} µm` : `${plain(length)} mm`) : `${plain(length)} ${header.unit}`;
    ruler.querySelector("span").textContent = state.rise === 1 ? text : `${text}, height × ${state.rise}`;
  }

  function draw() {
    pending = false;
    if (!locations || gl.isContextLost()) return;
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const [w, h] = [stage.clientWidth, stage.clientHeight];
    if (!w || !h) return;
    const [W, H] = [Math.round(w * ratio), Math.round(h * ratio)];
    if (canvas.width !== W || canvas.height !== H) { canvas.width = W; canvas.height = H; }
    gl.viewport(0, 0, W, H);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const [cy, sy, cx, sx] = [Math.cos(state.yaw), Math.sin(state.yaw), Math.cos(state.pitch), Math.sin(state.pitch)];
    // Columns of Rx(pitch) Ry(yaw).
    gl.uniformMatrix3fv(locations.turn, false, [cy, sx * sy, -cx * sy, 0, cx, sx, sy, -sx * cy, cx * cy]);
    const p = pixels();
    gl.uniform3f(locations.scale, (2 * p) / w, (2 * p) / h, 1 / (2 * Math.max(1, state.rise)));
    gl.uniform2f(locations.shift, (2 * state.x) / w, (2 * state.y) / h);
    gl.uniform1f(locations.rise, state.rise);
    gl.uniform1i(locations.mode, state.mode);
    gl.drawElements(gl.TRIANGLES, arrays.index.length, gl.UNSIGNED_INT, 0);
    measure();
    stage.dataset.state = "drawn";
  }

  function change(update) {
    Object.assign(state, update);
    state.pitch = Math.min(Math.PI / 2, Math.max(-Math.PI / 2, state.pitch));
    state.zoom = Math.min(40, Math.max(0.3, state.zoom));
    if (!pending) { pending = true; requestAnimationFrame(draw); }
  }

  const VIEWS = { front: { yaw: 0, pitch: 0 }, oblique: { yaw: -0.6, pitch: 0.5 }, side: { yaw: -Math.PI / 2, pitch: 0 } };
  const look = (name) => change({ ...VIEWS[name], zoom: 1, x: 0, y: 0 });

  const pointers = new Map();
  stage.addEventListener("pointerdown", (event) => {
    if (event.button > 0) return;
    stage.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    stage.classList.add("turning");
  });
  stage.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY];
    const [dx, dy] = [now[0] - before[0], now[1] - before[1]];
    if (pointers.size === 2) {
      const other = [...pointers.entries()].find(([id]) => id !== event.pointerId)[1];
      const span = (a) => Math.max(Math.hypot(a[0] - other[0], a[1] - other[1]), 1);
      change({ zoom: (state.zoom * span(now)) / span(before), x: state.x + dx / 2, y: state.y - dy / 2 });
    } else if (event.shiftKey) {
      change({ x: state.x + dx, y: state.y - dy });
    } else {
      change({ yaw: state.yaw + dx * 0.008, pitch: state.pitch + dy * 0.008 });
    }
    pointers.set(event.pointerId, now);
  });
  const release = (event) => {
    pointers.delete(event.pointerId);
    if (!pointers.size) stage.classList.remove("turning");
  };
  stage.addEventListener("pointerup", release);
  stage.addEventListener("pointercancel", release);
  // The wheel belongs to the page until the surface was clicked.
  stage.addEventListener("wheel", (event) => {
    if (document.activeElement !== stage) return;
    event.preventDefault();
    change({ zoom: state.zoom * Math.exp(-Math.sign(event.deltaY) * Math.min(Math.abs(event.deltaY), 100) * 0.002) });
  }, { passive: false });
  stage.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const step = 0.09;
    const update = {
      ArrowLeft: { yaw: state.yaw - step }, ArrowRight: { yaw: state.yaw + step },
      ArrowUp: { pitch: state.pitch - step }, ArrowDown: { pitch: state.pitch + step },
      "+": { zoom: state.zoom * 1.15 }, "=": { zoom: state.zoom * 1.15 }, "-": { zoom: state.zoom / 1.15 },
      Home: { ...VIEWS.front, zoom: 1, x: 0, y: 0 }, 0: { ...VIEWS.front, zoom: 1, x: 0, y: 0 },
    }[event.key];
    if (!update) return;
    event.preventDefault();
    change(update);
  });
  for (const button of figure.querySelectorAll("[data-mode]")) {
    button.addEventListener("click", () => {
      for (const other of figure.querySelectorAll("[data-mode]")) other.setAttribute("aria-pressed", String(other === button));
      change({ mode: Number(button.dataset.mode) });
    });
  }
  for (const button of figure.querySelectorAll("[data-view]")) button.addEventListener("click", () => look(button.dataset.view));
  const rise = figure.querySelector("select");
  rise.addEventListener("change", () => change({ rise: Number(rise.value) }));
  canvas.addEventListener("webglcontextlost", (event) => { event.preventDefault(); locations = null; });
  canvas.addEventListener("webglcontextrestored", () => { build(); change({}); });

  unpack().then((result) => {
    arrays = result;
    build();
    fallback.hidden = true;
    figure.querySelector(".controls").hidden = false;
    new ResizeObserver(() => change({})).observe(stage);
    change({});
  }).catch((error) => {
    fallback.hidden = false;
    fallback.textContent = `The surface cannot be drawn here (${error.message}). The mesh files beside this page hold it.`;
  });
})();
