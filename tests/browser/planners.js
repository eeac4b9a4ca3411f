// How many pixels of the first question's map have the colour of each path.
answer(async () => {
  press("Home");
  await wait(50);
  return { seen: ["robot", "target", "plan"].map(pixels) };
});
