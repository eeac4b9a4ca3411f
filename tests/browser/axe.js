// What axe-core (https://github.com/dequelabs/axe-core) finds that keeps people from using the page.
answer(async () => {
  const { violations } = await axe.run(document);
  const bad = violations.filter(({ impact }) => impact === "serious" || impact === "critical");
  return { bad: bad.map(({ id, nodes }) => [id, nodes[0].html.slice(0, 200)]) };
});
