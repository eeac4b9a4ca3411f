// Numbers where there is too little for a curve, no position in a gap, how wide the page is.
const positionsAt = async (instants) => {
  const { columns } = await unpack();
  const robot = pageData.scenes.trajectory.layers.find(({ label }) => label === "robot");
  const track = { t: columns[robot.t], x: columns[robot.x], y: columns[robot.y] };
  return instants.map((instant) => poseAt(track, instant) !== null);
};
answer(async () => ({
  only: all(".only").map(({ textContent }) => textContent),
  curves: all(".beside .uplot").length,
  sliders: all(".timeline input").length,
  sideways: document.documentElement.scrollWidth - innerWidth,
  wide: all("main *").filter((part) => !part.closest(".scroll, .unseen, .uplot, canvas") && part.getBoundingClientRect().right > innerWidth + 1).length,
  stays: one(".map") ? getComputedStyle(one(".map")).position : "",
  known: await positionsAt([0, 1.5, 15, 33]),
}));
