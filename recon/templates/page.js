// Tabs, frame sliders, dividers, enlarging and copying. Every control is a native one, or follows the ARIA pattern of its role.
const page = {
  async copy(text) {
    try {
      await navigator.clipboard.writeText(text);
      return true;
    } catch {
      const area = document.createElement("textarea");
      area.value = text;
      document.body.append(area);
      area.select();
      const done = document.execCommand("copy");
      area.remove();
      return done;
    }
  },

  // Makes a button copy rows of plain cells as CSV (RFC 4180).
  csv(button, rows) {
    const cell = (text) => (/[",\n\r]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
    const label = button.textContent;
    button.hidden = false;
    button.addEventListener("click", async () => {
      const text = rows().map((row) => row.map(cell).join(",")).join("\r\n") + "\r\n";
      button.textContent = (await page.copy(text)) ? "Copied" : "Not allowed here";
      setTimeout(() => { button.textContent = label; }, 1500);
    });
  },
};

(() => {
  for (const gallery of document.querySelectorAll(".gallery")) {
    const tabs = [...gallery.querySelectorAll("[role=tab]")];
    const panels = [...gallery.querySelectorAll("[role=tabpanel]")];
    const notes = [...gallery.querySelectorAll("[data-note]")];
    const slider = gallery.querySelector(".slider input");
    const names = [...gallery.querySelectorAll(".names li")].map((item) => item.textContent);
    const beside = gallery.querySelector("select");
    const over = gallery.querySelector(".over");
    const wipe = gallery.querySelector(".wipe");
    const dial = gallery.querySelector(".dial");
    const dots = dial ? [...dial.querySelectorAll(".light")] : [];
    const state = { layer: 0, frame: 0 };

    const frame = (layer) => panels[layer].children[state.frame];
    function show() {
      panels.forEach((panel, i) => {
        panel.hidden = i !== state.layer;
        [...panel.children].forEach((picture, k) => { picture.hidden = k !== state.frame; });
        tabs[i].setAttribute("aria-selected", String(i === state.layer));
        tabs[i].tabIndex = i === state.layer ? 0 : -1;
      });
      const other = beside && beside.value !== "" ? Number(beside.value) : null;
      notes.forEach((note) => { note.hidden = ![state.layer, other].includes(Number(note.dataset.note)); });
      if (beside) {
        const there = other !== null && other !== state.layer && [state.layer, other].every((layer) => frame(layer).tagName === "IMG");
        for (const item of [over, wipe, ...gallery.querySelectorAll(".divider, .name")]) item.hidden = !there;
        if (there) {
          over.src = frame(other).src;
          over.classList.toggle("small", frame(other).classList.contains("small"));
          gallery.querySelector(".name.left").textContent = tabs[state.layer].textContent;
          gallery.querySelector(".name.right").textContent = tabs[other].textContent;
          wipe.setAttribute("aria-label", `Divider between ${tabs[state.layer].textContent} and ${tabs[other].textContent}`);
        }
      }
      if (slider) {
        slider.value = String(state.frame);
        gallery.querySelector(".slider output").textContent = `${state.frame + 1} of ${names.length}: ${names[state.frame]}`;
        slider.setAttribute("aria-valuetext", `${state.frame + 1} of ${names.length}: ${names[state.frame]}`);
      }
      if (dial) {
        const dot = dots[state.frame];
        packed.point(dial, Number(dot.getAttribute("cx")), Number(dot.getAttribute("cy")));
        gallery.querySelector(".towards").textContent = dot.dataset.words;
      }
    }

    tabs.forEach((tab, i) => {
      tab.addEventListener("click", () => { state.layer = i; show(); });
      tab.addEventListener("keydown", (event) => {
        const last = tabs.length - 1;
        const next = { ArrowRight: i === last ? 0 : i + 1, ArrowLeft: i === 0 ? last : i - 1, Home: 0, End: last }[event.key];
        if (next === undefined) return;
        event.preventDefault();
        state.layer = next;
        show();
        tabs[next].focus();
      });
    });
    if (slider) slider.addEventListener("input", () => { state.frame = Number(slider.value); show(); });
    if (dial) {
      // A press on the disc takes the light that is nearest; the slider does the same by keyboard.
      const nearest = (event) => {
        const box = dial.getBoundingClientRect();
        const view = dial.viewBox.baseVal;
        const at = [view.x + ((event.clientX - box.left) / box.width) * view.width, view.y + ((event.clientY - box.top) / box.height) * view.height];
        const far = dots.map((dot) => Math.hypot(dot.getAttribute("cx") - at[0], dot.getAttribute("cy") - at[1]));
        state.frame = far.indexOf(Math.min(...far));
        show();
      };
      dial.addEventListener("pointerdown", nearest);
      dial.addEventListener("pointermove", (event) => { if (event.buttons) nearest(event); });
    }
    if (beside) {
      beside.closest("label").hidden = false;
      beside.addEventListener("change", show);
      const pane = gallery.querySelector(".pane");
      let held = false;
      const move = () => pane.style.setProperty("--at", `${wipe.value}%`);
      // The native range lags the pointer by its thumb's width; while the pointer is down its own place is what counts.
      const follow = (event) => {
        const box = wipe.getBoundingClientRect();
        wipe.value = String(Math.round(100 * Math.min(1, Math.max(0, (event.clientX - box.left) / box.width))));
        move();
      };
      wipe.addEventListener("input", () => { if (!held) move(); });
      wipe.addEventListener("pointerdown", (event) => { held = true; follow(event); });
      wipe.addEventListener("pointermove", (event) => { if (held) follow(event); });
      for (const end of ["pointerup", "pointercancel"]) wipe.addEventListener(end, () => { held = false; });
      move();
    }
    show();
  }

  const lightbox = document.querySelector(".lightbox");
  for (const button of document.querySelectorAll(".enlarge")) {
    button.addEventListener("click", () => {
      const figure = button.closest("figure");
      const canvas = figure.querySelector("canvas");
      const target = lightbox.querySelector("img");
      target.src = canvas ? canvas.toDataURL() : button.querySelector("img").src;
      target.alt = figure.querySelector("figcaption b").textContent;
      lightbox.querySelector("p").textContent = figure.querySelector("figcaption").textContent;
      lightbox.showModal();
    });
  }
  lightbox.addEventListener("click", (event) => { if (event.target === lightbox) lightbox.close(); });

  for (const button of document.querySelectorAll(".table .csv")) {
    const rows = [...button.closest("figure").querySelectorAll("tr")];
    page.csv(button, () => rows.map((row) => [...row.children].map((item) => item.dataset.plain)));
  }
})();
