/* What is drawn: the picture of the mechanism brought to the places its bodies have, on a floor with a grid. */

/** A round number (1, 2 or 5 times a power of ten) not above a size. */
function rounded(size) {
  const power = 10 ** Math.floor(Math.log10(size));
  return power * [5, 2, 1].find((digit) => digit * power <= size);
}

class Stage {
  constructor(renderer, scene, motion) {
    this.renderer = renderer;
    this.motion = motion;
    this.stage = scene.stage;
    this.skins = scene.picture.skins.map((skin) => {
      const item = renderer.skin(skin.bodies.length, skin.bodies[0].length, rgb(skin.colour));
      return { ...skin, item };
    });
    this.scale = scene.scale;
    this.bars = scene.picture.bars.map((bar) => {
      const pieces = bar.x.length - 1;
      const item = renderer.solids(box([1, 2]), pieces, 0), ends = renderer.solids(box(), 2, 0);
      for (let k = 0; k < pieces; k++) {
        item.data.set(rgb(bar.colour), INSTANCE * k + 12);
      }
      return { ...bar, item, ends };
    });
    this.groups = Object.keys(SOLIDS).map((solid) => this.group(solid, scene.picture)).filter((group) => group);
    this.prepareFloor();
  }

  /** All parts and links made from one solid. */
  group(solid, picture) {
    const parts = picture.parts.filter((part) => part.solid === solid);
    const links = picture.links.filter((link) => link.solid === solid);
    if (parts.length + links.length === 0) {
      return null;
    }
    const wire = solid === "coil" ? WIRE : 0;
    const item = this.renderer.solids(SOLIDS[solid](), parts.length + links.length, wire);
    [...parts, ...links].forEach((thing, k) => item.data.set(rgb(thing.colour), INSTANCE * k + 12));
    return { parts, links, item };
  }

  prepareFloor() {
    const { axes, centre, half } = this.stage;
    const [right, up, front] = axes;
    const reach = 2.6 * Math.max(half[0], half[2], 0.5 * half[1]);
    const spacing = rounded(reach / 5);
    const height = centre[1] - half[1] - 0.01 * Math.hypot(...half);
    const middle = [centre[0], centre[2]].map((x) => spacing * Math.round(x / spacing));
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
    this.motion.place(time);
    for (const { parts, links, item } of this.groups) {
      parts.forEach((part, k) => this.placePart(part, item.data, INSTANCE * k));
      links.forEach((link, k) => this.placeLink(link, item.data, INSTANCE * (parts.length + k)));
      this.renderer.update(item);
    }
    for (const bar of this.bars) {
      this.placeBar(bar);
      this.renderer.update(bar.item);
      this.renderer.update(bar.ends);
    }
    for (const skin of this.skins) {
      this.placeSkin(skin);
      this.renderer.update(skin.item);
    }
    this.reached = this.motion.frame(time);
  }

  placePart(part, data, i) {
    const A = this.motion.orientation(part.body), m = part.axes;
    for (let column = 0; column < 9; column += 3) {
      for (let k = 0; k < 3; k++) {
        data[i + column + k] = A[k] * m[column] + A[3 + k] * m[column + 1] + A[6 + k] * m[column + 2];
      }
    }
    data.set(this.motion.point(part.body, part.at), i + 9);
  }

  placeLink(link, data, i) {
    const a = this.motion.point(link.a, link.at_a), b = this.motion.point(link.b, link.at_b);
    const along = add(b, a, -1), length = Math.hypot(...along);
    const least = [0, 1, 2].reduce((best, k) => (Math.abs(along[k]) < Math.abs(along[best]) ? k : best), 0);
    const other = [0, 0, 0];
    other[least] = 1;
    const x = length > 0 ? scaled(unit(cross(other, along)), link.radius) : [0, 0, 0];
    const y = length > 0 ? scaled(unit(cross(along, x)), link.radius) : [0, 0, 0];
    data.set([...x, ...y, ...along, ...scaled(add(a, b), 0.5)], i);
  }

  /** Four sides from every point of the bent axis to the next; the first and the last piece once more, closed. */
  placeBar(bar) {
    const points = bar.x.map((_, k) => this.motion.point(bar.body, bent(bar, k, this.motion.p, this.scale)));
    const z = this.motion.orientation(bar.body).slice(6);
    for (let k = 0; k + 1 < points.length; k++) {
      const along = add(points[k + 1], points[k], -1);
      const up = scaled(unit(cross(z, along)), bar.height);
      const middle = scaled(add(points[k], points[k + 1]), 0.5);
      bar.item.data.set([...along, ...up, ...scaled(z, bar.width), ...middle], INSTANCE * k);
    }
    const data = bar.item.data;
    bar.ends.data.set([...data.slice(0, INSTANCE), ...data.slice(-INSTANCE)]);
  }

  placeSkin({ bodies, at, item }) {
    const rows = bodies.length, columns = bodies[0].length, data = item.data;
    for (let i = 0; i < rows; i++) {
      for (let j = 0; j < columns; j++) {
        data.set(this.motion.point(bodies[i][j], at), 6 * (i * columns + j));
      }
    }
    const difference = (a, b) => [0, 1, 2].map((k) => data[6 * b + k] - data[6 * a + k]);
    for (let i = 0; i < rows; i++) {
      for (let j = 0; j < columns; j++) {
        const [above, below] = [Math.max(i - 1, 0), Math.min(i + 1, rows - 1)].map((k) => k * columns + j);
        const [left, right] = [Math.max(j - 1, 0), Math.min(j + 1, columns - 1)].map((k) => i * columns + k);
        data.set(cross(difference(above, below), difference(left, right)), 6 * (i * columns + j) + 3);
      }
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
    const things = (mesh) => {
      [...this.groups, ...this.bars].forEach(({ item }) => renderer.drawSolids(item));
      this.bars.forEach(({ ends }) => renderer.drawSolids(ends));
      this.skins.forEach((skin) => renderer.drawSkin(skin.item, mesh));
    };
    const above = dot(look.eye, up) > this.floor.height;
    if (show.grid) {
      renderer.drawLines(this.floor.lines, theme.grid, 1, { fade: this.floor.fade });
    }
    if (show.shadow && above) {
      renderer.shadows(theme.shadow, () => things(false));
    }
    things(show.mesh);
    if (this.path) {
      renderer.drawLines(this.path, theme.path, 2, { reached: this.reached });
    }
  }
}
