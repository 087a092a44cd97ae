// Curves under the view, with a cursor that follows.

const SERIES_COLOURS = ["#4a86e0", "#e58037", "#2fa37a", "#d0515f", "#b263c9", "#8f8a2f", "#3aa7bf", "#8c8c8c"];
const DASHES = [[], [6, 3], [2, 3], [8, 3, 2, 3], [12, 3], [4, 2, 1, 2, 1, 2], [1, 5], [12, 3, 3, 3]];
// Largest number of figures that are distinguished by dashes alone.
const FEW = 4;

const element = (name, attributes = {}, text = "") => {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.textContent = text;
  return made;
};

const short = (value) => {
  if (value === 0) return "0";
  const size = Math.abs(value);
  return size >= 1e4 || size < 1e-3 ? value.toExponential(1) : String(+value.toPrecision(3));
};

// Curves with the same title share a chart, for all figures.
const chartsOf = (scene) => {
  const charts = new Map();
  scene.figures.forEach((figure, index) => {
    for (const { title, series } of figure.charts) {
      if (!charts.has(title)) charts.set(title, { title, names: [], lines: [] });
      const chart = charts.get(title);
      for (const { name, values } of series) {
        if (!chart.names.includes(name)) chart.names.push(name);
        chart.lines.push({ figure: index, fps: figure.fps, name, values });
      }
    }
  });
  return [...charts.values()];
};

// A piece of a curve, for legends.
const stroke = ({ colour, dash }) => {
  const make = (name) => document.createElementNS("http://www.w3.org/2000/svg", name);
  const [svg, line] = [make("svg"), make("line")];
  const set = (node, attributes) => Object.entries(attributes).forEach(([key, value]) => node.setAttribute(key, value));
  set(svg, { viewBox: "0 0 26 4", width: 26, height: 4, "aria-hidden": "true" });
  set(line, { x1: 0, x2: 26, y1: 2, y2: 2, stroke: colour, "stroke-width": 2, "stroke-dasharray": dash.join(" ") });
  svg.append(line);
  return svg;
};

class Chart {
  constructor(chart, scene, seek) {
    Object.assign(this, chart);
    this.scene = scene;
    this.element = element("figure", { class: "kg-chart" });
    const caption = element("figcaption", {}, this.title);
    this.canvas = element("canvas", { role: "img", "aria-label": `${this.title} over time` });
    this.cursor = element("div", { class: "kg-cursor" });
    const area = element("div", { class: "kg-area" });
    area.append(this.canvas, this.cursor);
    this.element.append(caption, this.rows ? besideNames(this.rows, area) : area, this.legend());
    this.seek = seek;
    const pickAt = ({ clientX, clientY }) => {
      const { left, top, width, height } = area.getBoundingClientRect();
      this.pick((clientX - left) / width, (clientY - top) / height);
    };
    area.addEventListener("pointerdown", (event) => {
      area.setPointerCapture(event.pointerId);
      scene.dragged = true;
      pickAt(event);
    });
    area.addEventListener("pointermove", (event) => {
      if (event.buttons) pickAt(event);
    });
    for (const end of ["pointerup", "pointercancel"]) {
      area.addEventListener(end, () => {
        scene.dragged = false;
        scene.changed();
      });
    }
  }

  // Seeks the time at a part of the width.
  pick(across) {
    const [from, to] = this.scene.range;
    this.seek(from + across * (to - from));
  }

  // Smallest and largest value of all curves.
  get extremes() {
    if (this.known) return this.known;
    let [least, most] = [Infinity, -Infinity];
    for (const { values } of this.lines) {
      for (const value of values) {
        if (value < least) least = value;
        if (value > most) most = value;
      }
    }
    return (this.known = least <= most ? [least, most] : [0, 1]);
  }

  // With several figures, a single curve has the colour of its figure. Several curves have a colour
  // each and the dashes of their figure; with many figures, colours are of figures and dashes of
  // curves.
  look({ figure, name }) {
    const series = this.names.indexOf(name);
    const dash = DASHES[(this.byFigure ? series : figure) % DASHES.length];
    const colour = this.byFigure ? colourOf(figure) : SERIES_COLOURS[series % SERIES_COLOURS.length];
    return { colour, dash: this.scene.figures.length > 1 ? dash : [] };
  }

  // True if colours distinguish figures.
  get byFigure() {
    const figures = this.scene.figures.length;
    return figures > FEW || (figures > 1 && this.names.length === 1);
  }

  legend() {
    const legend = element("ul", { class: "kg-legend" });
    const several = this.scene.figures.length > 1;
    const add = (text, look) => {
      const item = element("li", {}, text);
      item.prepend(stroke(look));
      legend.append(item);
    };
    const plain = { colour: "currentColor", dash: [] };
    if (several && this.names.length === 1) {
      for (const line of this.lines) add(this.scene.figures[line.figure].name, this.look(line));
      return legend;
    }
    this.names.forEach((name, i) => {
      const look = this.look({ figure: 0, name });
      add(name, this.byFigure ? { ...plain, dash: DASHES[i % DASHES.length] } : { ...look, dash: [] });
    });
    if (several) {
      this.scene.figures.forEach(({ name }, figure) => {
        const look = this.look({ figure, name: this.names[0] });
        add(name, this.byFigure ? { ...look, dash: [] } : { ...look, colour: "currentColor" });
      });
    }
    return legend;
  }

