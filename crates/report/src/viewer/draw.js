// Drawing of a scene into parts of a canvas, from far to near.

const mixed = (from, to, part) => {
  const channels = [1, 3, 5].map((at) => {
    const [a, b] = [from, to].map((colour) => parseInt(colour.slice(at, at + 2), 16));
    return Math.round(a + part * (b - a)).toString(16).padStart(2, "0");
  });
  return `#${channels.join("")}`;
};

// One colour for each figure of a scene.
const colourOf = (index) => DRAWING.figures[index % DRAWING.figures.length];

// Faces of a lone root's body, seen from outside; its front is +z.
const FACES = [[0, 1, 3, 2], [5, 4, 6, 7], [4, 0, 2, 6], [1, 5, 7, 3], [2, 3, 7, 6], [4, 5, 1, 0]];

// Faces, seen from outside, of a prism or cone along z, without its far end.
const prism = (near, from, far, to) => {
  const ring = (radius, z) =>
    Array.from({ length: DRAWING.root.sides }, (_, i) => {
      const angle = (2 * Math.PI * i) / DRAWING.root.sides;
      return [radius * Math.cos(angle), radius * Math.sin(angle), z];
    });
  const [a, b] = [ring(near, from), ring(far, to)];
  const next = (i) => (i + 1) % DRAWING.root.sides;
  return [[...a].reverse(), ...a.map((place, i) => [place, a[next(i)], b[next(i)], b[i]])];
};

const turned = ([w, x, y, z], [a, b, c]) => {
  const [i, j, k] = [2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)];
  return [a + w * i + y * k - z * j, b + w * j + z * i - x * k, c + w * k + x * j - y * i];
};

class Painter {
  constructor(context, scene) {
    this.context = context;
    this.scene = scene;
    this.trail = true;
  }

  setColours(element) {
    const style = getComputedStyle(element);
    const read = (name) => style.getPropertyValue(name).trim();
    this.ink = read("--kg-ink");
    this.page = read("--kg-page");
    this.ground = read("--kg-stage");
    this.grid = read("--kg-grid");
    this.muted = read("--kg-muted");
    this.shade = read("--kg-shadow");
    this.contact = read("--kg-contact");
    this.goal = read("--kg-goal");
    this.obstacle = read("--kg-obstacle");
  }

  // Draws the figures of `pane` at the frames that `frameOf` returns.
  pane(pane, view, frameOf, ratio) {
    const { context } = this;
    this.view = view;
    this.level = pane.ground;
    this.ratio = ratio;
    context.save();
    context.beginPath();
    context.rect(pane.x, pane.y, pane.width, pane.height);
    context.clip();
    context.fillStyle = this.ground;
    context.fillRect(pane.x, pane.y, pane.width, pane.height);
    this.floor();
    for (const index of pane.figures) this.trails(index, frameOf(index));
    this.goals(frameOf(0));
    const pieces = [];
    for (const index of pane.figures) this.figure(index, frameOf(index), pieces);
    pieces.sort((a, b) => b.depth - a.depth);
    for (const piece of pieces) piece.draw();
    this.label(pane);
    context.restore();
  }

  label(pane) {
    const { context, ratio } = this;
    const { size, left, top, square, text_left } = DRAWING.label;
    context.font = `600 ${size * ratio}px system-ui, sans-serif`;
    context.textBaseline = "top";
    let y = pane.y + top * ratio;
    for (const index of pane.figures) {
      context.fillStyle = colourOf(index);
      context.fillRect(pane.x + left * ratio, y + 1.5 * ratio, square * ratio, square * ratio);
      context.fillStyle = this.ink;
      const { name } = this.scene.figures[index];
      const level = pane.ground === this.scene.ground ? "" : ` · ground at ${pane.ground.toFixed(2)} m`;
      context.fillText(name + level, pane.x + text_left * ratio, y, Math.max(1, pane.width - (text_left + top) * ratio));
      y += (size + 5) * ratio;
    }
  }

  // A line through points `[x, y, z]`, cut at the near plane, added to the current path.
  line(points, closed) {
    const { view, context } = this;
    let before = null;
    let moved = false;
    const count = points.length + (closed ? 1 : 0);
    for (let i = 0; i < count; i++) {
      const point = points[i % points.length];
      const now = seen(view, point[0], point[1], point[2]);
      if (before !== null) {
        const shows = [before[2] > view.near, now[2] > view.near];
        if (shows[0] || shows[1]) {
          const from = shows[0] ? before : clipped(view, before, now);
          const to = shows[1] ? now : clipped(view, before, now);
          if (!moved || !shows[0]) context.moveTo(...onScreen(view, from));
          context.lineTo(...onScreen(view, to));
          moved = shows[1];
        }
      }
      before = now;
    }
  }

