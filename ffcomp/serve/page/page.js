// The page's first half: tabs, machines, files that are dropped, and what is started. Jobs: jobs.js. What is asked of the server: asking.js.
import { ask, attempt, make } from "./asking.js";
import { showJobs } from "./jobs.js";

const one = (selector, within = document) => within.querySelector(selector);
const all = (selector, within = document) => [...within.querySelectorAll(selector)];
const QUICK_MS = 700, SLOW_MS = 5000;

// ---- tabs ----

const tabs = all("[role=tab]");
function open(tab) {
  for (const each of tabs) {
    each.setAttribute("aria-selected", each === tab);
    each.tabIndex = each === tab ? 0 : -1;
    one(`#${each.getAttribute("aria-controls")}`).hidden = each !== tab;
  }
  one(".machine").hidden = tab.id === "tab-machine";
}
tabs.forEach((tab) => {
  tab.addEventListener("click", () => open(tab));
  tab.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!step) return;
    const next = tabs[(tabs.indexOf(tab) + step + tabs.length) % tabs.length];
    open(next);
    next.focus();
  });
});

// ---- machines ----

const machines = one(".machines");
let known = [];
function showMachines(list) {
  if (JSON.stringify(list) === JSON.stringify(known)) return;
  known = list;
  const chosen = machines.value || localStorage.getItem("machine") || "";
  const groups = [["Yours", (m) => m.own], ["Delta", (m) => m.kinematics === "delta"], ["CoreXY", (m) => m.kinematics === "corexy"], ["Cartesian", () => true]];
  const left = new Set(list);
  machines.replaceChildren(make("option", { value: "", textContent: "Choose your printer" }));
  for (const [label, belongs] of groups) {
    const inside = [...left].filter(belongs);
    inside.forEach((each) => left.delete(each));
    if (inside.length) machines.append(make("optgroup", { label }, ...inside.map((m) => make("option", { value: m.name, textContent: m.printer && !m.own ? m.printer : m.name }))));
  }
  machines.value = list.some((m) => m.name === chosen) ? chosen : "";
  machineChosen();
}
function choose(name) {
  machines.value = name;
  machineChosen();
}
function machineChosen() {
  localStorage.setItem("machine", machines.value);
  const machine = known.find((each) => each.name === machines.value);
  one(".assumed").hidden = !(machine && /assumed dynamics/.test(machine.printer || ""));
  ready();
}
machines.addEventListener("change", machineChosen);

// ---- files ----

const dropped = { prints: [], config: [], captures: [], pictures: [] }; // {name, size, id, share, error}
let largest = Infinity; // bytes
const MANY = { prints: true, config: false, captures: true, pictures: true };

function upload(file, entry, redraw) {
  return new Promise((resolve) => {
    if (file.size > largest) {
      entry.error = `Larger than ${bytes(largest)}, the most that is taken here.`;
      redraw();
      resolve();
      return;
    }
    const request = new XMLHttpRequest(); // fetch() does not report the progress of an upload
    request.open("POST", `api/files?name=${encodeURIComponent(file.name)}`);
    request.setRequestHeader("X-ffcomp", "1");
    request.upload.onprogress = (event) => { entry.share = event.loaded / event.total; redraw(); };
    request.onloadend = () => {
      let answer = {};
      try { answer = JSON.parse(request.responseText); } catch { answer = { error: request.responseText }; }
      if (request.status === 201) entry.id = answer.id;
      else entry.error = answer.error || "The server does not answer.";
      redraw();
      resolve();
    };
    request.send(file);
  });
}

async function take(kind, files) {
  if (!MANY[kind]) dropped[kind].length = 0;
  const entries = [...files].map((file) => [file, { name: file.name, size: file.size, share: 0 }]);
  if (!MANY[kind]) entries.splice(1);
  dropped[kind].push(...entries.map(([, entry]) => entry));
  const redraw = () => { showFiles(kind); ready(); };
  redraw();
  if (kind === "config" && entries.length) suggestName(entries[0][0].name);
  const waiting = [...entries];
  const worker = async () => { for (let next; (next = waiting.shift());) await upload(next[0], next[1], redraw); };
  await Promise.all([worker(), worker(), worker()]);
}

function suggestName(file) {
  const stem = file.replace(/\.[^.]*$/, "").replace(/[^A-Za-z0-9_-]+/g, "-").replace(/^[-_]+/, "");
  if (!["printer", "config", ""].includes(stem)) one("#machine [name=name]").value = stem.slice(0, 60);
}

