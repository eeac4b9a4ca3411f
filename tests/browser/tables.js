// Heads of a table sort it, a button shows the folded ones.
answer(async () => {
  const rows = (name) => [...document.getElementById(name).tBodies[0].rows].filter((row) => getComputedStyle(row).display !== "none");
  const names = () => rows("runs").map((row) => row.cells[0].firstChild.textContent);
  const say = { sideways: document.documentElement.scrollWidth - innerWidth, folded: rows("runs").length };
  one("[data-unfold=runs]").click();
  say.unfolded = rows("runs").length;
  const head = all("#runs th button").find(({ textContent }) => textContent.startsWith("position error"));
  head.click();
  say.rising = names().slice(0, 3);
  head.click();
  say.falling = [...names().slice(0, 3), names().at(-1)];
  say.sorted = head.closest("th").getAttribute("aria-sort");
  return say;
});
