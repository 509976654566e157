"use strict";
// Tabs, frame sliders, dividers, enlarging and copying. Every control is a native one, or follows the ARIA pattern of its role.
(() => {
  for (const gallery of document.querySelectorAll(".gallery")) {
    const tabs = [...gallery.querySelectorAll("[role=tab]")];
    const panels = [...gallery.querySelectorAll("[role=tabpanel]")];
    const slider = gallery.querySelector("input[type=range]");
    const output = gallery.querySelector("output");
    const names = [...gallery.querySelectorAll(".names li")].map((item) => item.textContent);
    const choose = (index) => {
      tabs.forEach((tab, i) => {
        tab.setAttribute("aria-selected", String(i === index));
        tab.tabIndex = i === index ? 0 : -1;
        panels[i].hidden = i !== index;
      });
    };
    tabs.forEach((tab, i) => {
      tab.addEventListener("click", () => choose(i));
      tab.addEventListener("keydown", (event) => {
        const last = tabs.length - 1;
        const next = { ArrowRight: i === last ? 0 : i + 1, ArrowLeft: i === 0 ? last : i - 1, Home: 0, End: last }[event.key];
        if (next === undefined) return;
        event.preventDefault();
        choose(next);
        tabs[next].focus();
      });
    });
    if (slider) {
      const show = () => {
        const index = Number(slider.value);
        for (const panel of panels) {
          panel.querySelectorAll(".frames img").forEach((image, i) => { image.hidden = i !== index; });
        }
        output.textContent = `${index + 1} of ${names.length}: ${names[index]}`;
        slider.setAttribute("aria-valuetext", output.textContent);
      };
      slider.addEventListener("input", show);
      show();
    }
  }

  for (const wipe of document.querySelectorAll(".wipe")) {
    const input = wipe.querySelector("input");
    let held = false;
    const move = () => wipe.style.setProperty("--at", `${input.value}%`);
    // The native range lags the pointer by its thumb's width; while the pointer is down its own place is what counts.
    const follow = (event) => {
      const box = input.getBoundingClientRect();
      input.value = String(Math.round(100 * Math.min(1, Math.max(0, (event.clientX - box.left) / box.width))));
      move();
    };
    input.addEventListener("input", () => { if (!held) move(); });
    input.addEventListener("pointerdown", (event) => { held = true; follow(event); });
    input.addEventListener("pointermove", (event) => { if (held) follow(event); });
    for (const end of ["pointerup", "pointercancel"]) input.addEventListener(end, () => { held = false; });
    move();
  }

  const lightbox = document.querySelector(".lightbox");
  for (const button of document.querySelectorAll(".enlarge")) {
    button.addEventListener("click", () => {
      const source = button.querySelector("img");
      const target = lightbox.querySelector("img");
      target.src = source.src;
      target.alt = source.alt;
      const caption = button.closest("figure").querySelector("figcaption");
      lightbox.querySelector("p").textContent = caption ? caption.textContent : source.alt;
      lightbox.showModal();
    });
  }
  lightbox.addEventListener("click", (event) => { if (event.target === lightbox) lightbox.close(); });

  const copy = async (text) => {
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
  };
  for (const button of document.querySelectorAll(".csv")) {
    button.hidden = false;
    button.addEventListener("click", async () => {
      const rows = [...button.closest("figure").querySelectorAll("tr")];
      const cell = (item) => (/[",\n\r]/.test(item.dataset.plain) ? `"${item.dataset.plain.replaceAll('"', '""')}"` : item.dataset.plain);
      const text = rows.map((row) => [...row.children].map(cell).join(",")).join("\r\n") + "\r\n";
      const label = button.textContent;
      button.textContent = (await copy(text)) ? "Copied" : "Not allowed here";
      setTimeout(() => { button.textContent = label; }, 1500);
    });
  }
})();
