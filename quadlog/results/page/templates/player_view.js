"use strict";
// The picture of the player: what is seen of the map, and everything that is drawn on it.
// extra: draws more, under the window's grid and over the trails, with the tools of this picture.
const openView = (data, scene, canvas, extra = {}) => {
  const FOLLOWED_M = 12; // across, around the robot that is followed
  const LEAST = 12; // pixels per metre of a whole run that shows more than dots
  const FEET = [[0.36, 0.62], [0.36, -0.62], [-0.36, 0.62], [-0.36, -0.62]]; // nominal, in lengths and widths
  const pen = canvas.getContext("2d");
  const [left, right, bottom, top] = data.extent;
  const walker = data.tracks[data.tracks.length - 1];
  const names = ["card", "line", "text", "soft", "wall", "robot", "target", "plan", "resim", "note", "fix", "bad"];
  const trails = data.tracks.map(({ t, x, y }) => {
    const trail = new Path2D();
    t.forEach((when, at) => {
      const joined = at > 0 && when - t[at - 1] <= 1000 * data.hold.track;
      trail[joined ? "lineTo" : "moveTo"](x[at] / 1000, y[at] / 1000);
    });
    return trail;
  });
  let colors = {};
  let size = { x: 1, y: 1 };
  let view = { x: (left + right) / 2, y: (bottom + top) / 2, scale: 1 };
  let follow = false;

  const layer = (width, height) => Object.assign(document.createElement("canvas"), { width, height });
  const tint = (picture, color) => {
    const brush = picture.getContext("2d");
    brush.globalCompositeOperation = "source-in";
    brush.fillStyle = color;
    brush.fillRect(0, 0, picture.width, picture.height);
    brush.globalCompositeOperation = "source-over";
  };
  // The grid of each run's window, painted again only when another map begins.
  const grids = data.windows.map((windows) => {
    const grid = layer(windows.columns, windows.rows);
    return { windows, grid, image: grid.getContext("2d").createImageData(grid.width, grid.height), painted: -1 };
  });
  const paintGrid = (each, at) => {
    if (at === each.painted) return;
    each.painted = at;
    scene.paint(each.windows, at, each.image);
    each.grid.getContext("2d").putImageData(each.image, 0, 0);
    tint(each.grid, colors[each.windows.color]);
  };
  // Walls of the whole run, as the chart of the trajectory has them.
  const allWalls = (typeof chartData === "object" && chartData.trajectory?.walls) || [];
  let backdrops = [];
  const paintWalls = (walls) => {
    if (!walls.runs.length) return [];
    const ends = [[Infinity, -Infinity], [Infinity, -Infinity]];
    for (let at = 0; at < walls.runs.length; at += 3) {
      const [row, first, long] = walls.runs.slice(at, at + 3);
      ends[0] = [Math.min(ends[0][0], first), Math.max(ends[0][1], first + long)];
      ends[1] = [Math.min(ends[1][0], row), Math.max(ends[1][1], row + 1)];
    }
    const [wide, high] = ends.map(([low, past]) => past - low);
    if (wide * high > 2 ** 24) return []; // the browser may not have such a canvas
    const picture = layer(wide, high);
    const brush = picture.getContext("2d");
    brush.fillStyle = colors.wall;
    for (let at = 0; at < walls.runs.length; at += 3) {
      brush.fillRect(walls.runs[at + 1] - ends[0][0], ends[1][1] - 1 - walls.runs[at], walls.runs[at + 2], 1);
    }
    const cell = walls.cell_m;
    return [{ picture, x: walls.x + ends[0][0] * cell, y: walls.y + ends[1][0] * cell, cell }];
  };

  const x = (metres) => size.x / 2 + (metres - view.x) * view.scale;
  const y = (metres) => size.y / 2 - (metres - view.y) * view.scale;
  const cells = (picture, from, up, cell) => {
    pen.imageSmoothingEnabled = false;
    const [wide, high] = [picture.width * cell * view.scale, picture.height * cell * view.scale];
    pen.drawImage(picture, x(from), y(up) - high, wide, high);
    return [x(from), y(up) - high, wide, high];
  };
  const line = (points, color, width, dash = []) => {
    pen.strokeStyle = color;
    pen.lineWidth = width;
    pen.setLineDash(dash);
    pen.beginPath();
    points.forEach(([px, py], at) => pen[at ? "lineTo" : "moveTo"](x(px), y(py)));
    pen.stroke();
    pen.setLineDash([]);
  };
  const dot = (px, py, radius, fill, edge) => {
    pen.beginPath();
    pen.arc(x(px), y(py), radius, 0, 2 * Math.PI);
    if (fill) {
      pen.fillStyle = fill;
      pen.fill();
    }
    if (edge) {
      pen.strokeStyle = edge;
      pen.lineWidth = 1.5;
      pen.stroke();
    }
  };

  const drawTrail = (trail, color) => {
    pen.save();
    pen.translate(size.x / 2 - view.x * view.scale, size.y / 2 + view.y * view.scale);
    pen.scale(view.scale, -view.scale);
    pen.globalAlpha = 0.45;
    pen.lineWidth = 1.5 / view.scale;
    pen.strokeStyle = color;
    pen.stroke(trail);
    pen.restore();
  };
  const drawFeet = (bits, turned, color) => {
    if (bits === undefined || bits < 0) return;
    FEET.forEach(([ahead, aside], leg) => {
      const stands = (bits >> leg) & 1;
      dot(...turned(ahead * data.body[0], aside * data.body[1]), Math.max(2, 0.035 * view.scale), stands ? color : null, color);
    });
  };
  const drawBody = (track, pose) => {
    const color = colors[track.color];
    const [long, wide] = data.body ?? [0, 0];
    if (!track.body || pose.yaw === null || long * view.scale < 6) dot(pose.x, pose.y, 5, color, colors.card);
    if (!track.body || pose.yaw === null) return;
    const [cos, sin] = [Math.cos(pose.yaw), Math.sin(pose.yaw)];
    const turned = (ahead, aside) => [pose.x + ahead * cos - aside * sin, pose.y + ahead * sin + aside * cos];
    const corners = [[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 1]].map(([a, b]) => turned((a * long) / 2, (b * wide) / 2));
    line(corners, color, 2);
    pen.globalAlpha = 0.3;
    pen.fillStyle = color;
    pen.fill();
    pen.globalAlpha = 1;
    line([turned(0, 0), turned(long * 0.8, 0)], color, 2);
    drawFeet(track.feet[pose.row], turned, color);
  };
  const drawTarget = (pose, color) => {
    pen.fillStyle = color;
    pen.strokeStyle = colors.card;
    pen.lineWidth = 1;
    pen.beginPath();
    for (let tip = 0; tip < 10; tip++) {
      const [radius, angle] = [tip % 2 ? 4 : 10, (tip * Math.PI) / 5 - Math.PI / 2];
      pen.lineTo(x(pose.x) + radius * Math.cos(angle), y(pose.y) + radius * Math.sin(angle));
    }
    pen.closePath();
    pen.fill();
    pen.stroke();
  };
  const drawLookahead = (track, pose, path) => {
    const reach = track.lookahead[pose.row] / 1000;
    if (!path.length || !(reach > 0)) return;
    const point = lookaheadPoint(path, pose, reach);
    line([[pose.x, pose.y], point], colors.note, 1.5, [3, 3]);
    dot(...point, 5, colors.note, colors.card);
  };
  const drawContacts = (seconds) => {
    for (const { x: px, y: py, collision, seconds: from, until, run } of data.contacts) {
      const [now, half] = [from <= seconds + 1e-3 && seconds <= until + 0.3, 6];
      const color = collision ? colors.bad : colors.note;
      pen.globalAlpha = from <= seconds + 1e-3 ? 1 : 0.45;
      pen.strokeStyle = color;
      pen.lineWidth = now ? 4 : 2;
      pen.beginPath();
      for (const [a, b] of [[-1, -1], [1, 1], [-1, 1], [1, -1]]) {
        pen[a === -1 ? "moveTo" : "lineTo"](x(px) + a * half, y(py) + b * half);
      }
      pen.stroke();
      if (now) dot(px, py, 14, null, color);
      pen.fillStyle = color;
      if (run) pen.fillText(run, x(px) + half + 3, y(py) - half);
      pen.globalAlpha = 1;
    }
  };
  const drawAnchors = () => {
    pen.fillStyle = colors.soft;
    for (const { label, x: px, y: py } of data.anchors) {
      pen.beginPath();
      pen.moveTo(x(px), y(py) - 5);
      pen.lineTo(x(px) + 5, y(py) + 5);
      pen.lineTo(x(px) - 5, y(py) + 5);
      pen.fill();
      pen.fillText(label, x(px) + 9, y(py) + 5);
    }
  };
  const drawScale = () => {
    const metres = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000].find((each) => each * view.scale > 50) ?? 1000;
    const [from, height] = [12, size.y - 12];
    // Over cells of any colour.
    pen.globalAlpha = 0.8;
    pen.fillStyle = colors.card;
    pen.fillRect(from - 4, height - 20, metres * view.scale + 8, 26);
    pen.globalAlpha = 1;
    pen.strokeStyle = pen.fillStyle = colors.text;
    pen.lineWidth = 2;
    pen.strokeRect(from, height, metres * view.scale, 0.01);
    pen.fillText(`${metres} ${data.unit ?? "m"}`, from, height - 6);
  };

  const tools = { pen, x, y, line, cells, layer, tint };
  const draw = (seconds) => {
    const poses = data.tracks.map((track) => scene.pose(track, seconds));
    const walkers = poses.filter((pose, index) => pose && data.tracks[index].key === walker.key);
    const led = walkers.length ? walkers : [...poses].reverse().filter((pose) => pose).slice(0, 1);
    const middle = (axis) => led.reduce((sum, pose) => sum + pose[axis], 0) / led.length;
    if (follow && led.length) view = { ...view, x: middle("x"), y: middle("y") };
    const sharp = canvas.width / size.x;
    pen.setTransform(sharp, 0, 0, sharp, 0, 0);
    pen.fillStyle = colors.card;
    pen.fillRect(0, 0, size.x, size.y);
    pen.font = "12px system-ui, sans-serif";
    pen.lineJoin = "round";
    pen.globalAlpha = 0.4;
    for (const { picture, x: fromX, y: fromY, cell } of backdrops) cells(picture, fromX, fromY, cell);
    pen.globalAlpha = 1;
    for (const each of grids) {
      const { x: fromX, y: fromY, cell, column, row } = each.windows;
      const at = scene.window(each.windows, seconds);
      if (at < 0) continue;
      paintGrid(each, at);
      extra.under?.(tools, at);
      pen.globalAlpha = grids.length > 1 ? 0.6 : 1; // cells of both runs are to be seen
      pen.strokeStyle = colors.line;
      pen.lineWidth = 1;
      pen.strokeRect(...cells(each.grid, fromX + column[at] * cell, fromY + row[at] * cell, cell));
      pen.globalAlpha = 1;
    }
    drawAnchors();
    data.tracks.forEach((track, index) => drawTrail(trails[index], colors[track.color]));
    for (const cloud of scene.clouds(seconds)) {
      pen.fillStyle = colors[cloud.color];
      cloud.x.forEach((px, index) => pen.fillRect(x(px / 1000) - 1, y(cloud.y[index] / 1000) - 1, 2, 2));
    }
    extra.over?.(tools, seconds);
    const planned = data.paths.map((paths) => scene.path(paths, seconds));
    data.paths.forEach((paths, index) => {
      line(planned[index], colors[paths.color], paths.main ? 3 : 2, paths.main ? [] : [6, 4]);
    });
    data.tracks.forEach((track, index) => {
      const pose = poses[index];
      if (!pose) return;
      if (track.key === "target") drawTarget(pose, colors[track.color]);
      else drawBody(track, pose);
      const plan = data.paths.findIndex(({ walker, run }) => walker === track.key && run === track.run);
      if (track.lookahead.length && plan >= 0) drawLookahead(track, pose, planned[plan]);
    });
    drawContacts(seconds);
    drawScale();
  };

  const whole = () => {
    follow = false;
    const scale = Math.min(size.x / (right - left + 3), size.y / (top - bottom + 3));
    view = { x: (left + right) / 2, y: (bottom + top) / 2, scale };
  };
  const near = (across = FOLLOWED_M) => {
    follow = true;
    view = { ...view, scale: Math.min(size.x, size.y) / across };
  };
  const recolor = () => {
    colors = Object.fromEntries(names.map((name) => [name, painted(name)()]));
    for (const each of grids) each.painted = -1;
    backdrops = allWalls.flatMap(paintWalls);
  };
  const resize = (width, height) => {
    const before = size;
    size = { x: width, y: height };
    const sharp = Math.min(devicePixelRatio, 2);
    Object.assign(canvas, { width: Math.round(width * sharp), height: Math.round(height * sharp) });
    canvas.style.height = `${height}px`;
    view = { ...view, scale: (view.scale * width) / before.x };
  };
  recolor();
  return {
    draw, recolor, resize, whole, near,
    isSmall: () => view.scale < LEAST,
    follows: () => follow,
    zoom: (factor) => (view = { ...view, scale: Math.min(2000, Math.max(0.05, view.scale * factor)) }),
    pan: (dx, dy) => {
      follow = false;
      view = { ...view, x: view.x - dx / view.scale, y: view.y + dy / view.scale };
    },
    walker,
  };
};
