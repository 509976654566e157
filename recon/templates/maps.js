// Maps drawn from their values. Those of one row that show the same pixels are read together.
(() => {
  const tables = JSON.parse(document.querySelector(".colour-tables").textContent);
  const coloured = (name) => Uint8Array.from(atob(tables[name]), (c) => c.charCodeAt(0));

  function paint(canvas, header, values) {
    const table = coloured(header.colours);
    const image = new ImageData(header.width, header.height);
    values.forEach((value, i) => {
      const share = Math.min(1, Math.max(0, (value - header.bar[0]) / (header.bar[1] - header.bar[0])));
      const colour = Number.isNaN(value) ? packed.outside : table.subarray(3 * Math.round(255 * share));
      image.data.set([colour[0], colour[1], colour[2], 255], 4 * i);
    });
    canvas.getContext("2d", { willReadFrequently: true }).putImageData(image, 0, 0);
  }

  const groups = new Map();
  for (const figure of document.querySelectorAll("figure.map")) {
    const header = packed.header(figure);
    const part = figure.closest(".part");
    const same = JSON.stringify([header.width, header.height, header.row, header.column, header.stride]);
    if (!groups.has(part)) groups.set(part, new Map());
    const group = groups.get(part);
    if (!group.has(same)) group.set(same, []);
    const peers = group.get(same);
    const pane = figure.querySelector(".pane");
    packed.values(figure, header).then((values) => {
      paint(figure.querySelector("canvas"), header, values);
      const reading = figure.querySelector(".reading");
      const read = (column, row) => {
        const value = values[row * header.width + column];
        packed.cross(pane, header, column, row);
        const text = Number.isNaN(value) ? "no value" : packed.quantity(value, header.digits, header.unit);
        reading.textContent = `${text} at ${packed.place(header, column, row)}`;
      };
      const cursor = packed.cursor(pane, header.width, header.height, (column, row) => {
        for (const peer of peers) {
          peer.read(column, row);
          peer.cursor.set(column, row);
        }
      });
      peers.push({ read, cursor });
      packed.ruler(pane, header);
      figure.querySelector(".fallback").hidden = true;
      pane.dataset.state = "drawn";
    }).catch((error) => packed.fail(figure, error));
  }
})();