function showFiles(kind) {
  one(`.files[data-for=${kind}]`).replaceChildren(...dropped[kind].map((entry) => {
    const drop = make("button", { className: "plain", textContent: "remove", type: "button", onclick: () => { dropped[kind].splice(dropped[kind].indexOf(entry), 1); showFiles(kind); ready(); } });
    const state = entry.error ? make("span", { className: "error", textContent: entry.error })
      : make("span", { className: "size", textContent: entry.id ? bytes(entry.size) : `${Math.round(100 * entry.share)} %` });
    return make("li", {}, make("span", { className: "name", textContent: entry.name }), state, drop);
  }));
}

const PRINT = /\.(gcode|gco|g)$/i;
const bytes = (n) => (n < 1e6 ? `${Math.max(1, Math.round(n / 1e3))} kB` : `${(n / 1e6).toFixed(1)} MB`);

for (const kind of Object.keys(dropped)) {
  const place = one(`#drop-${kind}`), input = one("input", place);
  input.addEventListener("change", () => { take(kind, [...input.files]); input.value = ""; });
  place.addEventListener("dragover", (event) => { event.preventDefault(); place.classList.add("over"); });
  place.addEventListener("dragleave", () => place.classList.remove("over"));
  place.addEventListener("drop", (event) => { event.preventDefault(); place.classList.remove("over"); take(kind, event.dataTransfer.files); });
}
for (const name of ["dragover", "drop"]) addEventListener(name, (event) => event.preventDefault()); // a file dropped elsewhere does not replace the page

// ---- what is started ----

const here = (kind) => dropped[kind].filter((entry) => entry.id);
const arriving = (kind) => dropped[kind].some((entry) => !entry.id && !entry.error);

/** What each job still needs, in words; empty: it can start. */
function needs() {
  const machine = machines.value ? "" : "choose your printer";
  const files = (kind, what) => machine || (arriving(kind) ? "wait for the files" : here(kind).length ? "" : what);
  const prints = files("prints", "drop a print"), captures = files("captures", "drop the captures");
  const plan = one("#plans").selectedOptions[0]?.dataset.kind || ""; // captures serve what their moves were made for
  const recorded = here("captures").filter((entry) => PRINT.test(entry.name)).length; // a recorded print is its own plan
  const tests = recorded ? "remove the print from the captures" : "";
  return {
    compensate: prints, compare: prints, import: here("config").length ? "" : "drop a configuration",
    plan: machine, excite: machine, page: machine, ringing: machine,
    scan: files("pictures", "drop the picture") || (one("#pages").value ? "" : "choose the page that you printed"),
    fit: captures || tests || (plan === "plan" ? "choose moves that fit the numbers, and drop their captures" : ""),
    diagnose: captures || tests || (plan === "plan" ? "" : "choose moves that find a missing effect, and drop their captures"),
    update: captures || (recorded === 1 && here("captures").length > 1 ? "" : "drop one recorded print together with its captures"),
  };
}

/** Enable what can start; below the buttons of each row stands what the others need. */
function ready() {
  const needed = needs();
  for (const row of all("p.do")) {
    const buttons = all("[data-job]", row), missing = new Map(); // what is needed: the buttons that need it
    if (!buttons.length) continue;
    for (const button of buttons) {
      const why = needed[button.dataset.job];
      button.disabled = why !== "";
      if (why) missing.set(why, [...(missing.get(why) || []), button.textContent]);
    }
    const enabled = buttons.some((button) => !button.disabled);
    const sentences = [...missing].map(([why, names]) => (missing.size === 1 && !enabled ? `First ${why}.` : `${names.join(", ")}: first ${why}.`));
    let note = row.nextElementSibling;
    if (!note?.classList.contains("why")) row.after((note = make("p", { className: "read why" })));
    note.textContent = sentences.join(" ");
  }
}

let forms = {}; // of each kind of job, as the verbs' requests declare them: {name, label, help, kind, choices, placeholder, low, high, step}

function field({ name, label, help, kind, choices, placeholder, low, high, step }) {
  if (kind === "check") return make("label", { className: "check", title: help }, make("input", { type: "checkbox", name }), ` ${label}`);
  const input = choices.length
    ? make("select", { name }, make("option", { value: "", textContent: "automatic" }), ...choices.map((value) => make("option", { value, textContent: value })))
    : make("input", { name, type: kind, placeholder, ...(kind === "number" ? { min: low ?? "", max: high ?? "", step } : {}) });
  return make("label", { className: "field", title: help }, label, input);
}

