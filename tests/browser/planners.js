// How many pixels of the first question's map have the colour of each path, and what keys and charts do.
answer(async () => {
  press("Home");
  await wait(50);
  const seen = ["robot", "target", "plan"].map(pixels);
  const keys = ["ArrowRight", "ArrowRight", "ArrowLeft"].map((key) => (press(key), now()));
  const heads = all(".playhead").filter((head) => !head.hidden).length;
  return { seen, keys, clock: one(".clock").textContent, charts: all(".uplot").length, heads };
});
