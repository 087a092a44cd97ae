// Unpacks the data of `encode.rs` into arrays of numbers.

const GAP = 65535;

// Extremes of numbers. As arguments of `Math.max`, a hundred thousand values fail.
const largest = (values) => values.reduce((most, value) => Math.max(most, value), -Infinity);
const smallest = (values) => values.reduce((least, value) => Math.min(least, value), Infinity);

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

// A figure with its numbers and its measures.
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
  Object.assign(figure, data.measures);
  figure.trajectory = smoothed(figure, Math.round(DRAWING.camera.smoothing_seconds * fps));
  figure.middle = [0, 2].map((axis) => (figure.low[axis] + figure.high[axis]) / 2);
  return figure;
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