  // The part of a polygon before the near plane, as the current path.
  area(points) {
    const { view, context } = this;
    const places = points.map(([x, y, z]) => seen(view, x, y, z));
    const shown = [];
    places.forEach((now, i) => {
      const before = places[(i + places.length - 1) % places.length];
      if (before[2] > view.near !== now[2] > view.near) shown.push(clipped(view, before, now));
      if (now[2] > view.near) shown.push(now);
    });
    context.beginPath();
    shown.forEach((place, i) => {
      const [x, y] = onScreen(view, place);
      if (i === 0) context.moveTo(x, y);
      else context.lineTo(x, y);
    });
    context.closePath();
  }

  // A round grid of squares below the target.
  floor() {
    const { context, view, scene } = this;
    const table = DRAWING.floor;
    const cell = 10 ** Math.round(Math.log10(Math.max(scene.size / table.size_per_cell, view.far / table.most_cells)));
    const reach = Math.ceil((table.reach * view.far) / cell / 2) * cell;
    const [cx, cz] = [view.at[0], view.at[2]].map((value) => Math.round(value / cell) * cell);
    const y = this.level;
    context.beginPath();
    for (let i = -reach; i <= reach + cell / 2; i += cell) {
      const half = Math.sqrt(Math.max(0, reach * reach - i * i));
      this.line([[cx + i, y, cz - half], [cx + i, y, cz + half]]);
      this.line([[cx - half, y, cz + i], [cx + half, y, cz + i]]);
    }
    context.lineWidth = table.width * this.ratio;
    context.strokeStyle = this.grid;
    context.stroke();
  }

  circle([x, z], radius) {
    const points = [];
    const { corners } = DRAWING.goal;
    for (let i = 0; i < corners; i++) {
      const angle = (2 * Math.PI * i) / corners;
      const [dx, dz] = [radius * Math.cos(angle), radius * Math.sin(angle)];
      points.push([x + dx, this.level, z + dz]);
    }
    return points;
  }

  // The root trajectory, faint, and its last two seconds.
  trails(index, frame) {
    if (!this.trail) return;
    const { context, scene, ratio } = this;
    const figure = scene.figures[index];
    const { positions, count, frames, root, fps } = figure;
    const place = (t) => {
      const at = 3 * (t * count + root);
      return [positions[at], this.level, positions[at + 2]];
    };
    const line = (from, to, most) => {
      const step = Math.max(1, Math.ceil((to - from) / most));
      const points = [];
      for (let t = from; t < to; t += step) points.push(place(t));
      points.push(place(to));
      context.beginPath();
      this.line(points);
      context.stroke();
    };
    context.lineJoin = "round";
    context.strokeStyle = colourOf(index);
    const table = DRAWING.trail;
    context.globalAlpha = table.opacity;
    context.lineWidth = table.width * ratio;
    line(0, frames - 1, table.points);
    context.globalAlpha = table.recent_opacity;
    context.lineWidth = table.recent_width * ratio;
    line(Math.max(0, frame - Math.round(table.recent_seconds * fps)), frame, table.recent_points);
    context.globalAlpha = 1;
  }

  goals(frame) {
    const { context, scene, ratio } = this;
    const { path, keyframes, obstacles, polygons } = scene.floor;
    const table = DRAWING.goal;
    const standing = ([x, z]) => [x, this.level, z];
    const shapes = obstacles.map(([centre, radius]) => this.circle(centre, radius));
    for (const corners of polygons) shapes.push(corners.map(standing));
    context.lineWidth = table.width * ratio;
    for (const shape of shapes) {
      context.fillStyle = this.obstacle;
      context.strokeStyle = this.obstacle;
      this.area(shape);
      context.globalAlpha = table.area_opacity;
      context.fill();
      context.globalAlpha = 1;
      context.stroke();
    }
    context.strokeStyle = this.goal;
    if (path.length > 1) {
      context.setLineDash(table.dash.map((part) => part * ratio));
      context.beginPath();
      this.line(path.map(standing));
      context.stroke();
      context.setLineDash([]);
    }
    context.font = `${DRAWING.label.keyframe_size * ratio}px system-ui, sans-serif`;
    context.textBaseline = "bottom";
    for (const [at, place] of keyframes) {
      const near = Math.abs(at - frame) <= table.near_frames;
      const ring = this.circle(place, table.keyframe * scene.size);
      this.area(ring);
      context.globalAlpha = near ? table.near_opacity : table.opacity;
      context.fillStyle = this.goal;
      context.fill();
      context.globalAlpha = 1;
      context.lineWidth = (near ? table.near_ring_width : table.ring_width) * ratio;
      context.stroke();
      const centre = seen(this.view, place[0], this.level, place[1]);
      if (centre[2] < this.view.near) continue;
      const [x, y] = onScreen(this.view, centre);
      context.fillStyle = this.ink;
      context.fillText(String(at), x + 8 * ratio, y - 4 * ratio);
    }
  }

