// The viewer's buttons, sliders and gestures.
"use strict";

function controls({ root, find, data, methods, view, start, state, most, redraw, panels, said, saidOfMove, saidOfSize, forget, span, head }) {
  const slider = find("layer"), label = find("label"), feature = find("feature");

  function tell() {
    label.textContent = said();
    find("now").textContent = saidOfMove();
    find("times").textContent = saidOfSize();
    slider.value = state.layer;
    slider.setAttribute("aria-valuetext", label.textContent);
    find("move").setAttribute("aria-valuetext", find("now").textContent);
    root.querySelectorAll("[data-set]").forEach((button) => {
      const [name, value] = button.dataset.set.split(":");
      button.setAttribute("aria-pressed", String(String(state[name]) === value));
    });
    root.querySelectorAll("[data-toggle]").forEach((button) => button.setAttribute("aria-pressed", String(state[button.dataset.toggle])));
  }

  function change(values) {
    Object.assign(state, values);
    state.layer = Math.max(0, Math.min(data.layers.length - 1, state.layer));
    find("move").value = 1000 * state.until;
    forget();
    tell();
    redraw();
  }

  const scrub = (layer) => change({ layer, until: 1, range: state.range === "all" ? "this" : state.range });

  function look(yaw, pitch) {
    Object.assign(view, start, { yaw, pitch });
    forget();
    redraw();
  }

  // Whichever of the two players runs: through the layers, or along the moves in the print's own time.
  let playing = null;
  function play(button, tick) {
    const again = playing && playing.button === button;
    if (playing) {
      clearInterval(playing.timer);
      playing.button.textContent = "▶";
    }
    playing = again ? null : { button, timer: setInterval(tick, Math.max(40, button === find("play") ? 6000 / data.layers.length : 40)) };
    if (playing) button.textContent = "❚❚";
  }

  function along() {
    const method = methods[panels()[0].method], [first, last] = span(method), at = head();
    let i = at ? at.i : first;
    const due = method.due[i] + 0.04 * Number(find("rate").value) / data.tick;
    i += 1;
    while (i < last - 1 && method.due[i] < due && !(method.kind[i + 1] & BREAK)) i += 1;
    change({ until: i >= last - 1 ? 0 : (i - first) / (last - 1 - first) });
  }

  slider.max = data.layers.length - 1;
  slider.addEventListener("input", () => scrub(Number(slider.value)));
  find("move").addEventListener("input", (event) => change({ until: Number(event.target.value) / 1000 }));
  root.querySelectorAll("[data-set]").forEach((button) => button.addEventListener("click", () => {
    const [name, value] = button.dataset.set.split(":");
    if (name === "method") view.fit = null; // the room has changed
    change({ [name]: name === "method" ? Number(value) : value });
  }));
  root.querySelectorAll("[data-toggle]").forEach((button) => button.addEventListener("click", () => change({ [button.dataset.toggle]: !state[button.dataset.toggle] })));
  root.querySelectorAll("[data-look]").forEach((button) => button.addEventListener("click", () => look(...button.dataset.look.split(",").map(Number))));
  feature.addEventListener("change", () => change({ feature: Number(feature.value) }));
  find("width").addEventListener("input", (event) => change({ width: Number(event.target.value) }));
  find("exaggeration").max = Math.log10(most);
  find("exaggeration").disabled = most < 1.1;
  find("exaggeration").addEventListener("input", (event) => change({ exaggeration: Math.max(1, Math.floor(10 ** Number(event.target.value) + 0.01)) }));
  find("play").addEventListener("click", () => {
    if (state.range !== "upto") change({ range: "upto", layer: 0 });
    play(find("play"), () => scrub((state.layer + 1) % data.layers.length));
  });
  find("run").addEventListener("click", () => play(find("run"), along));
  return { tell, change, scrub };
}

// Mouse: drag to turn, shift to move, wheel to zoom. Touch: one finger turns, two move and zoom; up and down scrolls.
function steer({ canvas, view, state, redraw, point, panelAt, panels, forget }, { scrub }) {
  const pointers = new Map();
  const local = (event) => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };

  function moved() {
    forget();
    redraw(true);
  }

  function zoom(factor, px, py) {
    const panel = panelAt(px, py) || panels()[0];
    const next = Math.max(0.3, Math.min(400, view.zoom * factor)), real = next / view.zoom;
    const [dx, dy] = [px - panel.left - panel.width / 2, py - panel.top - 15 - panel.height / 2];
    view.panX = dx + (view.panX - dx) * real;
    view.panY = dy + (view.panY - dy) * real;
    view.zoom = next;
    moved();
  }

  function drag([px, py], [bx, by], event) {
    const others = [...pointers].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
    if (others.length) {
      const [ox, oy] = others[0];
      view.panX += (px - bx) / 2;
      view.panY += (py - by) / 2;
      zoom(Math.hypot(px - ox, py - oy) / Math.max(1, Math.hypot(bx - ox, by - oy)), (px + ox) / 2, (py + oy) / 2);
    } else if (event.shiftKey || event.buttons & 6) {
      view.panX += px - bx;
      view.panY += py - by;
    } else {
      view.yaw += (px - bx) * 0.008;
      view.pitch = Math.max(0, Math.min(Math.PI / 2, view.pitch + (py - by) * 0.008));
    }
    moved();
  }

  const STEPS = { ArrowUp: 1, ArrowRight: 1, ArrowDown: -1, ArrowLeft: -1, PageUp: 10, PageDown: -10, Home: -1e9, End: 1e9 };
  canvas.addEventListener("keydown", (event) => {
    if (!(event.key in STEPS)) return;
    event.preventDefault();
    scrub(state.layer + STEPS[event.key]);
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(-event.deltaY * (event.deltaMode ? 0.03 : 0.0015)), ...local(event));
  }, { passive: false });
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, local(event));
  });
  canvas.addEventListener("pointermove", (event) => {
    const at = local(event), before = pointers.get(event.pointerId);
    if (!before) return point(...at);
    pointers.set(event.pointerId, at);
    drag(at, before, event);
  });
  for (const name of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(name, (event) => {
      pointers.delete(event.pointerId);
      if (event.pointerType === "touch" && name === "pointerup" && !pointers.size) point(...local(event));
    });
  }
  canvas.addEventListener("pointerleave", () => { forget(); redraw(); });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
}
