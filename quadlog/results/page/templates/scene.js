"use strict";
// A scene on a canvas: its layers, drawn over each other at an instant, and the part of the world in view.
// What stands still is drawn once for each view into two pictures: the ground, below the maps of an instant, and the
// ways and marks above them.
const DASHES = [[], [6, 4], [2, 3], [8, 3, 2, 3]];
const CORNERS = [[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 1]];
const SHAPES = {
  triangle: [[0, -1], [1, 1], [-1, 1]],
  cross: [[-1, -1], [1, 1], [0, 0], [1, -1], [-1, 1]],
};
const RING = new Path2D();
RING.arc(0, 0, 1, 0, 2 * Math.PI);
const COLUMNS = ["t", "until", "x", "y", "along", "cross", "aside", "yaw", "first", "row", "column"];

const modulo = (value, size) => ((value % size) + size) % size;
const rgb = (color) => {
  const probe = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
  probe.fillStyle = color;
  probe.fillRect(0, 0, 1, 1);
  return probe.getImageData(0, 0, 1, 1).data;
};

// {x, y, yaw} of a track at an instant, interpolated; null in gaps and outside of its time.
const poseAt = ({ t, x, y, yaw }, instant) => {
  const row = rowAt(t, instant);
  if (row < 0 || Number.isNaN(x[row])) return null;
  const next = Math.min(row + 1, t.length - 1);
  const known = next > row && !Number.isNaN(x[next]);
  if (!known && instant > t[row] + pageData.gap_s) return null;
  const share = known ? Math.min(1, Math.max(0, (instant - t[row]) / (t[next] - t[row]))) : 0;
  const between = (column) => (share > 0 ? column[row] + share * (column[next] - column[row]) : column[row]);
  return { x: between(x), y: between(y), yaw: yaw ? between(yaw) : NaN };
};

// The rows from first to last as a path in metres, broken at NaN.
const wayOf = (xs, ys, first = 0, last = xs.length) => {
  const path = new Path2D();
  for (let at = first, joined = false; at < last; at++) {
    const there = !Number.isNaN(xs[at]);
    if (there) path[joined ? "lineTo" : "moveTo"](xs[at], ys[at]);
    joined = there;
  }
  return path;
};