/** Forms that several kinds of job share show each option once. */
async function drawForms() {
  forms = await ask("api/forms");
  for (const place of all("[data-form]")) {
    const shown = new Map(place.dataset.form.split(" ").flatMap((kind) => forms[kind]).reverse().map((each) => [each.name, each]));
    place.replaceChildren(...[...shown.values()].reverse().sort((a, b) => (a.kind === "check") - (b.kind === "check")).map(field));
  }
}

/** The options of a kind of job that are set. */
function options(kind) {
  const panel = one(`[data-form~=${kind}]`);
  if (!panel) return {};
  return Object.fromEntries(forms[kind].map(({ name }) => one(`[name=${name}]`, panel)).map((input) => [input.name, input.type === "checkbox" ? input.checked : input.value.trim()])
    .filter(([, value]) => value !== "" && value !== false));
}

async function start(kind, files, more = {}) {
  const job = await ask("api/jobs", { kind, machine: machines.value, files, options: options(kind), ...more });
  if (kind === "import") imports.add(job.id);
}

const imports = new Set(); // that this page has started: their machine is chosen as soon as it is there
function chooseImported(jobs) {
  for (const job of jobs) if (imports.has(job.id) && job.kept) { imports.delete(job.id); choose(job.kept); }
}

const STARTS = {
  compensate: async () => { for (const entry of here("prints")) await start("compensate", [entry.id]); clear("prints"); },
  compare: async () => { for (const entry of here("prints")) await start("compare", [entry.id]); },
  import: async () => { await start("import", here("config").map((each) => each.id)); clear("config"); },
  plan: () => start("plan", []),
  excite: () => start("excite", []),
  page: () => start("page", []),
  ringing: () => start("ringing", []),
  diagnose: () => measured("diagnose"),
  fit: () => measured("fit"),
  update: () => start("update", ids("captures")),
  scan: () => start("scan", ids("pictures"), { plan: one("#pages").value }),
};
const ids = (kind) => here(kind).map((each) => each.id);
const measured = (kind) => start(kind, ids("captures"), { plan: one("#plans").value });

function clear(kind) {
  dropped[kind].length = 0;
  showFiles(kind);
  ready();
}

all("[data-job]").forEach((button) => button.addEventListener("click", async () => {
  button.disabled = true;
  await attempt(STARTS[button.dataset.job]);
  ready();
  await look();
}));

for (const id of ["#plans", "#pages"]) one(id).addEventListener("change", ready);
function showPlans(jobs) {
  offer(one("#plans"), jobs.filter((job) => ["plan", "excite"].includes(job.kind) && job.state === "done"), "none: resonance tests, or a print");
  offer(one("#pages"), jobs.filter((job) => job.kind === "page" && job.state === "done"), "none");
}
function offer(select, plans, without) {
  const chosen = select.value, shown = [...select.options].map((each) => each.value);
  if (shown.length && plans.map((job) => job.id).join() === shown.filter(Boolean).join()) return;
  const none = make("option", { value: "", textContent: plans.length ? without : "none yet: start with the button above" });
  const option = (job) => make("option", { value: job.id, textContent: `${job.title}, ${new Date(1000 * job.ended).toLocaleString()}` });
  const options = plans.map(option);
  options.forEach((each, k) => { each.dataset.kind = plans[k].kind; });
  const newest = plans.length > 0 && !shown.includes(plans[0].id);
  select.replaceChildren(...options, none);
  select.value = !newest && plans.some((job) => job.id === chosen) ? chosen : plans.length ? plans[0].id : "";
  ready();
}

// ---- watching ----

let timer;
async function look() {
  clearTimeout(timer);
  let active = false;
  try {
    const state = await ask("api/state");
    one("#version").textContent = `Version ${state.version}.`;
    largest = state.largest_mb * 1048576;
    showMachines(state.machines);
    chooseImported(state.jobs);
    showPlans(state.jobs);
    showJobs(state.jobs, { choose, look });
    active = state.jobs.some((job) => ["queued", "running"].includes(job.state));
    if (one("#trouble").dataset.lost) { one("#trouble").hidden = true; delete one("#trouble").dataset.lost; }
  } catch (error) {
    const trouble = one("#trouble");
    trouble.textContent = /fetch/i.test(error.message) ? "The server does not answer: is it still running?" : error.message;
    trouble.hidden = false;
    trouble.dataset.lost = "yes";
  }
  timer = setTimeout(look, active ? QUICK_MS : SLOW_MS);
}
addEventListener("visibilitychange", () => { if (!document.hidden) look(); });
open(tabs[0]);
attempt(drawForms).then(look);