  // Draws shadow and contacts, and adds the pieces of the body to `pieces`, which are sorted by depth.
  figure(index, frame, pieces) {
    const figure = this.scene.figures[index];
    const { positions, count } = figure;
    const base = 3 * frame * count;
    const spots = (figure.spots ??= new Float32Array(3 * count));
    for (let j = 0; j < count; j++) {
      const at = base + 3 * j;
      const place = seen(this.view, positions[at], positions[at + 1], positions[at + 2]);
      const [x, y] = onScreen(this.view, place);
      spots[3 * j] = x;
      spots[3 * j + 1] = y;
      spots[3 * j + 2] = place[2];
    }
    const touching = figure.contacts.filter(({ ranges }) =>
      ranges.some(([from, to]) => from <= frame && frame < to),
    );
    this.shadow(figure, base);
    const colour = colourOf(index);
    if (count === 1) {
      this.root(figure, frame, colour, pieces);
    } else {
      this.skeleton(figure, colour, pieces);
    }
    for (const { joint } of touching) this.touch(figure, base, joint, pieces);
  }

  shadow(figure, base) {
    const { context, view, ratio } = this;
    const { positions, bones } = figure;
    const flat = (joint) => {
      const at = base + 3 * joint;
      return [positions[at], this.level, positions[at + 2]];
    };
    context.beginPath();
    for (const { parent, joint } of bones) this.line([flat(parent), flat(joint)]);
    context.lineCap = "round";
    context.lineWidth = Math.max(ratio, (DRAWING.shadow.width * figure.height * view.scale) / view.far);
    context.strokeStyle = this.shade;
    context.globalAlpha = DRAWING.shadow.opacity;
    context.stroke();
    context.globalAlpha = 1;
  }

  skeleton(figure, colour, pieces) {
    const { context, view, ratio, ground } = this;
    const { bones, spots, count } = figure;
    const { least_width, edge, left_lighter, right_darker } = DRAWING.bone;
    const shades = [mixed(colour, "#000000", right_darker), colour, mixed(colour, "#ffffff", left_lighter)];
    const ball = (x, y, depth, radius, fill) => {
      const size = Math.max(DRAWING.ball.least * ratio, (radius * view.scale) / depth);
      context.beginPath();
      context.arc(x, y, size, 0, 2 * Math.PI);
      context.fillStyle = fill;
      context.fill();
      context.lineWidth = DRAWING.ball.edge * ratio;
      context.strokeStyle = ground;
      context.stroke();
    };
    for (const { parent, joint, radius, side } of bones) {
      const [a, b] = [3 * parent, 3 * joint];
      if (spots[a + 2] < view.near || spots[b + 2] < view.near) continue;
      const depth = (spots[a + 2] + spots[b + 2]) / 2;
      const width = Math.max(least_width * ratio, (2 * radius * view.scale) / depth);
      const draw = () => {
        context.lineCap = "round";
        context.beginPath();
        context.moveTo(spots[a], spots[a + 1]);
        context.lineTo(spots[b], spots[b + 1]);
        context.lineWidth = width + 2 * edge * ratio;
        context.strokeStyle = ground;
        context.stroke();
        context.lineWidth = width;
        context.strokeStyle = shades[side + 1];
        context.stroke();
      };
      pieces.push({ depth, draw });
    }
    const dots = bones.length === 0 ? Array.from({ length: count }, (_, joint) => [joint, joint, DRAWING.ball.joint]) : [];
    if (figure.head) dots.push([...figure.head, DRAWING.ball.head]);
    for (const [joint, other, part] of dots) {
      const [x, y, depth] = [0, 1, 2].map((i) => (spots[3 * joint + i] + spots[3 * other + i]) / 2);
      if (depth < view.near) continue;
      const radius = part * figure.height;
      pieces.push({ depth: depth - radius, draw: () => ball(x, y, depth, radius, shades[1]) });
    }
  }

