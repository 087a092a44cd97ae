// A camera that orbits a target, and the projection onto a part of the canvas.

const VIEW_ANGLE = (DRAWING.camera.view_degrees * Math.PI) / 180;

// The distance from which an eye at the initial pitch sees all `points` from any side. Points are
// `[reach, rise]`: the distance from the vertical axis through the target, and the height above the
// target. `aspect` is width by height of the picture.
const distanceFor = (points, aspect) => {
  const [sp, cp] = [Math.sin(DRAWING.camera.pitch), Math.cos(DRAWING.camera.pitch)];
  const half = DRAWING.camera.filled * Math.tan(VIEW_ANGLE / 2);
  let far = 0;
  for (const [reach, rise] of points) {
    const before = Math.abs(rise * cp - reach * sp) / half + reach * cp;
    const behind = Math.abs(rise * cp + reach * sp) / half - reach * cp;
    const beside = reach * Math.hypot(1 / (half * aspect), cp);
    far = Math.max(far, Math.max(before, behind, beside) + rise * sp);
  }
  return far;
};

class Camera {
  constructor() {
    this.reset();
  }

  reset() {
    this.yaw = DRAWING.camera.yaw;
    this.pitch = DRAWING.camera.pitch;
    this.zoom = 1;
    this.pan = [0, 0, 0];
  }

  orbit(dx, dy) {
    this.yaw -= dx * 0.008;
    this.pitch = Math.min(1.55, Math.max(-0.3, this.pitch + dy * 0.008));
  }

  scale(factor) {
    this.zoom = Math.min(20, Math.max(0.05, this.zoom * factor));
  }

  // Moves the target with the pointer; a pixel is `metres` long at the target.
  shift(dx, dy, metres) {
    const [sy, cy] = [Math.sin(this.yaw), Math.cos(this.yaw)];
    const [sp, cp] = [Math.sin(this.pitch), Math.cos(this.pitch)];
    const right = [cy, 0, -sy];
    const up = [-sy * sp, cp, -cy * sp];
    for (let axis = 0; axis < 3; axis++) {
      this.pan[axis] += metres * (dy * up[axis] - dx * right[axis]);
    }
  }

  // The view of `target` from `distance`, in the rectangle of `pane`.
  view(target, distance, pane) {
    const [sy, cy] = [Math.sin(this.yaw), Math.cos(this.yaw)];
    const [sp, cp] = [Math.sin(this.pitch), Math.cos(this.pitch)];
    const far = distance * this.zoom;
    const at = target.map((value, axis) => value + this.pan[axis]);
    return {
      eye: [at[0] + far * sy * cp, at[1] + far * sp, at[2] + far * cy * cp],
      right: [cy, 0, -sy],
      up: [-sy * sp, cp, -cy * sp],
      ahead: [-sy * cp, -sp, -cy * cp],
      scale: (0.5 * pane.height) / Math.tan(VIEW_ANGLE / 2),
      x: pane.x + pane.width / 2,
      y: pane.y + pane.height / 2,
      near: DRAWING.camera.near * far,
      far,
      at,
    };
  }
}

// Right, up and depth of a point.
const seen = (view, x, y, z) => {
  const [dx, dy, dz] = [x - view.eye[0], y - view.eye[1], z - view.eye[2]];
  const { right, up, ahead } = view;
  return [
    dx * right[0] + dz * right[2],
    dx * up[0] + dy * up[1] + dz * up[2],
    dx * ahead[0] + dy * ahead[1] + dz * ahead[2],
  ];
};

const onScreen = (view, [x, y, depth]) => [
  view.x + (x * view.scale) / depth,
  view.y - (y * view.scale) / depth,
];

// The point between `a` and `b` that lies on the near plane.
const clipped = (view, a, b) => {
  const part = (view.near - a[2]) / (b[2] - a[2]);
  return [0, 1, 2].map((axis) => a[axis] + part * (b[axis] - a[axis]));
};