  draw(colours) {
    const [width, height, context, ratio] = sized(this.canvas);
    if (width === 0) return;
    const [least, most] = this.extremes;
    // Differences in the last digits of a float are rounding noise.
    const size = Math.max(Math.abs(least), Math.abs(most)) || 1;
    const margin = Math.max(0.08 * (most - least), 1e-4 * size);
    const y = (value) => height - (height * (value - least + margin)) / (most - least + 2 * margin);
    timeLines(context, width, height, this.scene, colours);
    if (least < 0 && most > 0) {
      context.strokeStyle = colours.muted;
      context.globalAlpha = 0.5;
      context.strokeRect(-1, y(0), width + 2, height);
      context.globalAlpha = 1;
    }
    context.lineWidth = 1.4 * ratio;
    context.lineJoin = "round";
    for (const line of this.lines) {
      const { colour, dash } = this.look(line);
      context.strokeStyle = colour;
      context.setLineDash(dash.map((part) => part * ratio));
      this.trace(context, line, width, y);
    }
    context.setLineDash([]);
    outlined(context, short(most), 3 * ratio, 2 * ratio, "top", ratio, colours);
    if (short(least) === short(most)) return;
    outlined(context, short(least), 3 * ratio, height - 2 * ratio, "bottom", ratio, colours);
  }

  // If a pixel has many frames, their smallest and largest values are drawn.
  trace(context, { values, fps }, width, y) {
    context.beginPath();
    let down = false;
    const [start, end] = this.scene.range.map((time) => time * fps);
    const step = width / (end - start);
    const bundle = Math.max(1, Math.floor(1 / step));
    const last = Math.min(values.length, Math.ceil(end) + bundle);
    for (let from = Math.max(0, Math.floor(start / bundle) - 1) * bundle; from < last; from += bundle) {
      let [least, most] = [Infinity, -Infinity];
      for (let t = from; t < Math.min(values.length, from + bundle); t++) {
        if (values[t] < least) least = values[t];
        if (values[t] > most) most = values[t];
      }
      if (!(least <= most)) {
        down = false;
        continue;
      }
      const x = (from - start + bundle / 2) * step;
      if (down) context.lineTo(x, y(least));
      else context.moveTo(x, y(least));
      if (most > least) context.lineTo(x, y(most));
      down = true;
    }
    context.stroke();
  }

  follow(time) {
    const [from, to] = this.scene.range;
    this.cursor.style.left = `${(100 * (time - from)) / (to - from)}%`;
  }
}

// The times at which each joint stands on the ground, by figure.
class ContactChart extends Chart {
  constructor(scene, seek) {
    const several = scene.figures.length > 1;
    const rows = scene.figures.flatMap((figure, index) =>
      figure.contacts.map(({ joint, ranges }) => ({
        label: several ? `${figure.name}: ${figure.joints[joint]}` : figure.joints[joint],
        figure: index,
        fps: figure.fps,
        ranges,
      })),
    );
    super({ title: "foot contacts", names: [], lines: [], rows }, scene, seek);
    this.canvas.style.height = `${Math.max(40, 15 * rows.length)}px`;
  }

  legend() {
    return element("ul", { class: "kg-legend" });
  }

  draw(colours) {
    const [width, height, context] = sized(this.canvas);
    timeLines(context, width, height, this.scene, colours);
    const step = height / this.rows.length;
    const [start, end] = this.scene.range;
    this.rows.forEach(({ figure, fps, ranges }, row) => {
      context.fillStyle = colourOf(figure);
      const scale = width / ((end - start) * fps);
      for (const [from, to] of ranges) {
        context.fillRect((from - start * fps) * scale, row * step + 0.15 * step, (to - from) * scale, 0.7 * step);
      }
    });
  }
}

// The names of rows, left of their area.
const besideNames = (rows, area) => {
  const [both, names] = [element("div", { class: "kg-rows" }), element("ul", { class: "kg-names" })];
  names.append(...rows.map(({ label }) => element("li", { title: label }, label)));
  both.append(names, area);
  return both;
};

// Text that is readable over curves.
const outlined = (context, text, x, y, baseline, ratio, colours) => {
  context.font = `${11 * ratio}px system-ui, sans-serif`;
  context.textBaseline = baseline;
  context.fillStyle = colours.ink;
  context.lineWidth = 3 * ratio;
  context.lineJoin = "round";
  context.strokeStyle = colours.page;
  context.strokeText(text, x, y);
  context.fillText(text, x, y);
};

// Sets the canvas to its size in device pixels, and returns a new context.
const sized = (canvas) => {
  const ratio = Math.min(2, devicePixelRatio || 1);
  const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((side) => Math.round(side * ratio));
  canvas.width = width;
  canvas.height = height;
  return [width, height, canvas.getContext("2d"), ratio];
};

const beatTimes = ({ song, seconds }) => {
  const beats = song ? song.beats.map((beat) => beat - song.start) : [];
  return beats.filter((beat) => beat >= 0 && beat <= seconds);
};

// Beats as vertical lines; beats that stand closer than this many pixels are left out.
const LEAST_BEAT = 5;

const timeLines = (context, width, height, scene, colours) => {
  const [from, to] = scene.range;
  const beats = beatTimes(scene).filter((beat) => beat >= from && beat <= to);
  const scale = width / (to - from);
  if (beats.length > 1 && (scale * (beats.at(-1) - beats[0])) / (beats.length - 1) < LEAST_BEAT) return;
  context.fillStyle = colours.muted;
  context.globalAlpha = 0.35;
  for (const beat of beats) context.fillRect(Math.round((beat - from) * scale), 0, 1, height);
  context.globalAlpha = 1;
};
