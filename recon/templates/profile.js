// The height along a line that the reader draws, measured and true.
(() => {
  const [WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM] = [560, 320, 84, 14, 12, 52];

  function element(svg, name, attributes, text) {
    const made = document.createElementNS(svg.namespaceURI, name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    if (text !== undefined) made.textContent = text;
    svg.append(made);
  }

  // Round values (1, 2 or 5 times a power of ten apart) that span lo to hi.
  function ticks(lo, hi, about) {
    const raw = (hi - lo) / about;
    const power = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].map((m) => m * power).find((value) => value >= raw * (1 - 1e-9));
    const [first, last] = [Math.floor(lo / step + 1e-9), Math.ceil(hi / step - 1e-9)];
    const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    return { digits, values: Array.from({ length: last - first + 1 }, (_, i) => (first + i) * step) };
  }

  function chart(svg, along, curves, xTitle, yTitle) {
    svg.replaceChildren();
    const known = curves.flatMap((curve) => curve.filter(Number.isFinite));
    let [lo, hi] = known.length ? [Math.min(...known), Math.max(...known)] : [0, 1];
    if (!(hi > lo)) [lo, hi] = [lo - 0.5, hi + 0.5];
    const length = along[along.length - 1] || 1;
    const [xs, ys] = [ticks(0, length, 6), ticks(lo, hi, 5)];
    const [y0, y1] = [ys.values[0], ys.values[ys.values.length - 1]];
    const base = HEIGHT - BOTTOM;
    const x = (value) => LEFT + (value / length) * (WIDTH - LEFT - RIGHT);
    const y = (value) => base - ((value - y0) / (y1 - y0)) * (base - TOP);
    for (const value of ys.values) {
      element(svg, "path", { class: "grid", d: `M${LEFT} ${y(value)}H${WIDTH - RIGHT}` });
      element(svg, "text", { class: "tick", x: LEFT - 8, y: y(value) + 4, "text-anchor": "end" }, packed.number(value, ys.digits));
    }
    element(svg, "path", { class: "axis", d: `M${LEFT} ${base}H${WIDTH - RIGHT}` });
    for (const value of xs.values.filter((tick) => tick <= length * (1 + 1e-9))) {
      element(svg, "path", { class: "axis", d: `M${x(value)} ${base}v4` });
      element(svg, "text", { class: "tick", x: x(value), y: base + 18, "text-anchor": "middle" }, packed.number(value, xs.digits));
    }
    element(svg, "text", { class: "title", x: (LEFT + WIDTH - RIGHT) / 2, y: HEIGHT - 8, "text-anchor": "middle" }, xTitle);
    element(svg, "text", { class: "title", transform: `translate(14 ${(TOP + base) / 2}) rotate(-90)`, "text-anchor": "middle" }, yTitle);
    curves.forEach((curve, k) => {
      let d = "";
      curve.forEach((value, i) => {
        if (Number.isFinite(value)) d += `${i && Number.isFinite(curve[i - 1]) ? "L" : "M"}${x(along[i]).toFixed(2)} ${y(value).toFixed(2)}`;
      });
      element(svg, "path", { class: `curve c${k}${k ? " dashed" : ""}`, d });
    });
  }

  for (const figure of document.querySelectorAll("figure.profile")) {
    const header = packed.header(figure);
    const [W, H] = [header.width, header.height];
    const pane = figure.querySelector(".pane");
    const handles = [...figure.querySelectorAll(".handle")];
    const svg = figure.querySelector("svg.plot");
    const reading = figure.querySelector(".reading");
    const each = header.stride * (header.millimetres || 1);
    const unit = header.millimetres ? "mm" : "px";
    const ends = header.ends.map((end) => [...end]);
    let surfaces = null;
    let rows = [];

    // Bilinear between the centres of pixels; unknown where one of those that count is.
    function sample(values, u, v) {
      const [c, r] = [Math.min(Math.floor(u), W - 1), Math.min(Math.floor(v), H - 1)];
      const [a, b] = [u - c, v - r];
      let sum = 0;
      for (const [dc, dr, weight] of [[0, 0, (1 - a) * (1 - b)], [1, 0, a * (1 - b)], [0, 1, (1 - a) * b], [1, 1, a * b]]) {
        if (weight > 1e-9) sum += weight * values[(r + dr) * W + c + dc];
      }
      return sum;
    }

    function draw() {
      const [[u0, v0], [u1, v1]] = ends;
      for (const line of figure.querySelectorAll(".line")) line.setAttribute("d", `M${u0 + 0.5} ${v0 + 0.5}L${u1 + 0.5} ${v1 + 0.5}`);
      handles.forEach((handle, i) => {
        handle.style.left = `${(100 * (ends[i][0] + 0.5)) / W}%`;
        handle.style.top = `${(100 * (ends[i][1] + 0.5)) / H}%`;
        handle.setAttribute("aria-label", `${i ? "End" : "Start"} of the line: ${packed.place(header, ...ends[i])}`);
      });
      const pixels = Math.hypot(u1 - u0, v1 - v0);
      const steps = Math.max(1, Math.ceil(pixels));
      const share = Array.from({ length: steps + 1 }, (_, i) => i / steps);
      const along = share.map((t) => t * pixels * each);
      const curves = surfaces.map((values) => share.map((t) => sample(values, u0 + t * (u1 - u0), v0 + t * (v1 - v0))));
      chart(svg, along, curves, `along the line, ${unit}`, `${header.quantity}, ${header.unit}`);
      rows = along.map((distance, i) => [distance, ...curves.map((curve) => curve[i])]);
      const known = curves[0].filter(Number.isFinite);
      const parts = [`${packed.quantity(pixels * each, unit === "mm" ? 2 : 1, unit)} long`];
      if (known.length) parts.push(`${header.quantity} spans ${packed.quantity(Math.max(...known) - Math.min(...known), header.digits, header.unit)}`);
      if (curves.length > 1) {
        const gaps = rows.map((row) => row[1] - row[2]).filter(Number.isFinite);
        if (gaps.length) parts.push(`measured and true differ by ${packed.quantity(Math.sqrt(gaps.reduce((s, g) => s + g * g, 0) / gaps.length), header.digits, header.unit)} (rms)`);
      }
      reading.textContent = parts.join("; ");
      pane.dataset.state = "drawn";
    }

    const clamp = (value, top) => Math.min(top - 1, Math.max(0, value));
    function put(end, u, v) {
      ends[end] = [clamp(u, W), clamp(v, H)];
      draw();
    }
    const place = (event) => {
      const box = pane.getBoundingClientRect();
      return [Math.floor(((event.clientX - box.left) / box.width) * W), Math.floor(((event.clientY - box.top) / box.height) * H)];
    };

    let dragged = null;
    // A press on the picture begins a new line; a finger scrolls the page there, and moves the handles.
    pane.addEventListener("pointerdown", (event) => {
      const handle = handles.indexOf(event.target);
      if (event.button > 0 || (handle < 0 && event.pointerType === "touch")) return;
      event.preventDefault();
      dragged = handle < 0 ? 1 : handle;
      pane.setPointerCapture(event.pointerId);
      if (handle < 0) { ends[0] = place(event).map((value, i) => clamp(value, [W, H][i])); put(1, ...ends[0]); }
      handles[dragged].focus({ preventScroll: true });
    });
    pane.addEventListener("pointermove", (event) => { if (dragged !== null) put(dragged, ...place(event)); });
    for (const kind of ["pointerup", "pointercancel"]) pane.addEventListener(kind, () => { dragged = null; });
    handles.forEach((handle, i) => handle.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const step = event.shiftKey ? 10 : 1;
      const by = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step] }[event.key];
      if (!by) return;
      event.preventDefault();
      put(i, ends[i][0] + by[0], ends[i][1] + by[1]);
    }));
    for (const button of figure.querySelectorAll("[data-line]")) {
      button.addEventListener("click", () => {
        const middle = [Math.round((ends[0][0] + ends[1][0]) / 2), Math.round((ends[0][1] + ends[1][1]) / 2)];
        const across = button.dataset.line === "row";
        ends[0] = across ? [0, middle[1]] : [middle[0], 0];
        ends[1] = across ? [W - 1, middle[1]] : [middle[0], H - 1];
        draw();
      });
    }
    page.csv(figure.querySelector(".csv"), () => [
      [`along the line (${unit})`, `measured (${header.unit})`, ...(surfaces.length > 1 ? [`true (${header.unit})`] : [])],
      ...rows.map((row) => row.map((value) => (Number.isFinite(value) ? String(Number(value.toPrecision(7))) : ""))),
    ]);

    Promise.all([...figure.querySelectorAll(".surface")].map((holder) => packed.values(holder, { ...header, ...packed.header(holder) }))).then((found) => {
      surfaces = found;
      packed.ruler(pane, header);
      figure.querySelector(".fallback").hidden = true;
      figure.querySelector(".drawn").hidden = false;
      handles.forEach((handle) => { handle.hidden = false; });
      draw();
    }).catch((error) => packed.fail(figure, error));
  }
})();
