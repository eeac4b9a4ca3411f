"use strict";
// Tables: a click on a head sorts, a button shows folded rows.
for (const head of document.querySelectorAll("th button")) {
  head.addEventListener("click", () => {
    const cell = head.closest("th");
    const up = cell.getAttribute("aria-sort") !== "ascending";
    for (const other of cell.parentNode.cells) other.removeAttribute("aria-sort");
    cell.setAttribute("aria-sort", up ? "ascending" : "descending");
    const body = cell.closest("table").tBodies[0];
    const key = ({ cells: { [cell.cellIndex]: one } }) => one.dataset.value ?? one.textContent.replace(/^–$/, "");
    const compare = (a, b) => {
      const [one, other] = [key(a), key(b)];
      if (one === "" || other === "") return (one === "") - (other === ""); // no value comes last
      const order = Number.isFinite(Number(one)) && Number.isFinite(Number(other)) ? one - other : one.localeCompare(other);
      return up ? order : -order;
    };
    body.append(...[...body.rows].sort(compare));
  });
}
for (const more of document.querySelectorAll("[data-unfold]")) {
  more.addEventListener("click", () => {
    for (const row of document.querySelectorAll(`#${CSS.escape(more.dataset.unfold)} tr.folded`)) row.classList.remove("folded");
    more.remove();
  });
}
