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

/** The sum of rows of numbers, each times its factor. */
function weighted(rows, factors) {
  const found = new Float64Array(rows[0].length);
  rows.forEach((row, k) => row.forEach((x, i) => (found[i] += factors[k] * x)));
  return found;
}

/** The lengths of vectors, three numbers each. */
function lengths(vectors) {
  return Array.from({ length: vectors.length / 3 }, (_, k) => Math.hypot(...vectors.subarray(3 * k, 3 * k + 3)));
}

/** The equivalent stresses of von Mises of stresses xx, yy, zz, xy, xz, yz. */
function equivalent(stresses) {
  return Array.from({ length: stresses.length / 6 }, (_, k) => {
    const [xx, yy, zz, xy, xz, yz] = stresses.subarray(6 * k, 6 * k + 6);
    const normal = 0.5 * ((xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2);
    return Math.sqrt(normal + 3 * (xy * xy + xz * xz + yz * yz));
  });
}

class Figure {
  constructor(renderer, { picture, fields, hull_fields }, motion, scale, stops) {
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
    this.hulls = (picture.hulls || []).map((hull, k) => {
      const item = renderer.surface(hull.points.length / 3, hull.triangles, [], 0, "hull");
      return { ...hull, field: hull_fields[k], item };
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
    for (const hull of this.hulls) {
      this.placeHull(hull);
      this.renderer.update(hull.item);
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

  /** The points of a hull, displaced; normals that are the sums over their triangles; colors of stress or displacement. */
  placeHull(hull) {
    const { body, points, triangles, shapes, stresses, field, item, first } = hull, data = item.data;
    const p = this.motion.p.subarray(first, first + shapes.length), moved = weighted(shapes, p);
    const sizes = stresses.length > 0 ? equivalent(weighted(stresses, p)) : lengths(moved);
    for (let k = 0; 3 * k < points.length; k++) {
      const at = [0, 1, 2].map((i) => points[3 * k + i] + this.scale * moved[3 * k + i]);
      data.set(this.motion.point(body, at), VERTEX * k);
      data.fill(0, VERTEX * k + 3, VERTEX * k + 6);
      const tint = between(this.stops, sizes[k] / (field.limit || 1));
      data.set(body === this.picked ? tint.map((x, i) => 0.35 * x + 0.65 * PICKED[i]) : tint, VERTEX * k + 6);
    }
    const difference = (a, b) => [0, 1, 2].map((i) => data[VERTEX * b + i] - data[VERTEX * a + i]);
    for (let k = 0; k < triangles.length; k += 3) {
      const [a, b, c] = triangles.slice(k, k + 3), normal = cross(difference(a, b), difference(a, c));
      for (const corner of [a, b, c]) {
        normal.forEach((x, i) => (data[VERTEX * corner + 3 + i] += x));
      }
    }
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
    [...this.skins, ...this.hulls].forEach(({ item }) => renderer.drawSkin(item, mesh));
  }

  /** What is translucent: after all that is to be seen through it. */
  drawGlass() {
    this.glasses.forEach(({ item, opacity }) => this.renderer.glass(item, opacity));
  }
}
