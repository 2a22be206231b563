// Tables that sort by a click on their heads.
"use strict";

function sortable(table) {
  const bodies = [...table.tBodies];
  const home = bodies.map((body) => [...body.rows]);
  const heads = [...table.tHead.rows].at(-1).querySelectorAll("button");
  heads.forEach((button) => button.addEventListener("click", () => {
    const cell = button.closest("th"), column = cell.cellIndex;
    const next = { none: "ascending", ascending: "descending", descending: "none" }[cell.getAttribute("aria-sort") || "none"];
    heads.forEach((other) => other.closest("th").setAttribute("aria-sort", "none"));
    cell.setAttribute("aria-sort", next);
    table.classList.toggle("sorted", next !== "none");
    if (next === "none") return bodies.forEach((body, k) => body.append(...home[k]));
    const sign = next === "ascending" ? 1 : -1;
    const value = (row) => {
      const key = row.cells[column].dataset.key;
      return key === "" ? NaN : isNaN(key) ? key : Number(key);
    };
    const order = (a, b) => {
      const [p, q] = [value(a), value(b)];
      if (Number.isNaN(p) || Number.isNaN(q)) return Number.isNaN(p) - Number.isNaN(q); // what is missing comes last
      return sign * (typeof p === "string" ? p.localeCompare(q) : p - q);
    };
    const rows = home.flat().filter((row) => !row.classList.contains("family"));
    bodies[0].append(...rows.sort(order));
  }));
}

document.querySelectorAll("table.sortable").forEach(sortable);
