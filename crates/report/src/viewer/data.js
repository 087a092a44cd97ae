// Unpacks the data of `encode.rs` into arrays of numbers.

const GAP = 65535;

const bytesOf = (text) => {
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
  const letters = atob(text);
  const bytes = new Uint8Array(letters.length);
  for (let i = 0; i < letters.length; i++) bytes[i] = letters.charCodeAt(i);
  return bytes;
};

const inflated = async (text) => {
  const stream = new Blob([bytesOf(text)]).stream();
  const plain = stream.pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(plain).arrayBuffer());
};

// Levels, one channel after the other, from second differences.
const levelsOf = (bytes, channels, frames) => {
  const count = channels * frames;
  const levels = new Uint16Array(count);
  for (let channel = 0, at = 0; channel < channels; channel++) {
    let level = 0;
    let slope = 0;
    for (let frame = 0; frame < frames; frame++, at++) {
      const zigzag = bytes[at] | (bytes[count + at] << 8);
      slope = (slope + ((zigzag >> 1) ^ -(zigzag & 1))) & 0xffff;
      level = (level + slope) & 0xffff;
      levels[at] = level;
    }
  }
  return levels;
};

const floatsOf = (bytes) => {
  const count = bytes.length / 4;
  const mixed = new Uint8Array(bytes.length);
  for (let plane = 0; plane < 4; plane++) {
    for (let i = 0; i < count; i++) mixed[4 * i + plane] = bytes[plane * count + i];
  }
  return new Float32Array(mixed.buffer);
};

// Rows `[frames, channels]` of a pack of positions or orientations.
const rowsOf = async (pack, frames) => {
  const bytes = await inflated(pack.data);
  const { channels, least, step } = pack;
  const rows = new Float32Array(frames * channels);
  const values = pack.kind === "f32" ? floatsOf(bytes) : levelsOf(bytes, channels, frames);
  for (let channel = 0, at = 0; channel < channels; channel++) {
    const from = pack.kind === "f32" ? 0 : least[channel % least.length];
    const by = pack.kind === "f32" ? 1 : step;
    for (let frame = 0; frame < frames; frame++, at++) {
      rows[frame * channels + channel] = from + by * values[at];
    }
  }
  return rows;
};

// One array for each curve, NaN where it has a gap.
const curvesOf = async (pack, frames) => {
  if (pack.channels === 0) return [];
  const levels = levelsOf(await inflated(pack.data), pack.channels, frames);
  return pack.ranges.map(([least, step], channel) => {
    const own = levels.subarray(channel * frames, (channel + 1) * frames);
    return Float32Array.from(own, (level) => (level === GAP ? NaN : least + step * level));
  });
};

const SIDES = [
  [/^(left|l[_.-])|[a-z]left|[_.-]l(eft)?$|^l[A-Z]/, 1],
  [/^(right|r[_.-])|[a-z]right|[_.-]r(ight)?$|^r[A-Z]/, -1],
];
const FINGERS = /thumb|index|middle|ring|pinky|finger/i;

// A figure with its numbers, its sizes, and the properties of its joints that drawing needs.
const readFigure = async (data) => {
  const { frames, fps } = data;
  const count = data.parents.length;
  const positions = await rowsOf(data.positions, frames);
  const orientations = data.orientations && (await rowsOf(data.orientations, frames));
  const curves = await curvesOf(data.curves, frames);
  const bare = data.joints.map((name) => name.slice(name.lastIndexOf(":") + 1));
  let next = 0;
  const charts = data.charts.map(({ title, series }) => ({
    title,
    series: series.map((name) => ({ name, values: curves[next++] })),
  }));
  const figure = { name: data.name, fps, frames, count, positions, orientations, charts };
  figure.contacts = data.contacts;
  figure.origins = data.origins;
  figure.seconds = frames / fps;
  figure.joints = bare;
  figure.sides = bare.map((name) => {
    const camel = name.charAt(0).toLowerCase() + name.slice(1);
    const side = SIDES.find(([pattern]) => pattern.test(name) || pattern.test(camel));
    return side ? side[1] : 0;
  });
  measure(figure, data.parents);
  return figure;
};