  // A joint that stands on the ground: a ring below it, and a highlighted joint.
  touch(figure, base, joint, pieces) {
    const { context, view, ratio, contact } = this;
    const table = DRAWING.contact;
    const at = base + 3 * joint;
    const { positions, spots } = figure;
    this.area(this.circle([positions[at], positions[at + 2]], table.ring * figure.height));
    context.globalAlpha = table.ring_opacity;
    context.fillStyle = contact;
    context.fill();
    context.globalAlpha = 1;
    const [x, y, depth] = spots.subarray(3 * joint, 3 * joint + 3);
    if (depth < view.near) return;
    const size = Math.max(table.least * ratio, (table.dot * figure.height * view.scale) / depth);
    const draw = () => {
      context.beginPath();
      context.arc(x, y, size, 0, 2 * Math.PI);
      context.fillStyle = contact;
      context.fill();
    };
    pieces.push({ depth: depth - table.nearer * figure.height, draw });
  }

  // A lone root: a body with an arrow to its front if its orientation is known, else a ball; and a
  // vertical line to the ground.
  root(figure, frame, colour, pieces) {
    const { context, view, ratio } = this;
    const table = DRAWING.root;
    const at = [0, 1, 2].map((axis) => figure.positions[3 * frame + axis]);
    const depth = figure.spots[2];
    if (depth < view.near) return;
    const foot = [at[0], this.level, at[2]];
    this.area(this.circle([at[0], at[2]], table.shadow));
    context.globalAlpha = DRAWING.shadow.opacity;
    context.fillStyle = this.shade;
    context.fill();
    context.globalAlpha = 1;
    context.beginPath();
    this.line([at, foot]);
    context.lineWidth = table.line * ratio;
    context.strokeStyle = this.muted;
    context.stroke();
    if (!figure.orientations) {
      const [x, y] = figure.spots;
      const draw = () => {
        context.beginPath();
        context.arc(x, y, (table.ball * view.scale) / depth, 0, 2 * Math.PI);
        context.fillStyle = colour;
        context.fill();
      };
      pieces.push({ depth, draw });
      return;
    }
    const turn = figure.orientations.subarray(4 * frame, 4 * frame + 4);
    const world = (point) => turned(turn, point).map((value, axis) => at[axis] + value);
    pieces.push({ depth, draw: () => this.body(world, at, colour) });
  }

  body(world, at, colour) {
    const { context, view, ratio } = this;
    const { body, shaft, head, light: lamp, lighter, darker, edge_darker } = DRAWING.root;
    const [w, h, d] = body;
    const front = world([0, 0, 1]).map((value, axis) => value - at[axis]);
    // The eye along the direction of the front.
    const towards = [0, 1, 2].reduce((sum, axis) => sum + front[axis] * (view.eye[axis] - at[axis]), 0);
    const solid = (faces, fill, isRound) => {
      for (const face of faces) {
        const points = face.map(world);
        const [a, b, c] = points;
        const [u, v] = [b, c].map((point) => point.map((value, axis) => value - a[axis]));
        const normal = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
        const facing = normal.reduce((sum, value, axis) => sum + value * (view.eye[axis] - a[axis]), 0);
        if (facing <= 0) continue;
        const light = normal.reduce((sum, value, axis) => sum + value * lamp[axis], 0) / Math.hypot(...normal);
        this.area(points);
        const shade = light > 0 ? mixed(fill, "#ffffff", lighter * light) : mixed(fill, "#000000", -darker * light);
        context.fillStyle = shade;
        context.fill();
        context.lineJoin = "round";
        context.lineWidth = ratio;
        context.strokeStyle = isRound ? shade : mixed(fill, "#000000", edge_darker);
        context.stroke();
      }
    };
    const corner = (i) => [i & 1 ? w : -w, i & 2 ? h : -h, i & 4 ? -d : d];
    const [neck, tip] = [d + shaft[1], d + shaft[1] + head[1]];
    // Body, shaft and head lie behind one another along the front: from far to near of the eye.
    const parts = [
      [d, () => solid(FACES.map((face) => face.map(corner)), colour)],
      [neck, () => solid(prism(shaft[0], d, shaft[0], neck), this.contact, true)],
      [Infinity, () => solid(prism(head[0], neck, 0, tip), this.contact, true)],
    ];
    const own = parts.findIndex(([end]) => towards < end);
    const order = [...parts.slice(0, own), ...parts.slice(own + 1).reverse(), parts[own]];
    for (const [, draw] of order) draw();
  }
}
