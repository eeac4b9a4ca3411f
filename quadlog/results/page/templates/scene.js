"use strict";
// A scene on a canvas: its layers, drawn over each other at an instant, and the part of the world in view.
// What stands still is drawn once for each view into two pictures: the ground, below the maps of an instant, and the
// ways and marks above them.
const LEVELS = ["level-0", "level-1", "level-2", "level-3"];
const DASHES = [[], [6, 4], [2, 3], [8, 3, 2, 3]];
const CIVIDIS = ["#00224e", "#123570", "#3b496c", "#575d6d", "#707173", "#8a8678", "#a59c74", "#c3b369", "#e1cc55", "#fee838"];
const FEET = [[0.72, 1.24], [0.72, -1.24], [-0.72, 1.24], [-0.72, -1.24]]; // FL, FR, RL, RR, in halves of the body
const SHAPES = {
  triangle: [[0, -1], [1, 1], [-1, 1]],
  cross: [[-1, -1], [1, 1], [0, 0], [1, -1], [-1, 1]],
  star: Array.from({ length: 10 }, (_, at) => [Math.sin((at * Math.PI) / 5), -Math.cos((at * Math.PI) / 5)].map((reach) => (at % 2 ? reach / 2.4 : reach))),
};
const COLUMNS = ["t", "until", "x", "y", "xx", "xy", "yy", "yaw", "feet", "level", "radius", "first", "row", "column"];
const SCALE_95 = 2.4477;
const PART_PX = 10; // of a segment that several lines share
const EPOCH_S = 0.02; // fixes of several tags within this time belong together

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

