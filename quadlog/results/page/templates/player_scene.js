"use strict";
// The run of the player: its packed columns and maps, and what stands where at an instant.
// Units of the packed integers: milliseconds, millimetres, 1e-4 radians (page/player.py).
const NO_YAW = 100000;
const modulo = (value, size) => ((value % size) + size) % size;

const unpack = async ({ packed, lengths }) => {
  const bytes = Uint8Array.from(atob(packed), (sign) => sign.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const flat = new Uint8Array(await new Response(stream).arrayBuffer());
  let start = 0;
  const columns = lengths.map((count) => {
    const column = new Int32Array(count);
    for (let at = 0, value = 0; at < count; at++) {
      const [low, high] = [start + at, start + at + 2 * count];
      const code = flat[low] | (flat[low + count] << 8) | (flat[high] << 16) | (flat[high + count] << 24);
      value += (code >>> 1) ^ -(code & 1);
      column[at] = value;
    }
    start += 4 * count;
    return column;
  });
  return [columns, flat.slice(start)];
};

// The last row that is not later than seconds; -1 where all are.
const rowAt = (milliseconds, seconds) => {
  const instant = Math.round(1000 * seconds);
  let [low, high] = [-1, milliseconds.length - 1];
  while (low < high) {
    const half = Math.ceil((low + high) / 2);
    if (milliseconds[half] <= instant) low = half;
    else high = half - 1;
  }
  return low;
};

// {x, y, yaw (null where unknown), row}, interpolated; null where nothing was seen for hold seconds.
const poseAt = ({ t, x, y, yaw }, seconds, hold) => {
  const row = rowAt(t, seconds);
  if (row < 0) return null;
  const next = Math.min(row + 1, t.length - 1);
  const gap = (t[next] - t[row]) / 1000;
  const since = Math.max(0, seconds - t[row] / 1000);
  const known = yaw[row] !== NO_YAW;
  if (gap <= 0 || gap > hold) {
    return since > hold ? null : { x: x[row] / 1000, y: y[row] / 1000, yaw: known ? yaw[row] / 1e4 : null, row };
  }
  const between = (column) => column[row] + Math.min(1, since / gap) * (column[next] - column[row]);
  const turn = modulo(yaw[next] - yaw[row] + 31416, 62832) - 31416;
  const turned = (yaw[row] + (since / gap) * turn) / 1e4;
  return { x: between(x) / 1000, y: between(y) / 1000, yaw: known && yaw[next] !== NO_YAW ? turned : null, row };
};

// Where a path from its point nearest to the robot on first is so far away; else its end.
const lookaheadPoint = (path, { x, y }, reach) => {
  const away = path.map(([px, py]) => Math.hypot(px - x, py - y));
  const start = away.indexOf(Math.min(...away));
  const past = away.findIndex((distance, at) => at >= start && distance >= reach);
  if (past < 0) return path[path.length - 1];
  if (past === start) return path[past];
  const share = (reach - away[past - 1]) / (away[past] - away[past - 1]);
  return [0, 1].map((axis) => path[past - 1][axis] + share * (path[past][axis] - path[past - 1][axis]));
};

const openScene = async (data) => {
  const [columns, bits] = await unpack(data);
  const taken = (names, each) => Object.assign(each, Object.fromEntries(names.map((name) => [name, columns[each[name]]])));
  for (const track of data.tracks) taken(["t", "x", "y", "yaw", "feet", "lookahead"], track);
  for (const paths of data.paths) taken(["t", "first", "x", "y"], paths);
  for (const cloud of data.clouds) taken(["x", "y"], cloud);
  let start = 0;
  for (const windows of data.windows) {
    taken(["t", "column", "row"], windows);
    windows.stride = Math.ceil(windows.columns / 8);
    windows.size = windows.rows * windows.stride;
    const own = bits.subarray(start, (start += windows.size * windows.t.length));
    for (let at = windows.size; at < own.length; at++) own[at] ^= own[at - windows.size];
    windows.bits = own;
  }
  const path = (paths, seconds) => {
    const made = rowAt(paths.t, seconds);
    const rows = made < 0 ? [] : Array.from({ length: paths.first[made + 1] - paths.first[made] }, (_, at) => at);
    return rows.map((at) => [paths.x[paths.first[made] + at] / 1000, paths.y[paths.first[made] + at] / 1000]);
  };
  return {
    pose: (track, seconds) => poseAt(track, seconds, data.hold.track),
    path,
    window: (windows, seconds) => rowAt(windows.t, seconds),
    clouds: (seconds) => data.clouds.filter(({ t }) => t <= seconds + 1e-3 && seconds < t + data.hold.cloud),
    // The cells of a window as opaque pixels, upper row first.
    paint: (windows, at, image) => {
      const pixels = new Uint32Array(image.data.buffer);
      pixels.fill(0);
      const { rows, columns: wide, stride, size } = windows;
      for (let up = 0; up < rows; up++) {
        const from = at * size + modulo(windows.row[at] + up, rows) * stride;
        const line = (rows - 1 - up) * wide;
        for (let right = 0, column = modulo(windows.column[at], wide); right < wide; right++, column++) {
          if (column === wide) column = 0;
          if (windows.bits[from + (column >> 3)] & (128 >> (column & 7))) pixels[line + right] = 0xff000000;
        }
      }
    },
  };
};
