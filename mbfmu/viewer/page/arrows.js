/* Arrows of forces and, with two heads, of moments: as long as the scale of the scene says. */

const KINDS = { cut: "#d9483b", load: "#a463f2", drive: "#128a5e" };
const KIND_NAMES = { cut: "cut joints", load: "forces", drive: "drives" };
const THICK = 0.004; // radius of an arrow's shaft against the size of the stage
const HEAD = [2.6, 7]; // radius and length of its head against the shaft's radius

class Arrows {
  constructor(renderer, { arrows, scales, stage }, motion) {
    this.renderer = renderer;
    this.motion = motion;
    this.arrows = arrows;
    this.scales = scales;
    this.radius = THICK * 2 * Math.hypot(...stage.half);
    this.shafts = renderer.solids(cylinder(), arrows.length, 0);
    this.heads = renderer.solids(cone(), 2 * arrows.length, 0);
  }

  /** What the arrows mean, in words. */
  get legend() {
    return Object.entries(this.scales).map(([unit, [value, length]]) => `${figures(value)} ${unit} = ${figures(length)} m`);
  }

  /** The way an arrow goes as the forces are placed; null: there is none to show. */
  way(k) {
    const force = [...this.motion.f.subarray(3 * k, 3 * k + 3)], size = Math.hypot(...force);
    const [value, length] = this.scales[this.arrows[k].unit] ?? [1, 0];
    return Number.isFinite(size) && size * length > 1e-3 * value * length ? scaled(force, length / value) : null;
  }

  /** Put shafts and heads to where the bodies are placed. */
  place() {
    this.shafts.data.fill(0);
    this.heads.data.fill(0);
    this.arrows.forEach((arrow, k) => {
      const way = this.way(k), foot = this.motion.point(arrow.body, arrow.at);
      if (!way) {
        return;
      }
      const long = Math.hypot(...way), heads = arrow.unit === "N" ? 1 : 2;
      const thick = Math.min(this.radius, long / (1.5 * heads * HEAD[1]));
      const from = (back) => add(foot, way, 1 - (back * HEAD[1] * thick) / long);
      const solid = (item, i, a, b, radius) => {
        item.data.set([...stretched(a, b, radius), ...scaled(add(a, b), 0.5), ...rgb(KINDS[arrow.kind])], INSTANCE * i);
      };
      solid(this.shafts, k, foot, from(heads), thick);
      for (let head = 0; head < heads; head++) {
        solid(this.heads, 2 * k + head, from(head + 1), from(head), HEAD[0] * thick);
      }
    });
    this.renderer.update(this.shafts);
    this.renderer.update(this.heads);
  }

  draw() {
    if (this.arrows.length > 0) {
      this.renderer.drawSolids(this.shafts);
      this.renderer.drawSolids(this.heads);
    }
  }
}