const openView = (scene, canvas, block) => {
  const picture = (width, height) => Object.assign(document.createElement("canvas"), { width, height }).getContext("2d");
  const screen = canvas.getContext("2d");
  const stills = [picture(1, 1), picture(1, 1)];
  let pen = screen;
  const layers = scene.layers.map((layer) => {
    const made = { ...layer, bytes: block.cells[layer.cells] };
    for (const name of COLUMNS) if (name in layer) made[name] = block.columns[layer[name]];
    return made;
  });
  const tracks = layers.filter(({ kind }) => kind === "track");
  const walker = tracks.findLast(({ shape }) => shape === "body") ?? tracks[tracks.length - 1];
  const size = { x: 1, y: 1 };
  let view = { x: 0, y: 0, scale: 1 };
  let follow = false;
  const x = (metres) => size.x / 2 + (metres - view.x) * view.scale;
  const y = (metres) => size.y / 2 - (metres - view.y) * view.scale;
  const stroke = (color, width, variant = 0) => {
    Object.assign(pen, { strokeStyle: paint(color), lineWidth: width });
    pen.setLineDash(DASHES[variant % 4]);
  };
  const outline = (corners, px, py, size) => {
    pen.beginPath();
    for (const [dx, dy] of corners) pen.lineTo(px + size * dx, py + size * dy);
    return pen;
  };
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
  };
  const putPicture = (cells, left, bottom, cell) => {
    pen.imageSmoothingEnabled = false;
    const [wide, high] = [cells.width * cell * view.scale, cells.height * cell * view.scale];
    pen.drawImage(cells, x(left), y(bottom) - high, wide, high);
    return [x(left), y(bottom) - high, wide, high];
  };
  const polyline = (xs, ys, from, to) => {
    pen.beginPath();
    for (let at = from; at < to; at++) {
      if (Number.isNaN(xs[at])) continue;
      pen[at > from && !Number.isNaN(xs[at - 1]) ? "lineTo" : "moveTo"](x(xs[at]), y(ys[at]));
    }
    pen.stroke();
  };

  // Of segments that several timed lines share at an instant, each line draws its part, so that none hides another.
  const sharers = layers.filter(({ kind, t, measured }) => kind === "lines" && t && !measured);
  const shares = { key: "", owners: new Map() };
  const segmentsOf = ({ t, first, x: xs, y: ys }, instant) => {
    const line = rowAt(t, instant);
    const found = [];
    for (let at = line < 0 ? 1 : first[line] + 1; at < (line < 0 ? 1 : first[line + 1]); at++) {
      if (!Number.isNaN(xs[at] + xs[at - 1])) found.push([xs[at - 1], ys[at - 1], xs[at], ys[at]]);
    }
    return found;
  };
  const drawShared = (layer, instant) => {
    const seen = sharers.filter(({ hidden }) => !hidden);
    const key = seen.map(({ t, label: name }) => `${name} ${rowAt(t, instant)}`).join();
    if (key !== shares.key) {
      Object.assign(shares, { key, owners: new Map() });
      for (const one of seen) {
        for (const segment of segmentsOf(one, instant)) shares.owners.set(`${segment}`, [...(shares.owners.get(`${segment}`) ?? []), one]);
      }
    }
    pen.beginPath();
    for (const segment of segmentsOf(layer, instant)) {
      const owners = shares.owners.get(`${segment}`);
      const [px, py, dx, dy] = [x(segment[0]), y(segment[1]), (segment[2] - segment[0]) * view.scale, (segment[1] - segment[3]) * view.scale];
      const parts = owners.length * Math.max(1, Math.round(Math.hypot(dx, dy) / (PART_PX * owners.length)));
      for (let part = owners.length > 1 ? owners.indexOf(layer) : 0; part < parts; part += owners.length) {
        pen.moveTo(px + (part / parts) * dx, py + (part / parts) * dy);
        pen.lineTo(px + ((part + 1) / parts) * dx, py + ((part + 1) / parts) * dy);
      }
    }
    pen.stroke();
  };

  // Each prepares a layer for the current colours and returns how to draw what stands still of it, and what an instant shows.
  const prepare = {
    raster: ({ bytes, rows, columns, origin: [left, bottom], cell, ramp, color }) => {
      const [red, green, blue] = rgb(paint(color));
      const stops = CIVIDIS.map(rgb);
      const shades = new Uint8Array(4 * 256);
      for (let code = 1; code < 256; code++) {
        const share = (code - 1) / 254;
        const stop = stops[Math.round(share * (stops.length - 1))];
        shades.set(ramp === "fade" ? [red, green, blue, 40 + 170 * share] : [...stop.slice(0, 3), 255], 4 * code);
      }
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
      const source = scene.layers[layers.indexOf(layer)];
      if (!source.open) {
        source.open = true; // each map was stored as its difference from the one before
        for (let at = rows * stride; at < bytes.length; at++) bytes[at] ^= bytes[at - rows * stride];
      }
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
      const still = () => {
        stroke(color, 1.5, variant);
        for (let number = 0; number < first.length - 1; number++) polyline(xs, ys, first[number], first[number + 1]);
      };
      const ofInstant = (instant) => {
        stroke(color, measured ? 2 : 2.5, variant);
        if (!measured) return drawShared(layer, instant);
        const from = first[rowAt(t, instant)];
        const [px, py, length] = [x(xs[from + 1]), y(ys[from + 1]), Math.hypot(xs[from + 1] - xs[from], ys[from + 1] - ys[from])];
        if (!(length >= 0)) return;
        polyline(xs, ys, from, from + 2);
        dot(px, py, 4, paint(color), paint("back"));
        label(`${length.toFixed(2)} ${scene.unit}`, px + 8, py - 6, color);
      };
      return t ? [null, ofInstant] : [still];
    },
    marks: ({ x: xs, y: ys, t, until, radius, shape, names, color }) => {
      const half = shape !== "dot" ? 5 : xs.length > 200 && !t ? 1 : 2;
      const drawn = (instant) => {
        stroke(color, shape === "circle" ? 1 : 2.5);
        pen.fillStyle = paint(color);
        for (let at = 0; at < xs.length; at++) {
          if (t && (t[at] > instant || until[at] <= instant)) continue;
          const [px, py] = [x(xs[at]), y(ys[at])];
          if (radius) dot(px, py, radius[at] * view.scale, null, paint(color));
          else if (px < -20 || py < -20 || px > size.x + 20 || py > size.y + 20) continue;
          else if (shape === "dot") pen.fillRect(px - half, py - half, 2 * half, 2 * half);
          else outline(SHAPES[shape], px, py, half)[shape === "cross" ? "stroke" : "fill"]();
          if (names[at]) label(names[at], px + half + 4, py + half, color);
        }
      };
      return t ? [null, drawn] : [drawn];
    },
    ellipses: ({ t, x: xs, y: ys, xx, xy, yy, color }) => [null, (instant) => {
      const last = rowAt(t, instant);
      if (last < 0 || instant > t[last] + pageData.gap_s) return;
      stroke(color, 1.5);
      pen.beginPath();
      for (let at = last; at >= 0 && t[at] >= t[last] - EPOCH_S; at--) {
        if (!(xx[at] > 0)) continue;
        const [along, cross] = [Math.sqrt(xx[at]), xy[at] / Math.sqrt(xx[at])];
        const aside = Math.sqrt(Math.max(yy[at] - cross * cross, 0));
        for (let turn = 0; turn <= 40; turn++) {
          const [cos, sin] = [Math.cos((turn * Math.PI) / 20), Math.sin((turn * Math.PI) / 20)];
          pen[turn ? "lineTo" : "moveTo"](x(xs[at] + SCALE_95 * along * cos), y(ys[at] + SCALE_95 * (cross * cos + aside * sin)));
        }
      }
      pen.stroke();
    }],
    track: (layer) => {
      const { t, x: xs, y: ys, level, shape, variant, trail, color } = layer;
      const trails = trail ? [[color, pathOf(xs, ys, () => true), shape === "none" ? 1.5 : 2.5]] : [];
      if (level) {
        scene.levels.forEach((_, number) => trails.push([LEVELS[number], pathOf(xs, ys, (at) => level[at - 1] === number), 3.5]));
      }
      const still = () => {
        pen.save();
        pen.translate(size.x / 2 - view.x * view.scale, size.y / 2 + view.y * view.scale);
        pen.scale(view.scale, -view.scale);
        for (const [name, path, width] of trails) {
          Object.assign(pen, { strokeStyle: paint(name), lineWidth: width / view.scale, globalAlpha: 0.75, lineJoin: "round" });
          pen.setLineDash(DASHES[variant % 4].map((dash) => dash / view.scale));
          pen.stroke(path);
        }
        pen.restore();
      };
      const ofInstant = (instant) => {
        const pose = scene.span && shape !== "none" ? poseAt(layer, instant) : null;
        if (!pose) return;
        const [px, py, ink] = [x(pose.x), y(pose.y), paint(color)];
        if (shape === "body" && scene.body && !Number.isNaN(pose.yaw)) drawBody(layer, pose, instant, ink);
        else if (shape === "star") Object.assign(outline(SHAPES.star, px, py, 8), { fillStyle: ink }).fill();
        else dot(px, py, shape === "person" ? Math.max(6, 0.22 * view.scale) : 5, ink, paint("back"));
      };
      return [still, ofInstant];
    },
  };
  const pathOf = (xs, ys, wanted) => {
    const path = new Path2D();
    for (let at = 1, joined = false; at < xs.length; at++) {
      const there = wanted(at) && !Number.isNaN(xs[at]) && !Number.isNaN(xs[at - 1]);
      if (there && !joined) path.moveTo(xs[at - 1], ys[at - 1]);
      if (there) path.lineTo(xs[at], ys[at]);
      joined = there;
    }
    return path;
  };
  const drawBody = ({ t, feet }, pose, instant, color) => {
    if (scene.body[0] * view.scale < 10) return dot(x(pose.x), y(pose.y), 5, color, paint("back"));
    const [cos, sin] = [Math.cos(pose.yaw), Math.sin(pose.yaw)];
    const at = (ahead, aside) => {
      const [forward, left] = [(ahead * scene.body[0]) / 2, (aside * scene.body[1]) / 2];
      return [x(pose.x + forward * cos - left * sin), y(pose.y + forward * sin + left * cos)];
    };
    pen.beginPath();
    for (const corner of [[1, 1], [-1, 1], [-1, -1], [1, -1]]) pen.lineTo(...at(...corner));
    pen.closePath();
    Object.assign(pen, { fillStyle: color, globalAlpha: 0.55 }).fill();
    Object.assign(pen, { strokeStyle: color, globalAlpha: 1, lineWidth: 2 }).stroke();
    pen.beginPath();
    pen.moveTo(...at(0, 0));
    pen.lineTo(...at(1.5, 0));
    pen.stroke();
    const standing = feet ? feet[rowAt(t, instant)] : NaN;
    if (standing >= 0) FEET.forEach((place, leg) => dot(...at(...place), Math.max(2, 0.035 * view.scale), (standing >> leg) & 1 ? color : null, color));
  };
  const drawScale = () => {
    const length = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000].find((metres) => metres * view.scale > 60) ?? 1000;
    const [left, low] = [16, size.y - 16];
    stroke("soft", 2);
    pen.strokeRect(left, low, length * view.scale, 0.01);
    label(`${length} ${scene.unit}`, left, low - 6, "soft");
  };

  let drawn = [];
  let known = "";
  const recolor = () => {
    drawn = layers.map((layer) => ({ layer, below: layer.kind === "raster" || layer.kind === "windows", parts: prepare[layer.kind](layer) }));
    known = "";
  };
  const drawParts = (part, below, instant) => {
    for (const one of drawn) {
      if (one.below !== below || one.layer.hidden || !one.parts[part]) continue;
      pen.globalAlpha = 1;
      pen.setLineDash([]);
      one.parts[part](instant);
    }
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
  recolor();
  return {
    layers,
    recolor,
    draw: (instant) => {
      const followed = follow && poseAt(walker, instant);
      if (followed) view = { ...view, x: followed.x, y: followed.y };
      const sharp = canvas.width / size.x;
      const wanted = JSON.stringify([view, size, sharp, layers.map(({ hidden }) => hidden)]);
      if (wanted !== known) drawStills(sharp);
      known = wanted;
      for (const [at, still] of stills.entries()) {
        pen.setTransform(1, 0, 0, 1, 0, 0);
        pen.globalAlpha = 1;
        pen.drawImage(still.canvas, 0, 0);
        pen.setTransform(sharp, 0, 0, sharp, 0, 0);
        drawParts(1, at === 0, instant);
      }
    },
    whole: () => {
      follow = false;
      const [left, right, bottom, top] = scene.extent;
      view = { x: (left + right) / 2, y: (bottom + top) / 2, scale: Math.min(size.x / (right - left), size.y / (top - bottom)) };
    },
    near: (across) => {
      follow = true;
      view = { ...view, scale: Math.min(size.x, size.y) / across };
    },
    follows: () => follow,
    resize: (width, height) => {
      view.scale *= width / size.x;
      Object.assign(size, { x: width, y: height });
      const sharp = Math.min(devicePixelRatio, 2);
      Object.assign(canvas, { width: Math.round(width * sharp), height: Math.round(height * sharp) });
    },
    zoom: (factor, px = size.x / 2, py = size.y / 2) => {
      const [wx, wy] = [view.x + (px - size.x / 2) / view.scale, view.y - (py - size.y / 2) / view.scale];
      const scale = Math.min(2000, Math.max(0.02, view.scale * factor));
      view = { scale, x: wx - (px - size.x / 2) / scale, y: wy + (py - size.y / 2) / scale };
    },
    pan: (dx, dy) => {
      follow = false;
      view = { ...view, x: view.x - dx / view.scale, y: view.y + dy / view.scale };
    },
    world: (px, py) => [view.x + (px - size.x / 2) / view.scale, view.y - (py - size.y / 2) / view.scale],
    // The position of a track within 15 pixels of the pointer.
    nearest: (px, py) => {
      let best = { away: 15 };
      for (const { label: name, hidden, trail, t, x: xs, y: ys } of tracks) {
        for (let at = 0; !hidden && trail && at < xs.length; at++) {
          const away = Math.hypot(x(xs[at]) - px, y(ys[at]) - py);
          if (away < best.away) best = { away, label: name, seconds: t[at] };
        }
      }
      return best.label ? best : null;
    },
    // The value of a raster with a unit below the pointer.
    valueAt: (wx, wy) => {
      for (const { kind, unit, hidden, bytes, x: left, y: bottom, cell, rows, columns, low, high } of layers) {
        if (kind !== "raster" || !unit || hidden) continue;
        const [column, row] = [Math.floor((wx - left) / cell), Math.floor((wy - bottom) / cell)];
        if (column < 0 || row < 0 || column >= columns || row >= rows || !bytes[row * columns + column]) continue;
        return `${short(low + ((bytes[row * columns + column] - 1) / 254) * (high - low), 3)} ${unit}`;
      }
      return "";
    },
  };
};
