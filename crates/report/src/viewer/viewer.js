// A viewer: the canvas, its controls, and `window.kinegrad`.

const ICONS = {
  play: "M4 2l10 6-10 6z",
  pause: "M3 2h4v12H3zM9 2h4v12H9z",
  back: "M12 2v12L5 8zM3 2h2v12H3z",
  ahead: "M4 2l7 6-7 6zM11 2h2v12h-2z",
};
const RATES = [0.1, 0.25, 0.5, 1, 1.5, 2];
const KEYS = [
  ["Space", "play or pause"],
  ["← →", "one frame back or ahead; with Shift ten"],
  ["Home End", "first or last frame"],
  ["↑ ↓", "faster or slower"],
  ["L", "loop"],
  ["S", "side by side or over one another"],
  ["E", "fit each figure to its pane, or one scale for all"],
  ["W", "curves over the whole length or around the cursor"],
  ["F", "follow the figures"],
  ["T", "trail on the floor"],
  ["M", "sound on or off"],
  ["R", "reset the view"],
  ["+ −", "nearer or further"],
  ["Drag", "turn; with Shift, the right button or two fingers: move"],
  ["Wheel, pinch", "nearer or further"],
];
// The part of a long motion around the cursor that curves show, seconds.
const WINDOW = 10;
// Largest number of pixels of a canvas: without a GPU each pixel costs time.
const MOST_PIXELS = 1.3e6;

const icon = (name) => {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  const path = document.createElementNS("http://www.w3.org/2000/svg", "path");
  svg.setAttribute("viewBox", "0 0 16 16");
  svg.setAttribute("aria-hidden", "true");
  path.setAttribute("d", ICONS[name]);
  svg.append(path);
  return svg;
};

class Viewer {
  constructor(section) {
    this.section = section;
    this.small = section.classList.contains("kg-small");
    this.frameTimes = [];
    this.shown = -1;
    // Until the motion is unpacked.
    this.frames = 1;
    this.fps = 1;
    this.visible = !this.small;
    this.camera = new Camera();
    this.ready = this.small ? new Promise((done) => (this.wake = done)) : Promise.resolve();
    this.ready = this.ready.then(() => this.load()).catch((error) => {
      section.append(element("p", { class: "kg-failed" }, `The motion cannot be shown: ${error.message}`));
      throw error;
    });
    if (this.small) this.watch();
  }

  // A thumbnail is unpacked when it is first seen, and only moves while it is.
  watch() {
    const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    new IntersectionObserver(([entry]) => {
      this.visible = entry.isIntersecting;
      if (!this.visible) return;
      this.wake();
      this.ready.then(() => {
        if (this.started) return;
        this.started = true;
        if (!still) this.play();
      }, () => {});
    }).observe(this.section);
  }