const openView = (scene, canvas, block) => {
  const picture = (width, height) => Object.assign(document.createElement("canvas"), { width, height }).getContext("2d");
  const screen = canvas.getContext("2d");
  const stills = [picture(1, 1), picture(1, 1)];
  let pen = screen;
  const layers = scene.layers.map((layer) => {
    const columns = COLUMNS.filter((name) => name in layer).map((name) => [name, block.columns[layer[name]]]);
    return { ...layer, bytes: block.cells[layer.cells], ...Object.fromEntries(columns) };
  });
  const tracks = layers.filter(({ kind }) => kind === "track");
  const walker = tracks.findLast(({ shape }) => shape === "body") ?? tracks[tracks.length - 1];
  const size = { x: 1, y: 1 };
  let view = { x: 0, y: 0, scale: 1 };
  let follow = false;
  const x = (metres) => size.x / 2 + (metres - view.x) * view.scale;
  const y = (metres) => size.y / 2 - (metres - view.y) * view.scale;
  const stroke = (color, width, variant = 0) => {
    Object.assign(pen, { strokeStyle: paint(color), fillStyle: paint(color), lineWidth: width, lineJoin: "round" });
    pen.setLineDash(DASHES[variant % 4]);
  };
  const outline = (corners) => {
    pen.beginPath();
    for (const corner of corners) pen.lineTo(...corner);
    return pen;
  };
  const shapeAt = (name, px, py, half) => outline(SHAPES[name].map(([dx, dy]) => [px + half * dx, py + half * dy]))[name === "cross" ? "stroke" : "fill"]();
  const dot = (px, py, radius, fill, edge) => {
    pen.beginPath();
    pen.arc(px, py, radius, 0, 2 * Math.PI);
    if (fill) Object.assign(pen, { fillStyle: fill }).fill();
    if (edge) Object.assign(pen, { strokeStyle: edge, lineWidth: 1.5 }).stroke();
  };
  const label = (text, px, py, color) => {
    Object.assign(pen, { font: "600 12px system-ui", lineWidth: 3, strokeStyle: paint("sheet"), fillStyle: paint(color) });
    pen.strokeText(text, px, py);
    pen.fillText(text, px, py);
    pen.strokeStyle = pen.fillStyle;
  };
  const putPicture = (cells, left, bottom, cell) => {
    pen.imageSmoothingEnabled = false;
    const [wide, high] = [cells.width * cell * view.scale, cells.height * cell * view.scale];
    pen.drawImage(cells, x(left), y(bottom) - high, wide, high);
    return [x(left), y(bottom) - high, wide, high];
  };
  const drawWay = (path, color, width, variant) => {
    pen.save();
    stroke(color, width / view.scale, variant);
    pen.setLineDash(pen.getLineDash().map((dash) => dash / view.scale));
    pen.translate(x(0), y(0));
    pen.scale(view.scale, -view.scale);
    pen.stroke(path);
    pen.restore();
  };

  // Each prepares a layer for the current colours and returns how to draw what stands still of it, and what an instant shows.
  const prepare = {
    raster: ({ bytes, rows, columns, origin: [left, bottom], cell, color }) => {
      const shades = new Uint8Array(4 * 256);
      for (let code = 1; code < 256; code++) shades.set([...rgb(paint(color)).slice(0, 3), 40 + (170 * (code - 1)) / 254], 4 * code);
      const inks = new Uint32Array(shades.buffer);
      const made = [];
      // Cells in blocks of so many, each as its largest value, so that nothing vanishes from a small picture.
      const inBlocks = (side) => {
        const [wide, high] = [Math.ceil(columns / side), Math.ceil(rows / side)];
        const largest = new Uint8Array(wide * high);
        for (let row = 0, at = 0; row < rows; row++) {
          const to = (high - 1 - Math.floor(row / side)) * wide;
          for (let column = 0; column < columns; column++, at++) {
            const block = to + Math.floor(column / side);
            if (bytes[at] > largest[block]) largest[block] = bytes[at];
          }
        }
        const [cells, image] = [picture(wide, high), new ImageData(wide, high)];
        new Uint32Array(image.data.buffer).set(Uint32Array.from(largest, (code) => inks[code]));
        cells.putImageData(image, 0, 0);
        return cells.canvas;
      };
      return [() => {
        const level = Math.max(0, Math.ceil(Math.log2(1 / (cell * view.scale))));
        made[level] ??= inBlocks(2 ** level);
        putPicture(made[level], left, bottom, cell * 2 ** level);
      }];
    },
    windows: (layer) => {
      const { bytes, t, rows, columns, column, row, color, cell } = layer;
      const [stride, brush] = [Math.ceil(columns / 8), picture(columns, rows)];
      const image = new ImageData(columns, rows);
      const pixels = new Uint32Array(image.data.buffer);
      const ink = new Uint32Array(new Uint8Array([...rgb(paint(color)).slice(0, 3), 255]).buffer)[0];
      if (!layer.open) for (let at = rows * stride; at < bytes.length; at++) bytes[at] ^= bytes[at - rows * stride];
      layer.open = true; // each map was stored as its difference from the one before
      let painted = -1;
      return [null, (instant) => {
        const at = rowAt(t, instant);
        if (at < 0) return;
        if (at !== painted) {
          painted = at;
          pixels.fill(0);
          for (let up = 0; up < rows; up++) {
            const from = (at * rows + modulo(row[at] + up, rows)) * stride;
            const to = (rows - 1 - up) * columns;
            for (let right = 0, bit = modulo(column[at], columns); right < columns; right++, bit++) {
              if (bit === columns) bit = 0;
              if (bytes[from + (bit >> 3)] & (128 >> (bit & 7))) pixels[to + right] = ink;
            }
          }
          brush.putImageData(image, 0, 0);
        }
        stroke("line", 1.5, 1);
        pen.strokeRect(...putPicture(brush.canvas, layer.origin[0] + column[at] * cell, layer.origin[1] + row[at] * cell, cell));
      }];
    },
    lines: (layer) => {
      const { first, x: xs, y: ys, t, color, variant, measured } = layer;
      if (!t) {
        const ways = Array.from(first.slice(1), (last, at) => wayOf(xs, ys, first[at], last));
        return [() => ways.forEach((way) => drawWay(way, color, 1.5, variant))];
      }
      return [null, (instant) => {
        const line = rowAt(t, instant);
        if (line < 0) return;
        const from = first[line];
        drawWay(wayOf(xs, ys, from, first[line + 1]), color, measured ? 2 : 2.5, variant);
        const length = measured ? Math.hypot(xs[from + 1] - xs[from], ys[from + 1] - ys[from]) : NaN;
        if (!(length >= 0)) return;
        dot(x(xs[from + 1]), y(ys[from + 1]), 4, paint(color), paint("back"));
        label(`${length.toFixed(2)} m`, x(xs[from + 1]) + 8, y(ys[from + 1]) - 6, color);
      }];
    },
    marks: ({ x: xs, y: ys, t, until, along, cross, aside, shape, names, color }) => {
      const half = shape !== "dot" ? 5 : xs.length > 200 && !t ? 1 : 2;
      const drawn = (instant) => {
        stroke(color, shape === "ring" ? 1.25 : 2.5);
        for (let at = 0; at < xs.length; at++) {
          if (t && (t[at] > instant || until[at] <= instant)) continue;
          const [px, py] = [x(xs[at]), y(ys[at])];
          if (shape === "ring") ring(xs[at], ys[at], along[at], cross[at], aside[at]);
          else if (px < -20 || py < -20 || px > size.x + 20 || py > size.y + 20) continue;
          else if (shape === "dot") pen.fillRect(px - half, py - half, 2 * half, 2 * half);
          else shapeAt(shape, px, py, half);
          if (names[at]) label(names[at], px + half + 4, py + half, color);
        }
      };
      return t ? [null, drawn] : [drawn];
    },
    track: (layer) => {
      const { x: xs, y: ys, shape, variant, color } = layer;
      const way = wayOf(xs, ys);
      const ofInstant = (instant) => {
        const pose = scene.span ? poseAt(layer, instant) : null;
        if (!pose) return;
        const [px, py, ink] = [x(pose.x), y(pose.y), paint(color)];
        stroke(color, 2);
        if (shape === "body" && scene.body && !Number.isNaN(pose.yaw)) drawBody(pose, ink);
        else dot(px, py, shape === "person" ? Math.max(6, 0.22 * view.scale) : 5, ink, paint("back"));
      };
      return [() => drawWay(way, color, 2.5, variant), ofInstant];
    },
  };
  const drawBody = (pose, color) => {
    if (scene.body[0] * view.scale < 10) return dot(x(pose.x), y(pose.y), 5, color, paint("back"));
    const [cos, sin] = [Math.cos(pose.yaw), Math.sin(pose.yaw)];
    const at = ([ahead, aside]) => {
      const [forward, left] = [(ahead * scene.body[0]) / 2, (aside * scene.body[1]) / 2];
      return [x(pose.x + forward * cos - left * sin), y(pose.y + forward * sin + left * cos)];
    };
    Object.assign(outline(CORNERS.map(at)), { globalAlpha: 0.55 }).fill();
    Object.assign(pen, { globalAlpha: 1 }).stroke();
    outline([[0, 0], [1.5, 0]].map(at)).stroke();
  };
  const drawScale = () => {
    const length = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000].find((metres) => metres * view.scale > 60) ?? 1000;
    const [left, low] = [16, size.y - 16];
    stroke("soft", 2);
    pen.strokeRect(left, low, length * view.scale, 0.01);
    label(`${length} m`, left, low - 6, "soft");
  };

  let drawn = [];
  let known = "";
  const recolor = () => {
    drawn = layers.map((layer) => ({ layer, below: layer.kind === "raster" || layer.kind === "windows", parts: prepare[layer.kind](layer) }));
    known = "";
  };
  // A moment that is open shows what it claims, and no other thing of that kind.
  let claim = null;
  const isHidden = ({ hidden, label: name, measured }) => claim ? claim.hides.includes(name) || measured || (hidden && !claim.shows.includes(name)) : hidden;
  const drawParts = (part, below, instant) => {
    for (const one of drawn) if (one.below === below && !isHidden(one.layer)) one.parts[part]?.(instant);
  };
  const ring = (left, up, along, cross, aside) => {
    const placed = new Path2D();
    placed.addPath(RING, new DOMMatrix([along * view.scale, -cross * view.scale, 0, -aside * view.scale, x(left), y(up)]));
    pen.stroke(placed);
  };
  const drawClaim = ({ line: [x0, y0, x1, y1], ring: axes, value }) => {
    if (axes.length) (stroke("fix", 1.5), ring(...axes));
    if (x0 === undefined) return;
    stroke("bad", 2);
    outline([[x(x0), y(y0)], [x(x1), y(y1)]]).stroke();
    dot(x(x0), y(y0), 3, paint("bad"));
    dot(x(x1), y(y1), 4, paint("bad"), paint("back"));
    if (/ m($| )/.test(value)) label(value, (x(x0) + x(x1)) / 2 + 8, (y(y0) + y(y1)) / 2 - 6, "bad");
  };
  const drawStills = (sharp) => {
    for (const still of stills) {
      pen = still;
      Object.assign(pen.canvas, { width: canvas.width, height: canvas.height }); // which clears it
      pen.setTransform(sharp, 0, 0, sharp, 0, 0);
      const ground = still === stills[0];
      if (ground) Object.assign(pen, { fillStyle: paint("sheet") }).fillRect(0, 0, size.x, size.y);
      drawParts(0, ground);
    }
    drawScale();
    pen = screen;
  };
  const world = (px, py) => [view.x + (px - size.x / 2) / view.scale, view.y - (py - size.y / 2) / view.scale];
  const fit = ([left, right, bottom, top]) => {
    follow = false;
    view = { x: (left + right) / 2, y: (bottom + top) / 2, scale: Math.min(size.x / (right - left), size.y / (top - bottom)) };
  };
  recolor();
  return {
    layers,
    recolor,
    world,
    draw: (instant, moment = null) => {
      claim = moment;
      const followed = follow && poseAt(walker, instant);
      if (followed) view = { ...view, x: followed.x, y: followed.y };
      const sharp = canvas.width / size.x;
      const wanted = JSON.stringify([view, size, sharp, layers.map(isHidden)]);
      if (wanted !== known) drawStills(sharp);
      known = wanted;
      for (const [at, still] of stills.entries()) {
        pen.setTransform(1, 0, 0, 1, 0, 0);
        pen.drawImage(still.canvas, 0, 0);
        pen.setTransform(sharp, 0, 0, sharp, 0, 0);
        drawParts(1, at === 0, instant);
      }
      if (claim) drawClaim(claim);
    },
    fit,
    near: (across) => {
      follow = true;
      view.scale = Math.min(size.x, size.y) / across;
    },
    // About the line, the ellipse or the robot of a moment.
    open: ({ line, ring: [left, up, ...axes], seconds }) => {
      const robot = poseAt(walker, seconds) ?? view;
      const [x0, y0, x1, y1] = line.length ? line : [left ?? robot.x, up ?? robot.y, left ?? robot.x, up ?? robot.y];
      const half = Math.max(2, 1.25 * Math.hypot(x1 - x0, y1 - y0), 1.25 * Math.max(0, ...axes));
      fit([(x0 + x1) / 2 - half, (x0 + x1) / 2 + half, (y0 + y1) / 2 - half, (y0 + y1) / 2 + half]);
    },
    place: (wanted) => {
      if (wanted) [follow, view] = [false, { x: wanted[0], y: wanted[1], scale: size.x / wanted[2] }];
      return [view.x, view.y, size.x / view.scale];
    },
    follows: () => follow,
    resize: (width, height) => {
      view.scale *= width / size.x;
      Object.assign(size, { x: width, y: height });
      const sharp = Math.min(devicePixelRatio, 2);
      Object.assign(canvas, { width: Math.round(width * sharp), height: Math.round(height * sharp) });
    },
    zoom: (factor, px = size.x / 2, py = size.y / 2) => {
      const [wx, wy] = world(px, py);
      const scale = Math.min(2000, Math.max(0.02, view.scale * factor));
      view = { scale, x: wx - (px - size.x / 2) / scale, y: wy + (py - size.y / 2) / scale };
    },
    pan: (dx, dy) => {
      follow = false;
      view = { ...view, x: view.x - dx / view.scale, y: view.y + dy / view.scale };
    },
    // The position of a track within 15 pixels of the pointer.
    nearest: (px, py) => {
      let best = { away: 15 };
      for (const { label: name, hidden, t, x: xs, y: ys } of tracks) {
        for (let at = 0; !hidden && at < xs.length; at++) {
          const away = Math.hypot(x(xs[at]) - px, y(ys[at]) - py);
          if (away < best.away) best = { away, label: name, seconds: t[at] };
        }
      }
      return best.label ? best : null;
    },
  };
};
