/* The camera: turns about a target, zooms and shifts. Distances along the stage's axes right, up, front. */

class Camera {
  constructor(stage) {
    this.stage = stage;
    this.field = (stage.field * Math.PI) / 180;
    this.aspect = 1;
    this.margins = { top: 0, bottom: 0, side: 0 };
    this.reset();
  }

  /** Show the whole motion from the first direction. */
  reset() {
    this.azimuth = (this.stage.azimuth * Math.PI) / 180;
    this.elevation = (this.stage.elevation * Math.PI) / 180;
    this.fit();
  }

  /** Stand where the whole motion is in the picture, clear of the margins. */
  fit() {
    this.fitted = true;
    const { right, up, back } = this.axes();
    const points = this.stage.outermost.map((along) => {
      const p = combined(this.stage.axes, along);
      return [dot(p, right), dot(p, up), dot(p, back)];
    });
    const slope = Math.tan(this.field / 2), { top, bottom, side } = this.margins;
    const farthest = (k, inner, sign) => Math.max(...points.map((p) => inner * p[2] + sign * p[k]));
    const wide = slope * this.aspect * (1 - 2 * side);
    const [above, below] = [slope * (1 - 2 * top), slope * (1 - 2 * bottom)];
    const [p, q] = [farthest(0, wide, 1), farthest(0, wide, -1)];
    const [r, s] = [farthest(1, above, 1), farthest(1, below, -1)];
    const depth = Math.max((p + q) / (2 * wide), (r + s) / (above + below));
    const height = (r - above * depth + below * depth - s) / 2;
    const center = dot(combined(this.stage.axes, this.stage.center), back);
    this.distance = depth - center;
    this.target = combined([right, up, back], [(p - q) / 2, height, center]);
  }

  /** Unit vectors right, up and back in global axes. */
  axes() {
    const [sa, ca] = [Math.sin(this.azimuth), Math.cos(this.azimuth)];
    const [se, ce] = [Math.sin(this.elevation), Math.cos(this.elevation)];
    const right = combined(this.stage.axes, [ca, 0, -sa]);
    const back = combined(this.stage.axes, [ce * sa, se, ce * ca]);
    return { right, up: cross(back, right), back };
  }

  /** `margins`: parts of the height (width) to keep free at first. */
  resize(aspect, margins) {
    this.aspect = aspect;
    this.margins = margins;
    if (this.fitted) {
      this.fit();
    }
  }

  turn(dx, dy) {
    this.fitted = false;
    this.azimuth -= dx;
    this.elevation = Math.min(Math.max(this.elevation + dy, -Math.PI / 2), Math.PI / 2);
  }

  zoom(factor) {
    this.fitted = false;
    this.distance *= factor;
  }

  /** Shift by parts of the picture's height. */
  shift(dx, dy) {
    this.fitted = false;
    const { right, up } = this.axes();
    const height = 2 * this.distance * Math.tan(this.field / 2);
    this.target = add(add(this.target, right, -dx * height), up, dy * height);
  }

  /** Eye and the matrix from global to clip coordinates. */
  look() {
    const { right, up, back } = this.axes();
    const eye = add(this.target, back, this.distance);
    const size = 4 * Math.hypot(...this.stage.half);
    const depth = dot(add(eye, combined(this.stage.axes, this.stage.center), -1), back);
    const near = Math.max(depth - size, 0.002 * size);
    const lens = perspective(this.field, this.aspect, near, Math.max(depth, 0) + size);
    return { eye, right, up, back, matrix: product(lens, view(eye, right, up, back)) };
  }
}
