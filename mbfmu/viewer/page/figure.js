/* What is drawn of one run: the picture of its mechanism brought to the places its bodies have. */

const PICKED = [1, 0.83, 0.1]; // what a picked body is tinted with

const PALE = 0.4; // how much the back of a skin is paler; that of one whose colors mean something is not

/** The color of a part of a field's limit, from -1 to 1, among colors at equal steps. */
function between(stops, part) {
  const place = (0.5 + 0.5 * Math.min(Math.max(part, -1), 1)) * (stops.length - 1);
  const k = Math.min(Math.floor(place), stops.length - 2);
  return combined([stops[k], stops[k + 1]], [k + 1 - place, place - k]);
}

/** The 3x3 matrix (columns, 9 numbers) that brings a unit solid along z between two points; its radius is given. */
function stretched(a, b, radius) {
  const along = add(b, a, -1), length = Math.hypot(...along);
  const least = [0, 1, 2].reduce((best, k) => (Math.abs(along[k]) < Math.abs(along[best]) ? k : best), 0);
  const other = [0, 0, 0];
  other[least] = 1;
  const x = length > 0 ? scaled(unit(cross(other, along)), radius) : [0, 0, 0];
  const y = length > 0 ? scaled(unit(cross(along, x)), radius) : [0, 0, 0];
  return [...x, ...y, ...along];
}

class Figure {
  constructor(renderer, { picture, fields }, motion, scale, stops) {
    this.renderer = renderer;
    this.motion = motion;
    this.scale = scale;
    this.stops = stops.map(rgb);
    this.picked = null;
    this.skins = picture.skins.map((skin, k) => {
      const item = renderer.skin(skin.bodies.length, skin.bodies[0].length, fields[k] ? 0 : PALE);
      return { ...skin, field: fields[k], item };
    });
    this.bars = picture.bars.map((bar) => {
      const item = renderer.solids(box([1, 2]), bar.x.length - 1, 0), ends = renderer.solids(box(), 2, 0);
      return { ...bar, item, ends };
    });
    const opacities = [...new Set(picture.parts.map((part) => part.opacity))].filter((opacity) => opacity < 1);
    this.meshes = { ...SOLIDS };
    (picture.meshes || []).forEach((mesh, k) => (this.meshes[`mesh${k}`] = () => facets(mesh)));
    const made = (opacity) => Object.keys(this.meshes).map((solid) => this.group(solid, picture, opacity)).filter((own) => own);
    this.groups = made(1);
    this.glasses = opacities.flatMap(made);
  }

  /** All parts, and where they hide what is behind them all links, made from one solid. */
  group(solid, picture, opacity) {
    const parts = picture.parts.filter((part) => part.solid === solid && part.opacity === opacity);
    const links = picture.links.filter((link) => link.solid === solid && opacity === 1);
    if (parts.length + links.length === 0) {
      return null;
    }
    const wire = solid === "coil" ? WIRE : 0;
    const item = this.renderer.solids(this.meshes[solid](), parts.length + links.length, wire);
    return { solid, parts, links, item, opacity };
  }

  /** Bring everything to a time. */
  place(time) {
    this.motion.place(time);
    for (const { parts, links, item } of [...this.groups, ...this.glasses]) {
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
  }

  /** The color of a thing that belongs to these bodies. */
  tint(color, ...bodies) {
    const own = rgb(color);
    return bodies.includes(this.picked) ? own.map((x, k) => 0.35 * x + 0.65 * PICKED[k]) : own;
  }

  placePart(part, data, i) {
    const A = this.motion.orientation(part.body), m = part.axes;
    for (let column = 0; column < 9; column += 3) {
      for (let k = 0; k < 3; k++) {
        data[i + column + k] = A[k] * m[column] + A[3 + k] * m[column + 1] + A[6 + k] * m[column + 2];
      }
    }
    data.set(this.motion.point(part.body, part.at), i + 9);
    data.set(this.tint(part.color, part.body), i + 12);
  }

  placeLink(link, data, i) {
    const a = this.motion.point(link.a, link.at_a), b = this.motion.point(link.b, link.at_b);
    data.set([...stretched(a, b, link.radius), ...scaled(add(a, b), 0.5), ...this.tint(link.color)], i);
  }

  /** Four sides from every point of the bent axis to the next; the first and the last piece once more, closed. */
  placeBar(bar) {
    const points = bar.x.map((_, k) => this.motion.point(bar.body, bent(bar, k, this.motion.p, this.scale)));
    const z = this.motion.orientation(bar.body).slice(6), tint = this.tint(bar.color, bar.body);
    for (let k = 0; k + 1 < points.length; k++) {
      const along = add(points[k + 1], points[k], -1);
      const up = scaled(unit(cross(z, along)), bar.height);
      const middle = scaled(add(points[k], points[k + 1]), 0.5);
      bar.item.data.set([...along, ...up, ...scaled(z, bar.width), ...middle, ...tint], INSTANCE * k);
    }
    const data = bar.item.data;
    bar.ends.data.set([...data.slice(0, INSTANCE), ...data.slice(-INSTANCE)]);
  }

  placeSkin({ bodies, at, item, color, field }) {
    const rows = bodies.length, columns = bodies[0].length, data = item.data;
    for (let i = 0; i < rows; i++) {
      for (let j = 0; j < columns; j++) {
        data.set(this.motion.point(bodies[i][j], at), VERTEX * (i * columns + j));
      }
    }
    const difference = (a, b) => [0, 1, 2].map((k) => data[VERTEX * b + k] - data[VERTEX * a + k]);
    const plain = rgb(color);
    for (let i = 0; i < rows; i++) {
      for (let j = 0; j < columns; j++) {
        const [above, below] = [Math.max(i - 1, 0), Math.min(i + 1, rows - 1)].map((k) => k * columns + j);
        const [left, right] = [Math.max(j - 1, 0), Math.min(j + 1, columns - 1)].map((k) => i * columns + k);
        data.set(cross(difference(above, below), difference(left, right)), VERTEX * (i * columns + j) + 3);
        const cell = Math.max(i - 1, 0) * (columns - 1) + Math.min(j, columns - 2);
        data.set(field ? this.shade(field, cell, plain) : plain, VERTEX * (i * columns + j) + 6);
      }
    }
  }

  /** The color of a cell by its field; `otherwise` where that has no value. */
  shade({ columns, limit }, cell, otherwise) {
    const value = this.motion.value(columns[cell]);
    return Number.isFinite(value) ? between(this.stops, value / (limit || 1)) : otherwise;
  }

  draw(mesh) {
    const renderer = this.renderer;
    [...this.groups, ...this.bars].forEach(({ item }) => renderer.drawSolids(item));
    this.bars.forEach(({ ends }) => renderer.drawSolids(ends));
    this.skins.forEach((skin) => renderer.drawSkin(skin.item, mesh));
  }

  /** What is translucent: after all that is to be seen through it. */
  drawGlass() {
    this.glasses.forEach(({ item, opacity }) => this.renderer.glass(item, opacity));
  }
}
