// The print in space, its lines coloured by how far off the reference path the nozzle is. Plain 2-D canvas, no library.
// Lengths are mm; `view` turns them into pixels. What is in the data is said in packed.py.
"use strict";

const EXTRUDING = 128, BREAK = 64, FEATURE = 63;
const BINS = 48; // colours that are drawn
const QUICK_POINTS = 50000; // while it moves
const BACKGROUND = "#0e141b", TRAVEL = "#33414f", BED = "#26313d";

async function unpack(method) {
  const packed = Uint8Array.from(atob(method.data), (c) => c.charCodeAt(0));
  const plain = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(plain).arrayBuffer());
  const n = method.count;
  let at = 0;
  const take = (Type, width = 1) => {
    const column = new Type(n * width), size = Type.BYTES_PER_ELEMENT;
    for (let k = 0; k < width; k++, at += n * size) {
      for (let i = 0, value = 0; i < n; i++) {
        for (let j = 0; j < size; j++) value += bytes[at + j * n + i] << (8 * j);
        column[i * width + k] = value |= 0;
      }
    }
    return column;
  };
  return {
    ...method, n,
    foot: take(Uint16Array, 3), away: take(Int16Array, 3), due: take(Uint32Array),
    layer: take(Uint16Array), error: take(Uint8Array), kind: take(Uint8Array),
    x: new Float32Array(n), y: new Float32Array(n),
  };
}

async function showPrint(root, data, colours) {
  try {
    startViewer(root, data, colours, await Promise.all(data.methods.map(unpack)));
  } catch (error) {
    if (!(error instanceof ReferenceError) || typeof DecompressionStream === "function") throw error;
    root.querySelector("[data-role=label]").textContent = "This browser is too old for the view in space (2023 or newer).";
  }
}

