"use strict";
// Arrays that a page carries (recon/page_mesh.py and recon/page_values.py wrote them), and what the parts that read them share.
const packed = {
  outside: [30, 32, 36], // the colour of pixels without a value: OUTSIDE of recon/pictures.py

  async inflate(element) {
    if (typeof DecompressionStream === "undefined") throw new Error("this browser cannot unpack it");
    const bytes = Uint8Array.from(atob(element.textContent), (c) => c.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Response(stream).arrayBuffer();
  },

  // Codes of `rows` rows, stored as steps along each row (down the first column), low bytes before high bytes.
  async codes(element, rows, columns) {
    const bytes = new Uint8Array(await this.inflate(element));
    const n = rows * columns;
    const out = new Uint16Array(n);
    for (let r = 0, i = 0; r < rows; r++) {
      for (let c = 0; c < columns; c++, i++) {
        const before = c ? out[i - 1] : r ? out[i - columns] : 0;
        out[i] = before + bytes[i] + 256 * bytes[n + i];
      }
    }
    return out;
  },

  async values(figure, header) {
    const codes = await this.codes(figure.querySelector(".values"), header.height, header.width);
    const out = new Float64Array(codes.length);
    codes.forEach((code, i) => { out[i] = code ? header.lo + (code - 1) * header.step : NaN; });
    return out;
  },

  header: (figure) => JSON.parse(figure.querySelector(".header").textContent),

  // Text of a number, with a true minus sign; and of a quantity.
  number: (value, digits) => (Math.abs(value) < 0.5 * 10 ** -digits ? 0 : value).toFixed(digits).replace("-", "\u2212"),
  quantity(value, digits, unit) { return this.number(value, digits) + (["", "°", "%"].includes(unit) ? unit : `\u202f${unit}`); },

  // A length of 1, 2 or 5 times a power of ten below `most`.
  round(most) {
    const power = 10 ** Math.floor(Math.log10(most));
    return [5, 2, 1].map((m) => m * power).find((value) => value <= most * (1 + 1e-9));
  },

  // Where a pixel of a window lies in the capture, counted from 1.
  place: (header, column, row) => `row ${header.row + row * header.stride + 1}, column ${header.column + column * header.stride + 1}`,

  // The ruler of a map: about a quarter of its width.
  ruler(pane, header) {
    const each = header.stride * (header.millimetres || 1);
    const length = this.round((header.width * each) / 3);
    const ruler = pane.querySelector(".ruler");
    ruler.style.width = `${(100 * length) / (header.width * each)}%`;
    const unit = header.millimetres ? "mm" : "px";
    ruler.querySelector("span").textContent = unit === "mm" && length < 0.1 ? `${Number((length * 1000).toPrecision(3))}\u202fµm` : `${Number(length.toPrecision(3))}\u202f${unit}`;
    ruler.hidden = false;
  },

  // Calls move(column, row) when the pointer goes over a pane of W x H pixels, or the arrow keys step over it (Shift: by ten).
  cursor(pane, W, H, move) {
    let at = null;
    const clamp = (value, top) => Math.min(top - 1, Math.max(0, value));
    const go = (column, row) => {
      at = [clamp(column, W), clamp(row, H)];
      move(...at);
    };
    const follow = (event) => {
      const box = pane.getBoundingClientRect();
      go(Math.floor(((event.clientX - box.left) / box.width) * W), Math.floor(((event.clientY - box.top) / box.height) * H));
    };
    pane.addEventListener("pointermove", follow);
    pane.addEventListener("pointerdown", follow);
    pane.addEventListener("focus", () => { if (!at && pane.matches(":focus-visible")) go(Math.floor(W / 2), Math.floor(H / 2)); });
    pane.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const step = event.shiftKey ? 10 : 1;
      const by = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step] }[event.key];
      if (!by && event.key !== "Home") return;
      event.preventDefault();
      const from = at || [Math.floor(W / 2), Math.floor(H / 2)];
      if (by) go(from[0] + by[0], from[1] + by[1]);
      else go(Math.floor(W / 2), Math.floor(H / 2));
    });
    return { set: (column, row) => { at = [column, row]; } };
  },

  cross(pane, header, column, row) {
    const cross = pane.querySelector(".cross");
    cross.hidden = false;
    cross.style.left = `${(100 * (column + 0.5)) / header.width}%`;
    cross.style.top = `${(100 * (row + 0.5)) / header.height}%`;
  },

  // The light's arrow in a disc that is drawn by recon/page_light.py.
  point(dial, x, y) {
    dial.querySelector(".now").setAttribute("cx", x);
    dial.querySelector(".now").setAttribute("cy", y);
    const length = Math.hypot(x, y);
    const [u, v] = [x / length, y / length];
    const wing = (side) => `L${0.06 * u + 0.16 * u - side * 0.09 * v} ${0.06 * v + 0.16 * v + side * 0.09 * u}`;
    const tip = `M${0.06 * u} ${0.06 * v}`;
    dial.querySelector(".arrow").setAttribute("d", length > 0.25 ? `M${x} ${y}L${0.06 * u} ${0.06 * v}${tip}${wing(1)}${tip}${wing(-1)}` : "");
  },

  fail(figure, error) {
    const fallback = figure.querySelector(".fallback");
    fallback.hidden = false;
    fallback.textContent = `This cannot be drawn here: ${error.message}.`;
  },
};
