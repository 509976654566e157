// Normals: their colours to read, or the surface lit anew by Lambert's law from wherever the pointer or the arrow keys put the light.
(() => {
  const encode = Uint8Array.from({ length: 4096 }, (_, i) => {
    const x = i / 4095;
    return Math.round(255 * (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055));
  });
  const decode = Float32Array.from({ length: 256 }, (_, i) => (i / 255 <= 0.04045 ? i / 255 / 12.92 : ((i / 255 + 0.055) / 1.055) ** 2.4));
  const OCTAHEDRON = 4094;

  // Unit vectors of octahedral codes: a plane of u, then one of v; a zero vector where the code is 0.
  function vectors(codes, n) {
    const out = new Float32Array(3 * n);
    for (let i = 0; i < n; i++) {
      if (!codes[i]) continue;
      let x = (2 * (codes[i] - 1)) / OCTAHEDRON - 1;
      let y = (2 * (codes[n + i] - 1)) / OCTAHEDRON - 1;
      const z = 1 - Math.abs(x) - Math.abs(y);
      if (z < 0) [x, y] = [(1 - Math.abs(y)) * (x < 0 ? -1 : 1), (1 - Math.abs(x)) * (y < 0 ? -1 : 1)];
      const length = Math.hypot(x, y, z);
      out.set([x / length, y / length, z / length], 3 * i);
    }
    return out;
  }

  async function albedoOf(figure, header) {
    const picture = figure.querySelector("img.albedo");
    if (!picture) return null;
    await picture.decode();
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [header.width, header.height];
    const context = canvas.getContext("2d", { willReadFrequently: true });
    context.drawImage(picture, 0, 0);
    return context.getImageData(0, 0, header.width, header.height).data;
  }

  for (const figure of document.querySelectorAll("figure.normals")) {
    const header = packed.header(figure);
    const pane = figure.querySelector(".pane");
    const context = figure.querySelector("canvas").getContext("2d", { willReadFrequently: true });
    const reading = figure.querySelector(".reading");
    const spot = figure.querySelector(".spot");
    const dial = figure.querySelector(".dial");
    const image = new ImageData(header.width, header.height);
    const state = { mode: "normals", x: -0.4, y: 0.4, pixel: null };
    let normals = null;
    let albedo = null;
    let pending = false;

    const light = () => [state.x, state.y, Math.sqrt(Math.max(0, 1 - state.x ** 2 - state.y ** 2))];

    function draw() {
      pending = false;
      const [lx, ly, lz] = light();
      const out = image.data;
      const [red, green, blue] = packed.outside;
      for (let i = 0; i < header.width * header.height; i++) {
        const nx = normals[3 * i];
        const ny = normals[3 * i + 1];
        const nz = normals[3 * i + 2];
        out[4 * i + 3] = 255;
        if (!(nx || ny || nz)) {
          out[4 * i] = red; out[4 * i + 1] = green; out[4 * i + 2] = blue;
        } else if (state.mode === "normals") {
          out[4 * i] = 127.5 * (nx + 1); out[4 * i + 1] = 127.5 * (ny + 1); out[4 * i + 2] = 127.5 * (nz + 1);
        } else {
          const shade = 4095 * Math.max(0, nx * lx + ny * ly + nz * lz);
          for (let c = 0; c < 3; c++) {
            const base = state.mode === "albedo" ? decode[albedo[4 * i + c]] : 1;
            out[4 * i + c] = encode[Math.round(base * shade)];
          }
        }
      }
      context.putImageData(image, 0, 0);
      pane.dataset.state = "drawn";
      say();
    }

    function say() {
      const number = (value) => packed.number(value, 2);
      if (state.mode !== "normals") {
        const [x, y, z] = light();
        const angle = (Math.acos(Math.min(1, z)) * 180) / Math.PI;
        packed.point(dial, x, -y);
        reading.textContent = `light (${number(x)}, ${number(y)}, ${number(z)}), ${packed.quantity(angle, 0, "°")} off the view`;
      } else if (state.pixel) {
        const [column, row] = state.pixel;
        const i = row * header.width + column;
        const [x, y, z] = normals.subarray(3 * i, 3 * i + 3);
        const known = Boolean(x || y || z);
        spot.hidden = !known;
        spot.style.left = `${50 + 48 * x}%`;
        spot.style.top = `${50 - 48 * y}%`;
        const tilt = (Math.acos(Math.min(1, Math.max(-1, z))) * 180) / Math.PI;
        const text = known ? `(${number(x)}, ${number(y)}, ${number(z)}), ${packed.quantity(tilt, 1, "°")} off the view` : "no normal";
        reading.textContent = `${text} at ${packed.place(header, column, row)}`;
      } else reading.textContent = "point at a pixel";
    }

    function later() {
      if (!pending && normals) { pending = true; requestAnimationFrame(draw); }
    }

    function shine(x, y) {
      const length = Math.max(1, Math.hypot(x, y) / 0.985);
      [state.x, state.y] = [x / length, y / length];
      later();
    }

    const toward = (event) => {
      const box = pane.getBoundingClientRect();
      const reach = Math.min(box.width, box.height) / 2;
      shine((event.clientX - box.left - box.width / 2) / reach, (box.top + box.height / 2 - event.clientY) / reach);
    };
    for (const kind of ["pointermove", "pointerdown"]) {
      pane.addEventListener(kind, (event) => { if (state.mode !== "normals") toward(event); });
    }
    pane.addEventListener("keydown", (event) => {
      if (state.mode === "normals" || event.ctrlKey || event.metaKey || event.altKey) return;
      const by = { ArrowLeft: [-0.05, 0], ArrowRight: [0.05, 0], ArrowUp: [0, 0.05], ArrowDown: [0, -0.05] }[event.key];
      if (by) shine(state.x + by[0], state.y + by[1]);
      else if (event.key === "Home") shine(0, 0);
      else return;
      event.preventDefault();
    });
    packed.cursor(pane, header.width, header.height, (column, row) => {
      if (state.mode !== "normals") return;
      state.pixel = [column, row];
      packed.cross(pane, header, column, row);
      say();
    });
    for (const button of figure.querySelectorAll("[data-mode]")) {
      button.addEventListener("click", () => {
        state.mode = button.dataset.mode;
        for (const other of figure.querySelectorAll("[data-mode]")) other.setAttribute("aria-pressed", String(other === button));
        figure.querySelector(".sphere").hidden = state.mode !== "normals";
        dial.toggleAttribute("hidden", state.mode === "normals");
        pane.querySelector(".cross").hidden = state.mode !== "normals" || !state.pixel;
        later();
      });
    }

    Promise.all([packed.codes(figure.querySelector(".values"), 2 * header.height, header.width), albedoOf(figure, header)]).then(([codes, picture]) => {
      normals = vectors(codes, header.width * header.height);
      albedo = picture;
      packed.ruler(pane, header);
      figure.querySelector(".fallback").hidden = true;
      figure.querySelector(".controls").hidden = false;
      draw();
    }).catch((error) => packed.fail(figure, error));
  }
})();
