"use strict";
// The search field above the table of all metrics: rows that hold none of the words are hidden.
for (const field of document.querySelectorAll("[data-search]")) {
  const table = document.getElementById(field.dataset.search);
  const none = field.closest("p").querySelector("output");
  field.closest("p").hidden = false;
  field.addEventListener("input", () => {
    const words = field.value.toLowerCase().split(/\s+/).filter(Boolean);
    let found = 0;
    for (const body of table.tBodies) {
      let here = 0;
      for (const row of body.rows) {
        if (row.dataset.group !== undefined) continue;
        const text = `${body.rows[0].textContent} ${row.textContent}`.toLowerCase();
        row.hidden = !words.every((word) => text.includes(word));
        here += !row.hidden;
      }
      body.hidden = here === 0;
      found += here;
    }
    none.textContent = found ? "" : "No metric has these words.";
  });
}
