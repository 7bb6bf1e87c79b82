"use strict";
// Headings of a table become buttons that sort its rows by their column.
const key = (row, place) => {
  const cell = row.cells[place];
  return "sort" in cell.dataset ? Number(cell.dataset.sort) : cell.textContent;
};
const isMissing = (key) => key === "\u2013";
const compare = (a, b) =>
  typeof a === "number" && typeof b === "number" ? a - b : String(a).localeCompare(b);
for (const table of document.querySelectorAll("table.sorts")) {
  const heads = [...table.tHead.rows[0].cells];
  const body = table.tBodies[0];
  heads.forEach((head, place) => {
    const button = document.createElement("button");
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => {
      const sign = head.getAttribute("aria-sort") === "ascending" ? -1 : 1;
      heads.forEach((other) => other.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", sign > 0 ? "ascending" : "descending");
      const rows = [...body.rows].map((row) => [key(row, place), row]);
      // Rows without a value stay at the end, in either direction.
      rows.sort(([a], [b]) => isMissing(a) - isMissing(b) || sign * compare(a, b));
      body.append(...rows.map(([, row]) => row));
    });
  });
}
