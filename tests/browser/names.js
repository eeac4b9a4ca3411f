// What the legends of several runs say.
answer(async () => {
  const names = (panel) => [...panel.querySelectorAll(".u-series:not(.unseen) button span")];
  return {
    runs: all(".runs span").map(({ textContent }) => textContent),
    names: all(".panel").flatMap(names).map(({ textContent }) => textContent),
    shown: names(one(".panel:has(.u-legend)")).filter(({ className }) => className !== "unseen").map(({ textContent }) => textContent).sort(),
  };
});
