/* Which body a ray meets first: rays against the solids as they are placed. */

/** Coefficients of a point in the axes x, y, z (columns), which need not be orthogonal; null: they are flat. */
function coefficients([x, y, z], p) {
  const volume = dot(x, cross(y, z));
  return volume === 0 ? null : [dot(p, cross(y, z)), dot(p, cross(z, x)), dot(p, cross(x, y))].map((c) => c / volume);
}

/** The interval of s in which lo <= e + s d <= hi; null: none. */
function slab(e, d, low, high) {
  if (d === 0) {
    return e >= low && e <= high ? [-Infinity, Infinity] : null;
  }
  const [a, b] = [(low - e) / d, (high - e) / d];
  return a < b ? [a, b] : [b, a];
}

/** The interval of s in which e + s d lies within 1 of the origin, in as many dimensions as they have; null: none. */
function round(e, d) {
  const sum = (a, b) => a.reduce((total, x, k) => total + x * b[k], 0);
  const [dd, de, ee] = [sum(d, d), sum(d, e), sum(e, e) - 1];
  const root = de * de - dd * ee;
  if (dd === 0) {
    return ee <= 0 ? [-Infinity, Infinity] : null;
  }
  return root < 0 ? null : [(-de - Math.sqrt(root)) / dd, (-de + Math.sqrt(root)) / dd];
}

const cylindrical = (e, d) => [round(e.slice(0, 2), d.slice(0, 2)), slab(e[2], d[2], -0.5, 0.5)];
const boxed = (e, d) => [0, 1, 2].map((k) => slab(e[k], d[k], -0.5, 0.5));
const INSIDE = {
  sphere: (e, d) => [round(e, d)],
  cylinder: cylindrical,
  coil: cylindrical,
  box: boxed,
  panel: boxed,
};

/** How far along a ray, in lengths of `direction`, a placed solid is met; Infinity: it is not. */
function distanceTo(solid, data, i, eye, direction) {
  const axes = [0, 3, 6].map((k) => [...data.subarray(i + k, i + k + 3)]);
  const e = coefficients(axes, add(eye, data.subarray(i + 9, i + 12), -1));
  const intervals = e ? (INSIDE[solid] || boxed)(e, coefficients(axes, direction)) : [null];
  if (intervals.includes(null)) {
    return Infinity;
  }
  const enter = Math.max(...intervals.map(([a]) => a)), leave = Math.min(...intervals.map(([, b]) => b));
  return enter <= leave && leave > 0 ? Math.max(enter, 0) : Infinity;
}

/** How far along a ray the triangle a, b, c is met, and the nearest of its corners; null: it is not. */
function meets([a, b, c], eye, direction) {
  const [u, v] = [add(b, a, -1), add(c, a, -1)];
  const found = coefficients([u, v, scaled(direction, -1)], add(eye, a, -1));
  if (!found || found[0] < 0 || found[1] < 0 || found[0] + found[1] > 1 || found[2] < 0) {
    return null;
  }
  const weights = [1 - found[0] - found[1], found[0], found[1]];
  return [found[2], weights.indexOf(Math.max(...weights))];
}

/** The body of a figure that a ray from `eye` meets first, through glass; null: none. A link is of that it starts from. */
function picked(figure, eye, direction) {
  let nearest = Infinity, body = null;
  const meet = (distance, owner) => {
    if (distance < nearest) {
      [nearest, body] = [distance, owner];
    }
  };
  for (const { solid, parts, links, item } of figure.groups) {
    [...parts.map((part) => part.body), ...links.map((link) => link.a)].forEach((owner, k) => {
      meet(distanceTo(solid, item.data, INSTANCE * k, eye, direction), owner);
    });
  }
  for (const { body: owner, item } of figure.bars) {
    for (let k = 0; k < item.count; k++) {
      meet(distanceTo("box", item.data, INSTANCE * k, eye, direction), owner);
    }
  }
  for (const { bodies, item } of figure.skins) {
    const point = (i, j) => [...item.data.subarray(VERTEX * (i * bodies[0].length + j)).subarray(0, 3)];
    for (let i = 0; i + 1 < bodies.length; i++) {
      for (let j = 0; j + 1 < bodies[0].length; j++) {
        for (const corners of [[[i, j], [i + 1, j], [i, j + 1]], [[i, j + 1], [i + 1, j], [i + 1, j + 1]]]) {
          const found = meets(corners.map(([a, b]) => point(a, b)), eye, direction);
          if (found) {
            const [a, b] = corners[found[1]];
            meet(found[0], bodies[a][b]);
          }
        }
      }
    }
  }
  return body;
}

/** What is told of a body at a time: rows of a word and what it says. */
function told(scene, motion, body, time) {
  const at = scene.picture.middles[body], place = motion.point(body, at);
  const speed = Math.hypot(...motion.velocity(body, at, time));
  return [
    ["body", scene.bodies[body]],
    ["joint", body > 0 ? `${scene.joints[body]}, on ${scene.bodies[scene.parents[body]]}` : "none"],
    ["position", `${place.map((x) => figures(x)).join(", ")} m`],
    ["speed", `${figures(speed)} m/s`],
  ];
}
