// The print in space, its lines coloured by how far off the reference path the nozzle is. Plain 2-D canvas, no library.
// Lengths are mm; `view` turns them into pixels. What is in the data is said in packed.py.
"use strict";

const QUICK_POINTS = 50000; // while it moves
const FIT_POINTS = 4000;
const LARGEST_DRAWN = 0.05; // of the part's size: an error that is drawn larger than this is no picture of the part

const dark = window.matchMedia("(prefers-color-scheme: dark)");

async function showPrint(root, data, colours) {
  try {
    const [outline, methods] = await Promise.all([unpackOutline(data.outline), Promise.all(data.methods.map(unpack))]);
    startViewer(root, data, colours, methods, outline);
  } catch (error) {
    if (!(error instanceof ReferenceError) || typeof DecompressionStream === "function") throw error;
    root.querySelector("[data-role=label]").textContent = "This browser is too old for the view in space (2023 or newer).";
  }
}

function startViewer(root, data, colours, methods, outline) {
  const find = (role) => root.querySelector(`[data-role=${role}]`);
  const canvas = find("canvas"), tip = find("tip"), context = canvas.getContext("2d");
  const every = outline.n ? outline : methods[0];
  const axes = [0, 1, 2].map((k) => extent(every, data, k));
  const centre = axes.map(([low, high]) => (low + high) / 2);
  const aside = new Set(data.features.flatMap((name, k) => /skirt|brim|custom|wipe|prime|purge/i.test(name) ? [k] : []));
  const size = Math.max(axes[0][1] - axes[0][0], axes[1][1] - axes[1][0], 1);
  const most = Math.max(1, Math.min(100, LARGEST_DRAWN * size / (1e-3 * data.highest)));
  const start = { yaw: -0.6, pitch: 0.75, zoom: 1, panX: 0, panY: 0, fit: null };
  const view = { ...start };
  const state = {
    layer: data.layers.length - 1, range: "all", method: methods.length, exaggeration: 1, travel: false, outline: data.partial,
    feature: -1, width: 1.6, until: 1,
  };
  let pending = false, quick = false, hover = null;

  // ---- geometry ----

  const panels = () => {
    const [w, h] = [canvas.clientWidth, canvas.clientHeight];
    const all = [...new Set([0, w > 900 ? 1 : methods.length - 1, methods.length - 1])];
    const shown = state.method < methods.length ? [state.method] : all;
    const [across, down] = w >= 620 ? [shown.length, 1] : [1, shown.length];
    return shown.map((method, k) => ({
      method, width: w / across, height: h / down, left: (k % across) * w / across, top: Math.floor(k / across) * h / down,
    }));
  };

  const panelAt = (x, y) => panels().find((p) => x >= p.left && x < p.left + p.width && y >= p.top && y < p.top + p.height);

  const turning = () => {
    const [c, s, flat, up] = [Math.cos(view.yaw), Math.sin(view.yaw), Math.sin(view.pitch), Math.cos(view.pitch)];
    return (x, y, z) => {
      const [dx, dy, dz] = [x - centre[0], y - centre[1], z - centre[2]];
      return [c * dx - s * dy, -(flat * (s * dx + c * dy) + up * dz)];
    };
  };

  const place3 = (points, i) => [0, 1, 2].map((k) => data.origin[k] + data.grain * points.foot[3 * i + k]);

  // Pixels per mm at which the part, as it is turned when a view is chosen, fills the panel, and its middle there.
  const fitting = (panel) => {
    const turned = turning(), stride = Math.max(1, Math.floor(every.n / FIT_POINTS));
    let [left, right, top, bottom] = [Infinity, -Infinity, Infinity, -Infinity];
    for (let i = 0; i < every.n; i += stride) {
      if ((every !== outline && !(every.kind[i] & EXTRUDING)) || aside.has(every.kind[i] & FEATURE)) continue;
      const [u, v] = turned(...place3(every, i));
      [left, right, top, bottom] = [Math.min(left, u), Math.max(right, u), Math.min(top, v), Math.max(bottom, v)];
    }
    if (left > right) [left, right, top, bottom] = [-1, 1, -1, 1];
    const [w, h] = [Math.max(right - left, 1), Math.max(bottom - top, 1)];
    const scale = 0.94 * Math.min(panel.width / w, (panel.height - 40) / h);
    return { scale, u: (left + right) / 2, v: (top + bottom) / 2 };
  };

  const transform = (panel) => {
    const fit = view.fit = view.fit || fitting(panel), scale = fit.scale * view.zoom, turned = turning();
    const [mx, my] = [panel.left + panel.width / 2 + view.panX, panel.top + 15 + panel.height / 2 + view.panY];
    return (x, y, z) => {
      const [u, v] = turned(x, y, z);
      return [mx + scale * (u - fit.u), my + scale * (v - fit.v)];
    };
  };

  const project = (method, panel, stride = 1) => {
    const place = transform(panel);
    const { foot, away, x, y } = method, { origin, grain, step } = data, k = step * state.exaggeration;
    const [first, last] = span(method);
    for (let i = first; i < last; i += stride) {
      const j = 3 * i;
      [x[i], y[i]] = place(
        origin[0] + grain * foot[j] + k * away[j],
        origin[1] + grain * foot[j + 1] + k * away[j + 1],
        origin[2] + grain * foot[j + 2] + k * away[j + 2],
      );
    }
  };

  // Points from the first to behind the last that is shown; those between may still be of other layers.
  const span = (method) => {
    if (state.range === "all") return [0, method.n];
    let first = method.n, last = 0;
    for (let i = 0; i < method.n; i++) if (inRange(method.layer[i])) { first = Math.min(first, i); last = i + 1; }
    return [Math.max(first - 1, 0), last];
  };

  const inRange = (layer) => state.range === "all" || (state.range === "this" ? layer === state.layer : layer <= state.layer);

  const visible = (method, i) => inRange(method.layer[i])
    && (state.feature < 0 || (method.kind[i] & FEATURE) === state.feature)
    && (method.kind[i] & EXTRUDING || state.travel);

  // The point that the move slider stands at, of the first method shown; null at the slider's end: all is drawn.
  const head = () => {
    if (state.until >= 1) return null;
    const method = methods[panels()[0].method], [first, last] = span(method);
    return { method, i: Math.min(last - 1, first + Math.round(state.until * (last - 1 - first))) };
  };

  // ---- drawing ----

  const ink = (name) => getComputedStyle(root).getPropertyValue(name).trim();

  function draw() {
    pending = false;
    const ratio = window.devicePixelRatio || 1;
    const [w, h] = [Math.round(canvas.clientWidth * ratio), Math.round(canvas.clientHeight * ratio)];
    if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, canvas.clientWidth, canvas.clientHeight);
    const at = head(), due = at ? at.method.due[at.i] : Infinity;
    for (const panel of panels()) drawPanel(panel, due);
    if (hover) ring(hover.x, hover.y, 6);
  }

  function drawPanel(panel, due) {
    const method = methods[panel.method];
    context.save();
    context.beginPath();
    context.rect(panel.left, panel.top, panel.width, panel.height);
    context.clip();
    drawBed(panel);
    if (state.outline) drawOutline(panel);
    const [first, last] = span(method);
    const stride = quick ? Math.max(1, Math.round((last - first) * panels().length / QUICK_POINTS)) : 1;
    project(method, panel, stride);
    drawLines(method, stride, due);
    if (due < Infinity) { const i = atTime(method, due); project(method, panel); ring(method.x[i], method.y[i], 5); }
    context.restore();
    context.fillStyle = ink("--ink");
    context.font = "600 14px system-ui, sans-serif";
    context.fillText(method.label, panel.left + 12, panel.top + 22);
    context.fillStyle = ink("--line");
    if (panel.left > 0) context.fillRect(panel.left - 0.5, panel.top, 1, panel.height);
    if (panel.top > 0) context.fillRect(panel.left, panel.top - 0.5, panel.width, 1);
  }

  function drawBed(panel) {
    if (!data.reach) return;
    const place = transform(panel);
    context.strokeStyle = ink("--line");
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

  // What is printed, but was not evaluated; what was is drawn over it.
  function drawOutline(panel) {
    const place = transform(panel), number = data.layers[state.layer].number;
    const stride = quick ? Math.max(1, Math.round(outline.n * panels().length / QUICK_POINTS)) : 1;
    context.strokeStyle = ink("--ghost");
    context.lineWidth = 1;
    context.beginPath();
    for (let i = 1; i < outline.n; i += stride) {
      const layer = outline.layer[i];
      if (outline.kind[i] & BREAK || (state.feature >= 0 && (outline.kind[i] & FEATURE) !== state.feature)) continue;
      if (state.range === "this" ? layer !== number : state.range === "upto" && layer > number) continue;
      context.moveTo(...place(...place3(outline, i - 1)));
      context.lineTo(...place(...place3(outline, i)));
    }
    context.stroke();
  }

  function drawLines(method, stride, due) {
    const { x, y, kind, error } = method, ramp = colours[dark.matches ? "dark" : "light"], count = ramp.length;
    const [first, last] = span(method);
    const bins = Array.from({ length: count + 1 }, () => []);
    for (let i = first + stride, before = first; i < last && method.due[i] <= due; before = i, i += stride) {
      if (!visible(method, i) || kind[i] & BREAK || (stride > 1 && method.layer[before] !== method.layer[i])) continue;
      bins[kind[i] & EXTRUDING ? 1 + Math.floor(error[i] * count / 256) : 0].push(before, i);
    }
    bins.forEach((pairs, bin) => {
      context.strokeStyle = bin ? ramp[bin - 1] : ink("--travel");
      context.lineWidth = bin ? state.width : 0.7;
      context.lineJoin = "round";
      context.beginPath();
      for (let k = 0; k < pairs.length; k += 2) {
        if (k === 0 || pairs[k] !== pairs[k - 1]) context.moveTo(x[pairs[k]], y[pairs[k]]);
        context.lineTo(x[pairs[k + 1]], y[pairs[k + 1]]);
      }
      context.stroke();
    });
  }

  function ring(x, y, radius) {
    context.strokeStyle = ink("--ink");
    context.lineWidth = 2;
    context.beginPath();
    context.arc(x, y, radius, 0, 2 * Math.PI);
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

  const featureAt = (method, i) => (data.features[method.kind[i] & FEATURE] || "") + (method.kind[i] & EXTRUDING ? "" : " (travel)");

  const atTime = (method, due) => {
    let low = 0, high = method.n - 1;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (method.due[middle] < due) low = middle + 1; else high = middle;
    }
    return low > 0 && due - method.due[low - 1] < method.due[low] - due ? low - 1 : low;
  };

  // Along the reference path, mm/s; null at the first point of a piece.
  const speedAt = (method, i) => {
    const seconds = i > 0 ? data.tick * (method.due[i] - method.due[i - 1]) : 0;
    if (!(seconds > 0) || method.kind[i] & BREAK) return null;
    const [a, b] = [place3(method, i - 1), place3(method, i)];
    return Math.hypot(b[0] - a[0], b[1] - a[1], b[2] - a[2]) / seconds;
  };

  function nearest(px, py) {
    const panel = panelAt(px, py);
    if (!panel) return null;
    const method = methods[panel.method], [first, last] = span(method);
    project(method, panel);
    let best = 144, found = -1;
    for (let i = first; i < last; i++) {
      const d = (method.x[i] - px) ** 2 + (method.y[i] - py) ** 2;
      if (d < best && visible(method, i)) [best, found] = [d, i];
    }
    return found < 0 ? null : { method, i: found, x: method.x[found], y: method.y[found] };
  }

  function point(px, py) {
    hover = nearest(px, py);
    tip.hidden = !hover;
    if (hover) {
      const { method, i } = hover, at = place3(method, i), speed = speedAt(method, i);
      const lines = methods.map((each) => `${each === method ? "▸ " : "   "}${micrometres(errorAt(each, each === method ? i : atTime(each, method.due[i])))} µm  ${each.short}`);
      const where = `X ${at[0].toFixed(2)}  Y ${at[1].toFixed(2)}  Z ${at[2].toFixed(2)} mm`;
      const how = `${(data.tick * method.due[i]).toFixed(2)} s${speed === null ? "" : `, ${speed.toFixed(0)} mm/s`}`;
      tip.textContent = [...lines, where, `layer ${data.layers[method.layer[i]].number}, ${featureAt(method, i)}`, how].join("\n");
      const room = root.clientWidth - tip.offsetWidth - 8;
      tip.style.left = `${Math.max(4, Math.min(px + 16, room))}px`;
      tip.style.top = `${py > tip.offsetHeight + 20 ? py - tip.offsetHeight - 12 : py + 16}px`;
    }
    redraw();
  }

  // ---- what is shown, in words ----

  function said() {
    const layer = data.layers[state.layer], feature = state.feature < 0 ? "" : `, ${data.features[state.feature]}`;
    const what = { all: "Whole print", this: `Layer ${layer.number}`, upto: `Up to layer ${layer.number}` }[state.range];
    const where = state.range === "all" ? `: ${data.layers.length} layer${data.layers.length > 1 ? "s" : ""} evaluated` : `, Z ${layer.z.toFixed(2)} mm`;
    const of = (m) => state.feature < 0 ? (state.range === "this" ? m.byLayer[state.layer] : null) : (state.range === "all" ? m.byFeature[state.feature] : null);
    const numbers = methods.map((m) => `${m.short} ${of(m)}`).join(" · ");
    return `${what}${feature}${where}${of(methods[0]) === null ? "" : ` — µm rms: ${numbers}`}`;
  }

  function saidOfMove() {
    const at = head();
    if (!at) return "all moves";
    const { method, i } = at, speed = speedAt(method, i);
    return `${(data.tick * method.due[i]).toFixed(2)} s · ${speed === null ? "–" : speed.toFixed(0)} mm/s · ${featureAt(method, i)} · ${micrometres(errorAt(method, i))} µm`;
  }

  const saidOfSize = () => `${state.exaggeration} × (up to ${(1e-3 * data.highest * state.exaggeration).toFixed(2)} mm)`;

  const forget = () => { hover = null; tip.hidden = true; };

  const parts = { root, find, canvas, tip, data, methods, view, start, state, most, redraw, point, panelAt, panels, said, saidOfMove, saidOfSize, forget, span, head };
  const actions = controls(parts);
  steer(parts, actions);
  new ResizeObserver(() => { view.fit = null; redraw(); }).observe(canvas);
  dark.addEventListener("change", () => redraw());

  if (canvas.clientWidth < 620) state.method = methods.length - 1;
  root.dataset.ready = "yes";
  actions.tell();
  redraw();
}

function extent(points, data, k) {
  let [low, high] = [Infinity, -Infinity];
  for (let i = 0; i < points.n; i++) {
    if (points.away && !(points.kind[i] & EXTRUDING)) continue;
    const value = data.origin[k] + data.grain * points.foot[3 * i + k];
    low = Math.min(low, value);
    high = Math.max(high, value);
  }
  return low <= high ? [low, high] : [data.origin[k], data.origin[k]]; // no plastic at all
}