  async load() {
    const data = JSON.parse(this.section.querySelector("script").textContent);
    const figures = await Promise.all(data.figures.map(readFigure));
    const seconds = largest(figures.map((figure) => figure.seconds));
    this.fps = largest(figures.map((figure) => figure.fps));
    this.frames = Math.max(1, Math.round(seconds * this.fps));
    const size = largest(figures.map((figure) => figure.height));
    const lowest = smallest(figures.map((figure) => figure.low[1]));
    const lone = figures.every((figure) => figure.count === 1);
    // Feet stand at 0, unless the file has another origin.
    const ground = lone || Math.abs(lowest) < DRAWING.stage.other_origin * size ? 0 : lowest;
    // A body further above 0 than its height has another origin.
    for (const figure of figures) {
      const above = figure.low[1] - ground;
      figure.ground = figure.count > 1 && above > DRAWING.stage.own_ground * figure.height ? figure.low[1] : ground;
    }
    // The part of the time that curves show.
    this.scene = { ...data, figures, seconds, size, ground, range: [0, seconds] };
    this.scene.changed = () => (this.stale = true);
    this.whole = seconds <= 1.5 * WINDOW;
    this.fitEach = false;
    // The last frame is shown as long as any other, but the time ends at its start.
    this.clock = new Clock(seconds, data.song);
    this.sideBySide = figures.length > 1;
    this.following = figures.some((figure) => this.goesFar(figure));
    this.build();
    this.painter = new Painter(this.canvas.getContext("2d", { alpha: false }), this.scene);
    this.recolour();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.recolour());
    new ResizeObserver(() => this.resize()).observe(this.canvas);
    this.resize();
  }

  // True if the camera should follow a figure. A path on the ground is seen as a whole.
  goesFar(figure) {
    const isFlat = figure.high[1] <= figure.low[1];
    return !isFlat && this.extent(figure) > DRAWING.stage.follow_beyond * figure.height;
  }

  extent({ low, high }) {
    return Math.max(high[0] - low[0], high[2] - low[2]);
  }

  // The frame at the finest rate of the figures.
  get frame() {
    return Math.min(this.frames - 1, Math.floor(this.time * this.fps + 1e-4));
  }

  get time() {
    return this.clock?.time ?? 0;
  }

  get playing() {
    return this.clock?.playing ?? false;
  }

  get audio() {
    return this.clock?.audio;
  }

  seek(frame) {
    const whole = Math.min(this.frames - 1, Math.max(0, Math.round(frame)));
    this.seekTime(whole / this.fps);
  }

  seekTime(time) {
    this.clock.seek(Math.min(time, (this.frames - 1) / this.fps));
    this.shown = -1;
    this.show();
  }

  play() {
    if (this.frames > 1) this.clock.play();
    this.dress();
  }

  pause() {
    this.clock.pause();
    this.dress();
  }

  toggle() {
    if (this.playing) this.pause();
    else this.play();
  }

  step(frames) {
    this.pause();
    this.seek(this.frame + frames);
  }

  // Positions of a figure's joints in one of its frames, metres.
  joints(figure, frame) {
    const { positions, count } = this.scene.figures[figure];
    const row = positions.subarray(3 * frame * count, 3 * (frame + 1) * count);
    return Array.from({ length: count }, (_, j) => Array.from(row.subarray(3 * j, 3 * j + 3)));
  }

  frameOf(index) {
    const { fps, frames } = this.scene.figures[index];
    return Math.min(frames - 1, Math.floor(this.clock.time * fps + 1e-4));
  }

  // Advances to the time `now`, and draws the changes.
  tick(now) {
    if (!this.clock || !this.visible) return;
    const playing = this.playing;
    if (playing && this.before !== undefined) {
      this.frameTimes.push(now - this.before);
      if (this.frameTimes.length > 2000) this.frameTimes.shift();
    }
    this.before = playing ? now : undefined;
    this.clock.tick(now);
    if (playing && !this.playing) this.dress();
    if (this.stale || this.frame !== this.shown) this.show();
  }

  show() {
    if (!this.width) return;
    this.stale = false;
    this.shown = this.frame;
    const panes = this.panes();
    // The background between the panes.
    this.painter.context.fillStyle = this.painter.grid;
    this.painter.context.fillRect(0, 0, this.width, this.height);
    const framings = this.framings(panes);
    for (const [index, pane] of panes.entries()) {
      const [target, distance] = framings[index];
      const view = this.camera.view(target, distance, pane);
      this.metresPerPixel = (distance * this.camera.zoom * this.ratio) / view.scale;
      this.painter.pane(pane, view, (index) => this.frameOf(index), this.ratio);
    }
    if (this.small) {
      this.line.style.width = `${(100 * (this.frame + 0.5)) / this.frames}%`;
      return;
    }
    this.slider.value = this.frame;
    const text = `${(this.frame / this.fps).toFixed(2)} s · frame ${this.frame} of ${this.frames}`;
    this.label.textContent = text;
    this.slider.setAttribute("aria-valuetext", text);
    this.moveRange();
    for (const chart of this.charts) chart.follow((this.frame + 0.5) / this.fps);
  }

  // Curves of a long motion show a window around the cursor, which stands still while it is dragged in.
  moveRange() {
    const { scene } = this;
    if (scene.dragged) return;
    const { seconds } = scene;
    const from = this.whole ? 0 : Math.min(seconds - WINDOW, Math.max(0, this.time - WINDOW / 2));
    const to = this.whole ? seconds : from + WINDOW;
    if (scene.range[0] === from && scene.range[1] === to) return;
    scene.range = [from, to];
    this.rangeLabel.textContent = `${from.toFixed(1)} to ${to.toFixed(1)} s of ${seconds.toFixed(1)} s`;
    for (const chart of this.charts) chart.draw(this.painter);
  }

  // The parts of the canvas: one, or one for each figure.
  panes() {
    const indices = this.scene.figures.map((_, index) => index);
    const { width, height } = this;
    if (!this.sideBySide) return [{ x: 0, y: 0, width, height, figures: indices, ground: this.scene.ground }];
    let best = 0;
    let columns = 1;
    for (let tried = 1; tried <= indices.length; tried++) {
      const side = Math.min(width / tried, height / Math.ceil(indices.length / tried));
      if (side > best) [best, columns] = [side, tried];
    }
    const gap = Math.round(DRAWING.stage.gap * this.ratio);
    const rows = Math.ceil(indices.length / columns);
    const [w, h] = [(width + gap) / columns, (height + gap) / rows];
    return indices.map((index) => ({
      x: Math.round((index % columns) * w),
      y: Math.round(Math.floor(index / columns) * h),
      width: Math.round(w - gap),
      height: Math.round(h - gap),
      figures: [index],
      ground: this.scene.figures[index].ground,
    }));
  }

  // Target and distance of the camera for each pane, so that it sees all figures and the ground. Panes
  // have one scale and one height of the ground, unless each is fitted.
  framings(panes) {
    const found = panes.map((pane) => this.framing(pane));
    const lift = largest(found.map(({ rise }) => rise));
    const placed = found.map(({ x, z, ground, points, rise, aspect }) => {
      const y = ground + (this.fitEach ? rise : lift);
      const distance = distanceFor(points.map(([reach, height]) => [reach, height - y]), aspect);
      return [[x, y, z], distance];
    });
    const furthest = largest(placed.map(([, distance]) => distance));
    return placed.map(([target, distance]) => [target, this.fitEach ? distance : furthest]);
  }

  // What the camera of a pane must see: `points` as `[reach, height]` around an axis, and the height of
  // their middle above the ground.
  framing(pane) {
    const { ground, width, height } = pane;
    const goals = this.following ? [] : this.goalPlaces();
    const figures = pane.figures.map((index) => {
      const { trajectory, middle, around } = this.scene.figures[index];
      const t = this.frameOf(index);
      const axis = this.following ? [trajectory[2 * t], trajectory[2 * t + 1]] : middle;
      return { axis, outline: this.following ? around.trajectory : around.middle };
    });
    const places = [...figures.map(({ axis }) => axis), ...goals];
    const [x, z] = [0, 1].map((axis) => {
      const values = places.map((place) => place[axis]);
      return (smallest(values) + largest(values)) / 2;
    });
    const off = (place) => Math.hypot(place[0] - x, place[1] - z);
    const points = figures.flatMap(({ axis, outline }) => outline.map(([reach, y]) => [reach + off(axis), y]));
    for (const place of places) points.push([off(place), ground]);
    const heights = points.map(([, y]) => y);
    const rise = (smallest(heights) + largest(heights)) / 2 - ground;
    return { x, z, ground, points, rise, aspect: width / height };
  }

  // Corners of the marks of a goal on the ground.
  goalPlaces() {
    const { path, keyframes, obstacles, polygons } = this.scene.floor;
    const discs = obstacles.flatMap(([[x, z], r]) => [[x - r, z - r], [x + r, z + r]]);
    return [...keyframes.map(([, place]) => place), ...path, ...discs, ...polygons.flat()];
  }

  resize() {
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    const most = Math.sqrt(MOST_PIXELS / Math.max(1, width * height));
    this.ratio = Math.min(devicePixelRatio || 1, 1.5, Math.max(0.5, most));
    this.width = Math.round(width * this.ratio);
    this.height = Math.round(height * this.ratio);
    this.canvas.width = this.width;
    this.canvas.height = this.height;
    this.stale = true;
    this.redrawCharts();
  }

  recolour() {
    this.painter.setColours(this.section);
    this.stale = true;
    this.redrawCharts();
  }

  redrawCharts() {
    if (this.small || !this.painter) return;
    for (const chart of this.charts) chart.draw(this.painter);
    this.drawTicks();
  }

  // Beats and key frames along the slider.
  drawTicks() {
    const beats = beatTimes(this.scene);
    const { keyframes } = this.scene.floor;
    this.ticks.classList.toggle("kg-none", beats.length + keyframes.length === 0);
    const [width, height, context, ratio] = sized(this.ticks);
    // The slider's knob stays within its ends.
    const x = (time) => 8 * ratio + ((width - 16 * ratio) * time) / this.scene.seconds;
    context.fillStyle = this.painter.muted;
    for (const beat of beats) context.fillRect(x(beat), 0, 1.5 * ratio, 0.6 * height);
    context.fillStyle = this.painter.goal;
    for (const [frame] of keyframes) {
      context.beginPath();
      context.arc(x(frame / this.scene.figures[0].fps), height / 2, 4 * ratio, 0, 2 * Math.PI);
      context.fill();
    }
  }

  button(name, label, act) {
    const button = element("button", { type: "button", "aria-label": label, title: label });
    if (ICONS[name]) button.append(icon(name));
    else button.textContent = name;
    button.addEventListener("click", act);
    return button;
  }

  // A button that is down while `read` returns true.
  toggleButton(name, label, read, write) {
    const button = this.button(name, label, () => {
      write();
      this.dress();
    });
    this.toggles.push([button, read]);
    return button;
  }

  build() {
    const names = this.scene.figures.map((figure) => figure.name).join(", ");
    this.canvas = element("canvas", { role: "img", "aria-label": `Motion in 3D: ${names}` });
    const stage = element("div", { class: "kg-stage" });
    stage.append(this.canvas);
    this.section.append(stage);
    this.toggles = [];
    this.charts = [];
    this.playButton = this.button("play", "Play", () => this.toggle());
    this.hands();
    if (this.small) {
      this.line = element("div", { class: "kg-line" });
      stage.append(this.line, this.playButton);
      this.dress();
      return;
    }
    this.playButton.classList.add("kg-play");
    this.section.append(this.scrubber(), this.transport(), this.chartGrid(), this.help());
    this.section.tabIndex = 0;
    this.dress();
  }

  scrubber() {
    const scrub = element("div", { class: "kg-scrub" });
    const last = this.frames - 1;
    this.slider = element("input", { type: "range", min: 0, max: last, step: 1, value: 0, "aria-label": "Frame" });
    this.slider.addEventListener("input", () => this.seek(Number(this.slider.value)));
    this.ticks = element("canvas", { "aria-hidden": "true" });
    scrub.append(this.slider, this.ticks);
    return scrub;
  }

  transport() {
    const bar = element("div", { class: "kg-bar" });
    this.label = element("span", { class: "kg-time" });
    this.rates = element("select", { "aria-label": "Speed", title: "Speed" });
    for (const rate of RATES) this.rates.append(element("option", { value: rate }, `${rate}×`));
    this.rates.addEventListener("change", () => this.setRate(Number(this.rates.value)));
    const { clock, scene } = this;
    bar.append(
      this.button("back", "One frame back", () => this.step(-1)),
      this.playButton,
      this.button("ahead", "One frame ahead", () => this.step(1)),
      this.rates,
      this.toggleButton("Loop", "Loop", () => clock.loop, () => (clock.loop = !clock.loop)),
      this.toggleButton("Follow", "Follow the figures", () => this.following, () => (this.following = !this.following)),
      this.toggleButton("Trail", "Trail on the floor", () => this.painter?.trail ?? true, () => (this.painter.trail = !this.painter.trail)),
    );
    if (scene.figures.length > 1) {
      bar.append(
        this.toggleButton("Side by side", "Side by side", () => this.sideBySide, () => (this.sideBySide = !this.sideBySide)),
        this.toggleButton("Fit each", "Fit each figure to its pane", () => this.fitEach, () => (this.fitEach = !this.fitEach)),
      );
    }
    if (clock.audio) {
      bar.append(this.toggleButton("Sound", "Sound", () => !clock.audio.muted, () => (clock.audio.muted = !clock.audio.muted)));
    }
    bar.append(this.button("Reset view", "Reset the view", () => this.resetView()), this.label);
    this.setRate(1);
    return bar;
  }

  chartGrid() {
    const grid = element("div", { class: "kg-charts" });
    const seek = (time) => this.seekTime(Math.max(0, time));
    this.charts = chartsOf(this.scene).map((chart) => new Chart(chart, this.scene, seek));
    if (this.scene.figures.some((figure) => figure.contacts.length > 0)) {
      this.charts.unshift(new ContactChart(this.scene, seek));
    }
    if (this.scene.figures.some((figure) => figure.origins)) {
      this.charts.unshift(new OriginChart(this.scene, seek), new ExampleChart(this.scene, seek));
    }
    this.rangeLabel = element("span", { class: "kg-time" });
    const bar = element("div", { class: "kg-bar kg-range" });
    if (!this.whole) {
      const toggle = () => (this.whole = !this.whole);
      bar.append(this.toggleButton("Whole", "Curves over the whole length", () => this.whole, toggle), this.rangeLabel);
      grid.append(bar);
    }
    grid.append(...this.charts.map((chart) => chart.element));
    return grid;
  }

  help() {
    const details = element("details", { class: "kg-help" });
    const list = element("dl");
    for (const [keys, meaning] of KEYS) {
      const term = element("dt");
      term.append(element("kbd", {}, keys));
      list.append(term, element("dd", {}, meaning));
    }
    details.append(element("summary", {}, "Keys, mouse and touch"), list);
    return details;
  }

  resetView() {
    this.camera.reset();
    this.stale = true;
  }

  setRate(rate) {
    this.clock.setRate(rate);
    this.rates.value = rate;
  }

  // Labels of buttons name their action; toggles show their state.
  dress() {
    if (!this.playButton) return;
    const label = this.playing ? "Pause" : "Play";
    this.playButton.replaceChildren(icon(this.playing ? "pause" : "play"));
    this.playButton.setAttribute("aria-label", label);
    this.playButton.title = label;
    for (const [button, read] of this.toggles) button.setAttribute("aria-pressed", String(read()));
    this.stale = true;
  }

  // Mouse and touch on the canvas.
  hands() {
    const pointers = new Map();
    const { canvas, camera } = this;
    const pinch = () => {
      const [a, b] = [...pointers.values()];
      return { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, apart: Math.hypot(a.x - b.x, a.y - b.y) };
    };
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    });
    canvas.addEventListener("pointermove", (event) => {
      const before = pointers.get(event.pointerId);
      if (!before) return;
      const now = { x: event.clientX, y: event.clientY };
      const old = pointers.size === 2 ? pinch() : null;
      pointers.set(event.pointerId, now);
      const [dx, dy] = [now.x - before.x, now.y - before.y];
      if (old) {
        const two = pinch();
        camera.shift(two.x - old.x, two.y - old.y, this.metresPerPixel);
        if (two.apart > 0) camera.scale(old.apart / two.apart);
      } else if (event.shiftKey || event.buttons & 6) {
        camera.shift(dx, dy, this.metresPerPixel);
      } else {
        camera.orbit(dx, dy);
      }
      this.stale = true;
    });
    for (const end of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(end, (event) => pointers.delete(event.pointerId));
    }
    if (this.small) return;
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      camera.scale(Math.exp(Math.max(-60, Math.min(60, event.deltaY)) * 0.004));
      this.stale = true;
    }, { passive: false });
  }

  press(button) {
    const [found] = this.toggles.find(([{ textContent }]) => textContent === button) ?? [];
    found?.click();
  }

  // True if the key has a meaning here.
  key({ key, shiftKey, target }) {
    const onButton = target instanceof HTMLElement && target.matches("button, summary");
    if (key === " " && onButton) return false;
    const rate = RATES.indexOf(this.clock.rate);
    const actions = {
      " ": () => this.toggle(),
      ArrowLeft: () => this.step(shiftKey ? -10 : -1),
      ArrowRight: () => this.step(shiftKey ? 10 : 1),
      Home: () => this.seek(0),
      End: () => this.seek(this.frames - 1),
      ArrowUp: () => this.setRate(RATES[Math.min(RATES.length - 1, rate + 1)]),
      ArrowDown: () => this.setRate(RATES[Math.max(0, rate - 1)]),
      l: () => this.press("Loop"),
      s: () => this.press("Side by side"),
      e: () => this.press("Fit each"),
      w: () => this.press("Whole"),
      f: () => this.press("Follow"),
      t: () => this.press("Trail"),
      m: () => this.press("Sound"),
      r: () => this.resetView(),
      "+": () => this.camera.scale(0.85),
      "=": () => this.camera.scale(0.85),
      "-": () => this.camera.scale(1 / 0.85),
    };
    const action = actions[key.length === 1 ? key.toLowerCase() : key];
    if (!action) return false;
    action();
    this.stale = true;
    return true;
  }
}

const start = () => {
  const viewers = [...document.querySelectorAll("section.kg")].map((section) => new Viewer(section));
  window.kinegrad = { viewers };
  const large = viewers.filter((viewer) => !viewer.small);
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey || event.target.matches("select, textarea")) return;
    const around = large.find((viewer) => viewer.section.contains(event.target));
    const viewer = around ?? (large.length === 1 ? large[0] : null);
    if (viewer?.clock && viewer.key(event)) event.preventDefault();
  });
  const loop = (now) => {
    for (const viewer of viewers) viewer.tick(now);
    requestAnimationFrame(loop);
  };
  requestAnimationFrame(loop);
};

if (document.readyState === "loading") document.addEventListener("DOMContentLoaded", start);
else start();