// Extents, bones and the root trajectory.
const measure = (figure, parents) => {
  const { positions, count, frames } = figure;
  const low = [Infinity, Infinity, Infinity];
  const high = [-Infinity, -Infinity, -Infinity];
  for (let i = 0; i < positions.length; i++) {
    const axis = i % 3;
    if (positions[i] < low[axis]) low[axis] = positions[i];
    if (positions[i] > high[axis]) high[axis] = positions[i];
  }
  figure.low = low;
  figure.high = high;
  const sampled = [];
  for (let i = 0; i < 24; i++) sampled.push(Math.floor((i * (frames - 1)) / 23));
  const apart = (frame, a, b) => {
    const [i, j] = [3 * (frame * count + a), 3 * (frame * count + b)];
    return Math.hypot(
      positions[i] - positions[j],
      positions[i + 1] - positions[j + 1],
      positions[i + 2] - positions[j + 2],
    );
  };
  const heights = sampled.map((frame) => {
    let [least, most] = [Infinity, -Infinity];
    for (let j = 0; j < count; j++) {
      const y = positions[3 * (frame * count + j) + 1];
      least = Math.min(least, y);
      most = Math.max(most, y);
    }
    return most - least;
  });
  // A lone root has the size of a person.
  figure.height = count === 1 ? 1.7 : Math.max(...heights) || 1;
  figure.root = 0;
  figure.bones = [];
  parents.forEach((parent, joint) => {
    if (parent < 0) return;
    const lengths = sampled.map((frame) => apart(frame, joint, parent));
    const spread = Math.max(...lengths) - Math.min(...lengths);
    if (spread > 0.3 * figure.height) {
      // A distance that varies is not a bone; below the root, the joint is the root of the body.
      if (parent === figure.root) figure.root = joint;
      return;
    }
    const length = Math.max(...lengths);
    if (length < 1e-3 * figure.height) return;
    const thick = FINGERS.test(figure.joints[joint]) ? 0.006 : 0.02;
    const radius = Math.min(thick * figure.height, 0.45 * length);
    figure.bones.push({ parent, joint, radius, side: figure.sides[joint] });
  });
  figure.head = figure.joints.findIndex((name) => /^head$/i.test(name));
  // The top of the head lies within its ball.
  const tops = figure.bones.filter(({ parent, joint }) => parent === figure.head && /end|top/i.test(figure.joints[joint]));
  figure.top = tops.length === 1 ? tops[0].joint : figure.head;
  figure.bones = figure.bones.filter((bone) => !tops.includes(bone) || tops.length > 1);
  figure.trajectory = smoothed(figure, Math.round(0.5 * figure.fps));
  figure.middle = [(low[0] + high[0]) / 2, (low[2] + high[2]) / 2];
  figure.around = {
    trajectory: outline(figure, (frame) => [figure.trajectory[2 * frame], figure.trajectory[2 * frame + 1]]),
    middle: outline(figure, () => figure.middle),
  };
};

// Layers of a figure's outline.
const LAYERS = 24;
// Extent of the drawing around joints, as a part of the height; of a lone root with its arrow, metres.
const FLESH = 0.05;
const LONE = 0.5;

// Largest distance of the drawing from a vertical axis over all frames, as `[reach, height]` in metres
// for the lower and upper border of each layer. `axis` returns the axis of a frame.
const outline = (figure, axis) => {
  const { positions, count, frames, bones, low, high, height } = figure;
  const joints = bones.length > 0 ? [...new Set(bones.flatMap(({ parent, joint }) => [parent, joint]))] : [...Array(count).keys()];
  const flesh = count === 1 ? LONE : FLESH * height;
  const [from, to] = [low[1] - flesh, Math.max(high[1] + flesh, low[1] + (count === 1 ? 1 : 0))];
  const thick = (to - from) / LAYERS || 1;
  const reaches = new Array(LAYERS).fill(-1);
  for (let t = 0; t < frames; t++) {
    const [x, z] = axis(t);
    for (const joint of joints) {
      const at = 3 * (t * count + joint);
      const reach = Math.hypot(positions[at] - x, positions[at + 2] - z) + flesh;
      const y = positions[at + 1];
      for (const side of [y - flesh, y + flesh]) {
        const layer = Math.min(LAYERS - 1, Math.floor((side - from) / thick));
        if (reach > reaches[layer]) reaches[layer] = reach;
      }
    }
  }
  return reaches.flatMap((reach, i) => (reach < 0 ? [] : [[reach, from + i * thick], [reach, from + (i + 1) * thick]]));
};

// The root position on the ground, `[frames, 2]`, averaged over `half` frames before and after, for a
// following camera.
const smoothed = ({ positions, count, frames, root }, half) => {
  const trajectory = new Float32Array(2 * frames);
  for (const [axis, coordinate] of [[0, 0], [1, 2]]) {
    const sums = new Float64Array(frames + 1);
    for (let t = 0; t < frames; t++) {
      sums[t + 1] = sums[t] + positions[3 * (t * count + root) + coordinate];
    }
    for (let t = 0; t < frames; t++) {
      const [from, to] = [Math.max(0, t - half), Math.min(frames, t + half + 1)];
      trajectory[2 * t + axis] = (sums[to] - sums[from]) / (to - from);
    }
  }
  return trajectory;
};
