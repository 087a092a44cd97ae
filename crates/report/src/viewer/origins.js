// The source frames of a motion made from examples, and the coverage of the examples.

// The colour of a source frame, whose position in all examples is from 0 to 1.
const originColour = (place) => `hsl(${Math.round(15 + 290 * place)} 60% 52%)`;

// The figures with origins: their number, and the frames of their examples, concatenated.
const originated = (scene) =>
  scene.figures.flatMap((figure, index) => {
    if (!figure.origins) return [];
    const starts = [0];
    for (const { frames } of figure.origins.examples) starts.push(starts.at(-1) + frames);
    const total = Math.max(1, starts.pop());
    const colour = (example, frame) => originColour((starts[example] + frame) / total);
    return [{ ...figure.origins, figure: index, fps: figure.fps, name: figure.name, colour }];
  });

// Stops of a gradient: between two of them, colours pass through no other hue.
const STOPS = 16;

// A run of consecutive frames of an example; `colour` returns the colour of a part of it.
const fillRun = (context, from, to, top, height, colour) => {
  const gradient = context.createLinearGradient(from, 0, Math.max(to, from + 1), 0);
  for (let stop = 0; stop <= STOPS; stop++) gradient.addColorStop(stop / STOPS, colour(stop / STOPS));
  context.fillStyle = gradient;
  context.fillRect(from, top, Math.max(1, to - from), height);
};

const noLegend = () => element("ul", { class: "kg-legend" });

// The source frame of each part and time, by colour; a line rises through each run of consecutive
// frames.
class OriginChart extends Chart {
  constructor(scene, seek) {
    const several = scene.figures.length > 1;
    const rows = originated(scene).flatMap((own) =>
      own.parts.map(({ name, runs }) => ({ ...own, runs, label: several ? `${own.name}: ${name}` : name })),
    );
    super({ title: "source frame of each part", names: [], lines: [], rows }, scene, seek);
    this.canvas.style.height = `${Math.max(40, 24 * rows.length)}px`;
  }

  legend() {
    return noLegend();
  }

  draw(colours) {
    const [width, height, context, ratio] = sized(this.canvas);
    const step = height / this.rows.length;
    const [begin, end] = this.scene.range;
    this.rows.forEach(({ runs, fps, examples, colour }, row) => {
      const scale = width / ((end - begin) * fps);
      const [top, tall] = [(row + 0.08) * step, 0.84 * step];
      for (const [start, example, first, frames] of runs) {
        const [from, to] = [start, start + frames].map((frame) => (frame - begin * fps) * scale);
        if (to < 0 || from > width) continue;
        fillRun(context, from, to, top, tall, (part) => colour(example, first + part * frames));
        const y = (frame) => top + tall * (1 - frame / examples[example].frames);
        context.strokeStyle = colours.ink;
        context.lineWidth = ratio;
        context.beginPath();
        context.moveTo(from, y(first));
        context.lineTo(to, y(first + frames));
        context.stroke();
      }
    });
  }
}

// The frames of each example that appear in any part; a click seeks one. The cursor is at the source
// frame of the first part.
class ExampleChart extends Chart {
  constructor(scene, seek) {
    const several = scene.figures.length > 1;
    const rows = originated(scene).flatMap((own) =>
      own.examples.map(({ name, frames }, example) => ({
        ...own,
        example,
        frames,
        label: several ? `${own.name}: ${name}` : name,
      })),
    );
    const longest = largest(rows.map(({ frames }) => frames));
    const chart = { title: "source frames in the examples", names: [], lines: [], rows, longest };
    super(chart, scene, seek);
    this.canvas.setAttribute("aria-label", this.title);
    this.canvas.style.height = `${Math.max(40, 18 * rows.length)}px`;
    this.follow(0);
  }

  legend() {
    return noLegend();
  }

  pick(across, down) {
    const { rows, longest } = this;
    const row = rows[Math.max(0, Math.min(rows.length - 1, Math.floor(down * rows.length)))];
    const found = this.timeOf(row, longest * across);
    if (found !== null) this.seek(found);
  }

  // The time at which the first part with this source frame shows it; null if none does.
  timeOf({ parts, example, fps }, frame) {
    for (const [start, from, first, frames] of parts.flatMap(({ runs }) => runs)) {
      if (from === example && frame >= first && frame < first + frames) return (start + frame - first) / fps;
    }
    return null;
  }

  draw(colours) {
    const [width, height, context] = sized(this.canvas);
    const [step, scale] = [height / this.rows.length, width / this.longest];
    this.rows.forEach(({ parts, example, frames, colour }, row) => {
      const [top, tall] = [(row + 0.1) * step, 0.8 * step];
      context.fillStyle = colours.muted;
      context.globalAlpha = 0.25;
      context.fillRect(0, top, frames * scale, tall);
      context.globalAlpha = 1;
      for (const [, from, first, count] of parts.flatMap(({ runs }) => runs)) {
        if (from !== example) continue;
        const own = (part) => colour(example, first + part * count);
        fillRun(context, first * scale, (first + count) * scale, top, tall, own);
      }
    });
  }

  follow(time) {
    const { parts, figure, fps } = this.rows[0];
    const t = Math.floor(time * fps);
    const run = parts[0].runs.find(([start, , , frames]) => t >= start && t < start + frames);
    if (!run) return;
    const [start, example, first] = run;
    const row = this.rows.findIndex((own) => own.figure === figure && own.example === example);
    const percent = (value) => `${100 * value}%`;
    this.cursor.style.left = percent((first + t - start) / this.longest);
    this.cursor.style.top = percent(row / this.rows.length);
    this.cursor.style.height = percent(1 / this.rows.length);
  }
}
