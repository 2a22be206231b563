// The page's second half: jobs as cards, each redrawn only if it has changed.
import { ask, attempt, make } from "./asking.js";

const WORDS = { queued: "waits", running: "runs", done: "done", failed: "failed", cancelled: "cancelled" };
const MOST_FACTS = 8; // more are folded: the picture and the finding come first
const drawn = new Map(); // id -> {text, card}

/** Draw the jobs; a card asks the page by {choose, look} to choose a machine and to look again. */
export function showJobs(jobs, page) {
  const place = document.querySelector("#jobs");
  document.querySelector("#nothing").hidden = jobs.length > 0;
  const ids = new Set(jobs.map((job) => job.id));
  for (const [id, { card }] of drawn) if (!ids.has(id)) { card.remove(); drawn.delete(id); }
  jobs.forEach((job, k) => {
    const text = JSON.stringify(job);
    let old = drawn.get(job.id);
    if (!old || old.text !== text) {
      const card = old && job.state === "running" && old.state === "running" ? advance(old.card, job) : cardOf(job, page);
      if (old && old.card !== card) old.card.replaceWith(card);
      drawn.set(job.id, (old = { text, card, state: job.state }));
    }
    if (place.children[k] !== old.card) place.insertBefore(old.card, place.children[k] || null);
  });
}

/** A card of a job that still runs: only its progress moves, so that nothing under the pointer does. */
function advance(card, job) {
  const bar = card.querySelector("progress");
  if (job.share === null) bar.removeAttribute("value"); else bar.value = job.share;
  card.querySelector(".doing").textContent = job.doing;
  return card;
}

function cardOf(job, page) {
  const card = make("article", { className: "job" });
  card.dataset.state = job.state;
  card.dataset.kind = job.kind;
  card.append(make("header", {}, make("h3", { textContent: job.title }), make("span", {},
    make("span", { className: `state ${job.state}`, textContent: WORDS[job.state] }), " ", make("span", { className: "when", textContent: when(job) }))));
  if (["queued", "running"].includes(job.state)) card.append(...underway(job));
  if (job.state === "failed") card.append(make("p", { className: "error", textContent: job.error }));
  if (job.state === "done" || job.answer.headline) card.append(...found(job));
  card.append(buttons(job, page));
  if (job.state !== "queued") card.append(log(job));
  return card;
}

function when(job) {
  const machine = job.machine && !job.title.includes(job.machine) ? `on ${job.machine}, ` : "";
  return machine + new Date(1000 * (job.ended || job.started || job.created)).toLocaleTimeString([], { hour: "2-digit", minute: "2-digit" });
}

function underway(job) {
  const bar = make("progress", { max: 1 });
  bar.setAttribute("aria-label", job.title);
  if (job.share !== null) bar.value = job.share;
  return [bar, make("p", { className: "read doing", textContent: job.doing || "waits for its turn" })];
}

function found(job) {
  const { headline, facts = [], warnings = [], next_steps: steps = [] } = job.answer;
  const parts = [];
  if (headline) parts.push(make("p", { className: "lead", textContent: headline }));
  if (job.state === "done" && job.outputs.includes("picture.svg")) parts.push(picture(job));
  if (job.kept) parts.push(make("p", { className: "read", textContent: `Kept among your machines as ${job.kept}, and chosen.` }));
  if (facts.length) {
    const rows = facts.map(([name, value]) => make("tr", {}, make("th", { textContent: name, scope: "row" }), make("td", { textContent: value })));
    const table = make("table", { className: "facts" }, make("tbody", {}, ...rows));
    parts.push(facts.length > MOST_FACTS ? make("details", {}, make("summary", { textContent: `All ${facts.length} numbers` }), table) : table);
  }
  if (warnings.length) parts.push(list("Warnings", warnings));
  if (steps.length) parts.push(list("To do", steps));
  return parts;
}

function picture(job) {
  const source = file(job, "picture.svg", true);
  const whole = make("img", { src: source, loading: "lazy", alt: job.answer.headline || job.title });
  const panel = job.outputs.includes("panel.svg") ? [make("source", { media: "(max-width: 620px)", srcset: file(job, "panel.svg", true) })] : [];
  return make("a", { href: source, target: "_blank", rel: "noopener" }, make("picture", {}, ...panel, whole));
}

function list(title, sentences) {
  return make("div", {}, make("h3", { textContent: title }), make("ul", { className: "warnings" }, ...sentences.map((each) => make("li", { textContent: each }))));
}

const file = (job, name, view) => `api/jobs/${job.id}/files/${encodeURIComponent(name)}${view ? "?view=1" : ""}`;

function buttons(job, page) {
  const row = make("p", { className: "do" });
  const act = (name, label, className = "") => row.append(make("button", { textContent: label, className, onclick: async (event) => {
    event.target.disabled = true;
    await attempt(() => ask(`api/jobs/${job.id}/${name}`, {}));
    event.target.disabled = false;
    await page.look();
  } }));
  if (["queued", "running"].includes(job.state)) { act("cancel", "Cancel"); return row; }
  if (job.state === "done") {
    if (job.outputs.includes("report.html")) row.append(make("a", { className: "button main", href: file(job, "report.html", true), target: "_blank", rel: "noopener", textContent: "Open the report" }));
    if (job.outputs.includes("better.toml")) row.append(keeping(job, page));
    for (const name of job.outputs.filter((each) => !["picture.svg", "panel.svg", "report.html"].includes(each)))
      row.append(make("a", { className: /\.(toml|json)$/.test(name) ? "button" : "button main", href: file(job, name, false), download: name, textContent: `Download ${job.kind === "compensate" ? "the print" : name}` }));
  } else act("again", "Again");
  act("remove", "Remove", "plain");
  return row;
}

/** A name for the better machine file, and the button that keeps it under that. */
function keeping(job, page) {
  const name = make("input", { value: `${job.machine}-measured`.slice(0, 60), ariaLabel: "Name of the better machine file" });
  const keep = make("button", { className: "main", textContent: "Keep as my machine", onclick: async () => {
    const answer = await attempt(() => ask(`api/jobs/${job.id}/keep`, { name: name.value.trim() }));
    await page.look();
    if (answer) { page.choose(answer.machine); keep.textContent = `Kept and chosen: ${answer.machine}`; keep.disabled = true; }
  } });
  return make("span", { className: "keep" }, name, keep);
}

function log(job) {
  const text = make("pre");
  const part = make("details", {}, make("summary", { textContent: "Log" }), text);
  part.addEventListener("toggle", async () => {
    if (part.open) text.textContent = await (await fetch(`api/jobs/${job.id}/log`)).text();
  });
  return part;
}
