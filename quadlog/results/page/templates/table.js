"use strict";
// Tables: a click on a head sorts, a button shows folded rows, words filter, chosen rows make a command.
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

// Each word must be in a row; name>number compares the columns with that name, as they are shown.
for (const find of document.querySelectorAll("[data-filter]")) {
  const table = document.getElementById(find.dataset.filter);
  const heads = [...table.tHead.rows[0].cells].map((head) => `${head.textContent} ${head.title}`.toLowerCase());
  const shown = (cell) => Number.parseFloat(cell.textContent.replace("\u2212", "-"));
  const test = (word) => {
    const [, name, sign, equal, number] = /^([^<>]+)([<>])(=?)(-?[\d.]+)$/.exec(word) ?? [];
    if (name === undefined) return (row) => row.textContent.toLowerCase().includes(word);
    const columns = [...heads.keys()].filter((at) => heads[at].includes(name));
    const holds = (value) => (sign === ">" ? value > number : value < number) || (equal && value === Number(number));
    return ({ cells }) => columns.some((at) => holds(shown(cells[at])));
  };
  find.addEventListener("input", () => {
    const tests = find.value.toLowerCase().split(/\s+/).filter(Boolean).map(test);
    for (const row of table.tBodies[0].rows) row.hidden = !tests.every((holds) => holds(row));
  });
  const command = find.parentNode.querySelector("[data-command]");
  table.addEventListener("change", () => {
    const chosen = [...table.querySelectorAll(":checked")].map(({ value }) => value);
    command.textContent = chosen.length < 2 ? "" : `${command.dataset.command} ${chosen.join(" ")} -o side_by_side.html`;
  });
}
