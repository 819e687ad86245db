/* The floor with its grid, and what moves above it: a run, beside it another one, and the arrows of forces. */

/** A round number (1, 2 or 5 times a power of ten) not above a size. */
function rounded(size) {
  const power = 10 ** Math.floor(Math.log10(size));
  return power * [5, 2, 1].find((digit) => digit * power <= size);
}

const BESIDE = 0.35; // opacity of the run beside
const MARK = 0.009; // radius of the ball at the point of a picked body that is told of, against the size of the stage

class Stage {
  /** `beside`: the motion of another run, or null. */
  constructor(renderer, scene, motion, beside) {
    this.renderer = renderer;
    this.motion = motion;
    this.stage = scene.stage;
    this.figure = new Figure(renderer, scene, motion, scene.scale, scene.stops);
    this.beside = beside && new Figure(renderer, scene.against, beside, scene.scale, scene.stops);
    this.arrows = new Arrows(renderer, scene, motion);
    this.middles = scene.picture.middles;
    this.mark = renderer.solids(sphere(), 1, 0);
    this.prepareFloor();
  }

  prepareFloor() {
    const { axes, center, half } = this.stage;
    const [right, up, front] = axes;
    const reach = 2.6 * Math.max(half[0], half[2], 0.5 * half[1]);
    const spacing = rounded(reach / 5);
    const height = center[1] - half[1] - 0.01 * Math.hypot(...half);
    const middle = [center[0], center[2]].map((x) => spacing * Math.round(x / spacing));
    const count = Math.ceil(reach / spacing);
    const place = (a, b) => combined([right, up, front], [middle[0] + a, height, middle[1] + b]);
    const points = [];
    for (let k = -count; k <= count; k++) {
      points.push(...place(k * spacing, -count * spacing), ...place(k * spacing, count * spacing));
      points.push(...place(-count * spacing, k * spacing), ...place(count * spacing, k * spacing));
    }
    this.floor = { lines: this.renderer.lines(points, true), height, spacing, fade: [...place(0, 0), count * spacing] };
    this.light = unit(combined([right, up, front], [0.35, 1, 0.55]));
  }

  /** Bring everything to a time. */
  place(time) {
    this.figure.place(time);
    this.beside?.place(time);
    this.arrows.place();
    this.placeMark();
    this.reached = frameAt(this.motion.times, time);
  }

  placeMark() {
    const body = this.figure.picked, r = MARK * 2 * Math.hypot(...this.stage.half);
    if (body !== null) {
      this.mark.data.set([r, 0, 0, 0, r, 0, 0, 0, r, ...this.motion.point(body, this.middles[body]), ...PICKED]);
      this.renderer.update(this.mark);
    }
  }

  /** Show the path of a body's point, or none. */
  trace(body, at) {
    if (this.path) {
      this.renderer.discard(this.path);
    }
    this.path = null;
    if (body !== null) {
      const points = [];
      for (const time of this.motion.times) {
        this.motion.place(time);
        points.push(...this.motion.point(body, at));
      }
      this.path = this.renderer.lines(points, false);
    }
  }

  draw(look, theme, show) {
    const renderer = this.renderer, up = this.stage.axes[1];
    renderer.begin({ ...look, light: this.light, up, floorHeight: this.floor.height }, theme.background);
    const above = dot(look.eye, up) > this.floor.height;
    if (show.grid) {
      renderer.drawLines(this.floor.lines, theme.grid, 1, { fade: this.floor.fade });
    }
    if (show.shadow && above) {
      renderer.shadows(theme.shadow, () => this.figure.draw(false));
    }
    this.figure.draw(show.mesh);
    if (this.figure.picked !== null) {
      renderer.drawSolids(this.mark);
    }
    if (show.forces) {
      this.arrows.draw();
    }
    if (this.path) {
      renderer.drawLines(this.path, theme.path, 2, { reached: this.reached });
    }
    if (this.beside && show.beside) {
      renderer.translucent(BESIDE, () => this.beside.draw(show.mesh));
    }
    this.figure.drawGlass();
  }
}