function startViewer(root, data, colours, methods) {
  const find = (role) => root.querySelector(`[data-role=${role}]`);
  const canvas = find("canvas"), tip = find("tip"), label = find("label"), slider = find("layer");
  const context = canvas.getContext("2d");
  const axes = [0, 1, 2].map((k) => extent(methods[0], data, k));
  const centre = axes.map(([low, high]) => (low + high) / 2);
  const corners = [0, 1, 2, 3, 4, 5, 6, 7].map((k) => axes.map((axis, j) => axis[(k >> j) & 1]));
  const start = { yaw: -0.6, pitch: 0.75, zoom: 1, panX: 0, panY: 0, fit: 0 };
  const view = { ...start };
  const state = { layer: data.layers.length - 1, range: "all", method: methods.length, exaggeration: 1, travel: false };
  let pending = false, quick = false, hover = null;

  // ---- geometry ----

  const panels = () => {
    const shown = state.method < methods.length ? [state.method] : [...new Set([0, canvas.clientWidth > 900 ? 1 : methods.length - 1, methods.length - 1])];
    const width = canvas.clientWidth / shown.length;
    return shown.map((method, k) => ({ method, left: k * width, width, height: canvas.clientHeight }));
  };

  const turning = () => {
    const [c, s, flat, up] = [Math.cos(view.yaw), Math.sin(view.yaw), Math.sin(view.pitch), Math.cos(view.pitch)];
    return (x, y, z) => {
      const [dx, dy, dz] = [x - centre[0], y - centre[1], z - centre[2]];
      return [c * dx - s * dy, -(flat * (s * dx + c * dy) + up * dz)];
    };
  };

  // Pixels per mm at which all corners of the print are in sight, as it is turned when a view is chosen.
  const fitting = (panel) => {
    const turned = turning(), places = corners.map((corner) => turned(...corner));
    const [w, h] = [0, 1].map((k) => 2 * Math.max(...places.map((place) => Math.abs(place[k])), 0.5));
    return 0.9 * Math.min(panel.width / w, (panel.height - 60) / h);
  };

  const transform = (panel) => {
    view.fit = view.fit || fitting(panel);
    const scale = view.fit * view.zoom, turned = turning();
    const middle = [panel.left + panel.width / 2 + view.panX, panel.height / 2 + view.panY];
    return (x, y, z) => {
      const [u, v] = turned(x, y, z);
      return [middle[0] + scale * u, middle[1] + scale * v];
    };
  };

  const project = (method, panel, stride = 1) => {
    const place = transform(panel);
    const { foot, away, x, y } = method, { origin, grain, step } = data, k = step * state.exaggeration;
    const [first, last] = span(method);
    for (let i = first; i < last; i += stride) {
      const j = 3 * i;
      const [px, py] = place(
        origin[0] + grain * foot[j] + k * away[j],
        origin[1] + grain * foot[j + 1] + k * away[j + 1],
        origin[2] + grain * foot[j + 2] + k * away[j + 2],
      );
      x[i] = px;
      y[i] = py;
    }
  };

  // Points from the first to behind the last that is shown; those between may still be of other layers.
  const span = (method) => {
    if (state.range === "all") return [0, method.n];
    let first = method.n, last = 0;
    for (let i = 0; i < method.n; i++) if (visible(method, i)) { first = Math.min(first, i); last = i + 1; }
    return [Math.max(first - 1, 0), last];
  };

  const visible = (method, i) =>
    state.range === "all" || (state.range === "this" ? method.layer[i] === state.layer : method.layer[i] <= state.layer);

  // ---- drawing ----

  function draw() {
    pending = false;
    const ratio = window.devicePixelRatio || 1;
    const [w, h] = [Math.round(canvas.clientWidth * ratio), Math.round(canvas.clientHeight * ratio)];
    if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.fillStyle = BACKGROUND;
    context.fillRect(0, 0, canvas.clientWidth, canvas.clientHeight);
    for (const panel of panels()) drawPanel(panel);
    if (hover) drawHover();
  }

  function drawPanel(panel) {
    const method = methods[panel.method];
    context.save();
    context.beginPath();
    context.rect(panel.left, 0, panel.width, panel.height);
    context.clip();
    drawBed(panel);
    const [first, last] = span(method);
    const stride = quick ? Math.max(1, Math.round((last - first) * panels().length / QUICK_POINTS)) : 1;
    project(method, panel, stride);
    drawLines(method, stride);
    context.restore();
    context.fillStyle = "#e6edf3";
    context.font = "600 14px system-ui, sans-serif";
    context.fillText(method.label, panel.left + 12, 24);
    if (panel.left > 0) context.fillRect(panel.left - 0.5, 0, 1, panel.height);
  }

  function drawBed(panel) {
    if (!data.reach) return;
    const place = transform(panel);
    context.strokeStyle = BED;
    context.lineWidth = 1;
    for (const share of [0.25, 0.5, 0.75, 1]) {
      context.beginPath();
      for (let k = 0; k <= 72; k++) {
        const a = k * Math.PI / 36, r = share * data.reach;
        context.lineTo(...place(r * Math.cos(a), r * Math.sin(a), axes[2][0]));
      }
      context.stroke();
    }
  }

  function drawLines(method, stride) {
    const { x, y, kind, error } = method;
    const [first, last] = span(method);
    const bins = Array.from({ length: BINS + 1 }, () => []);
    for (let i = first + stride, before = first; i < last; before = i, i += stride) {
      if (!visible(method, i) || kind[i] & BREAK || (stride > 1 && method.layer[before] !== method.layer[i])) continue;
      const plastic = kind[i] & EXTRUDING;
      if (!plastic && !state.travel) continue;
      bins[plastic ? 1 + Math.floor(error[i] * BINS / 256) : 0].push(before, i);
    }
    const wide = Math.min(2.4, Math.max(1.1, (state.range === "this" ? 1.6 : 1.1) * Math.sqrt(view.zoom)));
    bins.forEach((pairs, bin) => {
      context.strokeStyle = bin ? colours[Math.floor((bin - 0.5) * colours.length / BINS)] : TRAVEL;
      context.lineWidth = bin ? wide : 0.7;
      context.lineJoin = "round";
      context.beginPath();
      for (let k = 0; k < pairs.length; k += 2) {
        if (k === 0 || pairs[k] !== pairs[k - 1]) context.moveTo(x[pairs[k]], y[pairs[k]]);
        context.lineTo(x[pairs[k + 1]], y[pairs[k + 1]]);
      }
      context.stroke();
    });
  }

  function drawHover() {
    context.strokeStyle = "#ffffff";
    context.lineWidth = 2;
    context.beginPath();
    context.arc(hover.x, hover.y, 6, 0, 2 * Math.PI);
    context.stroke();
  }

  function redraw(moving = false) {
    quick = moving;
    if (!pending) {
      pending = true;
      requestAnimationFrame(draw);
    }
    clearTimeout(redraw.timer);
    if (moving) redraw.timer = setTimeout(() => redraw(false), 120);
  }

  // ---- what is under the pointer ----

  const errorAt = (method, i) => data.lowest * (data.highest / data.lowest) ** (method.error[i] / 255);

  const micrometres = (value) => value <= 1.02 * data.lowest ? `< ${data.lowest}` : value < 9.95 ? value.toFixed(1) : value.toFixed(0);

  const atTime = (method, due) => {
    let low = 0, high = method.n - 1;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (method.due[middle] < due) low = middle + 1; else high = middle;
    }
    return low > 0 && due - method.due[low - 1] < method.due[low] - due ? low - 1 : low;
  };

  function nearest(px, py) {
    const panel = panels().find((each) => px >= each.left && px < each.left + each.width);
    if (!panel) return null;
    const method = methods[panel.method], [first, last] = span(method);
    project(method, panel);
    let best = 144, found = -1;
    for (let i = first; i < last; i++) {
      const d = (method.x[i] - px) ** 2 + (method.y[i] - py) ** 2;
      if (d < best && visible(method, i) && (state.travel || method.kind[i] & EXTRUDING)) [best, found] = [d, i];
    }
    return found < 0 ? null : { method, i: found, x: method.x[found], y: method.y[found] };
  }

  function point(px, py) {
    hover = nearest(px, py);
    tip.hidden = !hover;
    if (hover) {
      const { method, i } = hover;
      const at = [0, 1, 2].map((k) => data.origin[k] + data.grain * method.foot[3 * i + k]);
      const feature = data.features[method.kind[i] & FEATURE] || "";
      const layer = data.layers[method.layer[i]].number;
      const lines = methods.map((each) => `${each === method ? "▸ " : "   "}${micrometres(errorAt(each, each === method ? i : atTime(each, method.due[i])))} µm  ${each.short}`);
      const where = `X ${at[0].toFixed(2)}  Y ${at[1].toFixed(2)}  Z ${at[2].toFixed(2)} mm`;
      tip.textContent = [...lines, where, `layer ${layer}, ${feature}${method.kind[i] & EXTRUDING ? "" : " (travel)"}, ${(data.tick * method.due[i]).toFixed(2)} s`].join("\n");
      const room = root.clientWidth - tip.offsetWidth - 8;
      tip.style.left = `${Math.max(4, Math.min(px + 16, room))}px`;
      tip.style.top = `${py > tip.offsetHeight + 20 ? py - tip.offsetHeight - 12 : py + 16}px`;
    }
    redraw();
  }

  // ---- controls ----

  function tell() {
    const layer = data.layers[state.layer];
    const what = { all: "Whole print", this: `Layer ${layer.number}`, upto: `Up to layer ${layer.number}` }[state.range];
    const numbers = methods.map((m) => `${m.short} ${m.byLayer[state.layer]}`).join(" · ");
    label.textContent = state.range === "all"
      ? `${what}: ${data.layers.length} layer${data.layers.length > 1 ? "s" : ""} evaluated`
      : `${what}, Z ${layer.z.toFixed(2)} mm — this layer, µm rms: ${numbers}`;
    slider.value = state.layer;
    slider.setAttribute("aria-valuetext", label.textContent);
    root.querySelectorAll("[data-set]").forEach((button) => {
      const [name, value] = button.dataset.set.split(":");
      button.setAttribute("aria-pressed", String(String(state[name]) === value));
    });
    find("times").textContent = `${state.exaggeration} ×`;
    find("travel").setAttribute("aria-pressed", String(state.travel));
  }

  function change(values) {
    Object.assign(state, values);
    state.layer = Math.max(0, Math.min(data.layers.length - 1, state.layer));
    hover = null;
    tip.hidden = true;
    tell();
    redraw();
  }

  const scrub = (layer) => change({ layer, range: state.range === "all" ? "this" : state.range });

  function look(yaw, pitch) {
    Object.assign(view, start, { yaw, pitch });
    hover = null;
    tip.hidden = true;
    redraw();
  }

  slider.max = data.layers.length - 1;
  slider.addEventListener("input", () => scrub(Number(slider.value)));
  root.querySelectorAll("[data-set]").forEach((button) => button.addEventListener("click", () => {
    const [name, value] = button.dataset.set.split(":");
    if (name === "method") view.fit = 0; // the room has changed
    change({ [name]: name === "method" ? Number(value) : value });
  }));
  root.querySelectorAll("[data-look]").forEach((button) => button.addEventListener("click", () => look(...button.dataset.look.split(",").map(Number))));
  find("travel").addEventListener("click", () => change({ travel: !state.travel }));
  find("exaggeration").addEventListener("input", (event) => change({ exaggeration: Math.round(10 ** Number(event.target.value)) }));

  let playing = null;
  find("play").addEventListener("click", () => {
    if (playing) {
      clearInterval(playing);
      playing = null;
    } else {
      if (state.range !== "upto") change({ range: "upto", layer: 0 });
      const pause = Math.max(40, Math.min(300, 6000 / data.layers.length));
      playing = setInterval(() => scrub((state.layer + 1) % data.layers.length), pause);
    }
    find("play").textContent = playing ? "❚❚ Pause" : "▶ Play";
  });

  const STEPS = { ArrowUp: 1, ArrowRight: 1, ArrowDown: -1, ArrowLeft: -1, PageUp: 10, PageDown: -10, Home: -1e9, End: 1e9 };
  canvas.addEventListener("keydown", (event) => {
    if (!(event.key in STEPS)) return;
    event.preventDefault();
    scrub(state.layer + STEPS[event.key]);
  });

  const pointers = new Map();
  const local = (event) => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };

  function zoom(factor, px, py) {
    const panel = panels().find((each) => px >= each.left && px < each.left + each.width) || panels()[0];
    const next = Math.max(0.3, Math.min(400, view.zoom * factor)), real = next / view.zoom;
    const [dx, dy] = [px - panel.left - panel.width / 2, py - panel.height / 2];
    view.panX = dx + (view.panX - dx) * real;
    view.panY = dy + (view.panY - dy) * real;
    view.zoom = next;
    hover = null;
    tip.hidden = true;
    redraw(true);
  }

  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(-event.deltaY * (event.deltaMode ? 0.03 : 0.0015)), ...local(event));
  }, { passive: false });
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, local(event));
  });
  canvas.addEventListener("pointermove", (event) => {
    const [px, py] = local(event), before = pointers.get(event.pointerId);
    if (!before) return point(px, py);
    const others = [...pointers].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
    if (others.length) {
      const [ox, oy] = others[0];
      zoom(Math.hypot(px - ox, py - oy) / Math.max(1, Math.hypot(before[0] - ox, before[1] - oy)), (px + ox) / 2, (py + oy) / 2);
    } else if (event.shiftKey || event.buttons & 6) {
      view.panX += px - before[0];
      view.panY += py - before[1];
    } else {
      view.yaw += (px - before[0]) * 0.008;
      view.pitch = Math.max(0, Math.min(Math.PI / 2, view.pitch + (py - before[1]) * 0.008));
    }
    hover = null;
    tip.hidden = true;
    pointers.set(event.pointerId, [px, py]);
    redraw(true);
  });
  for (const name of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(name, (event) => {
      pointers.delete(event.pointerId);
      if (event.pointerType === "touch") point(...local(event));
    });
  }
  canvas.addEventListener("pointerleave", () => { hover = null; tip.hidden = true; redraw(); });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  new ResizeObserver(() => { view.fit = 0; redraw(); }).observe(canvas);

  root.dataset.ready = "yes";
  if (canvas.clientWidth < 620) state.method = methods.length - 1;
  tell();
  redraw();
}

function extent(method, data, k) {
  let [low, high] = [Infinity, -Infinity];
  for (let i = 0; i < method.n; i++) {
    if (!(method.kind[i] & EXTRUDING)) continue;
    const value = data.origin[k] + data.grain * method.foot[3 * i + k];
    low = Math.min(low, value);
    high = Math.max(high, value);
  }
  return low <= high ? [low, high] : [data.origin[k], data.origin[k]]; // no plastic at all
}
