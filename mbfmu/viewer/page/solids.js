/* The unit solids every part and link is made from. Each is {positions, normals, indices}. */

/** A grid of points over (u, v) in [0, 1] x [0, 1], closed by triangles; `point` returns [position, normal]. */
function patch(rows, columns, point) {
  const positions = [], normals = [], indices = [];
  for (let i = 0; i <= rows; i++) {
    for (let j = 0; j <= columns; j++) {
      const [position, normal] = point(i / rows, j / columns);
      positions.push(...position);
      normals.push(...normal);
      if (i < rows && j < columns) {
        const a = i * (columns + 1) + j, b = a + columns + 1;
        indices.push(a, b, a + 1, a + 1, b, b + 1);
      }
    }
  }
  return { positions, normals, indices };
}

/** Several meshes as one. */
function together(...meshes) {
  const all = { positions: [], normals: [], indices: [] };
  for (const mesh of meshes) {
    const first = all.positions.length / 3;
    all.positions.push(...mesh.positions);
    all.normals.push(...mesh.normals);
    all.indices.push(...mesh.indices.map((i) => first + i));
  }
  return all;
}

const TURN = 2 * Math.PI;

/** Radius 1. */
function sphere() {
  return patch(16, 24, (u, v) => {
    const wide = Math.sin(Math.PI * u);
    const n = [wide * Math.cos(TURN * v), wide * Math.sin(TURN * v), Math.cos(Math.PI * u)];
    return [n, n];
  });
}

/** Radius 1, length 1 along z. */
function cylinder() {
  const round = (v) => [Math.cos(TURN * v), Math.sin(TURN * v)];
  const side = patch(1, 24, (u, v) => [[...round(v), 0.5 - u], [...round(v), 0]]);
  const cap = (z) => patch(1, 24, (u, v) => [[...round(v).map((x) => u * x), z], [0, 0, Math.sign(z)]]);
  return together(side, cap(0.5), cap(-0.5));
}

/** Radius 1 at the foot, length 1 along z, the tip above. */
function cone() {
  const round = (v) => [Math.cos(TURN * v), Math.sin(TURN * v)];
  const side = patch(1, 24, (u, v) => [[...round(v).map((x) => u * x), 0.5 - u], unit([...round(v), 1])]);
  const foot = patch(1, 24, (u, v) => [[...round(v).map((x) => u * x), -0.5], [0, 0, -1]]);
  return together(side, foot);
}

/** Edges of length 1; with the faces across these axes. */
function box(axes = [0, 1, 2]) {
  const faces = [];
  for (const axis of axes) {
    for (const side of [-1, 1]) {
      const place = (a, b, c) => {
        const p = [0, 0, 0];
        p[axis] = c;
        p[(axis + 1) % 3] = a;
        p[(axis + 2) % 3] = b;
        return p;
      };
      faces.push(patch(1, 1, (u, v) => [place(u - 0.5, v - 0.5, 0.5 * side), place(0, 0, side)]));
    }
  }
  return together(...faces);
}

/** Edges of length 1 across z, seen from both sides. */
function panel() {
  return patch(1, 1, (u, v) => [[u - 0.5, v - 0.5, 0], [0, 0, 1]]);
}

const WIRE = 0.16; // thickness of a coil's wire against the coil's radius

/** The middle of the wire of a coil of radius 1 along z, length 1, that ends in the axis; drawn with `WIRE`. */
function coil() {
  const turns = 8, lead = 0.08;
  return patch(24 * turns, 8, (u, v) => {
    const inside = Math.min(Math.max((u - lead) / (1 - 2 * lead), 0), 1);
    const reach = Math.min(1, Math.min(u, 1 - u) / lead);
    const a = TURN * turns * inside, out = [Math.cos(a), Math.sin(a), 0];
    const n = add(scaled(out, Math.cos(TURN * v)), [0, 0, 1], Math.sin(TURN * v));
    return [[reach * out[0], reach * out[1], u - 0.5], n];
  });
}

const SOLIDS = { sphere, cylinder, box, panel, coil };

/** Triangles between points, each with its own normal. */
function facets({ points, triangles }) {
  const positions = [], normals = [];
  for (let k = 0; k < triangles.length; k += 3) {
    const corners = [0, 1, 2].map((i) => points.slice(3 * triangles[k + i], 3 * triangles[k + i] + 3));
    const normal = cross(add(corners[1], corners[0], -1), add(corners[2], corners[0], -1));
    const n = Math.hypot(...normal) > 0 ? unit(normal) : [0, 0, 1];
    positions.push(...corners.flat());
    normals.push(...n, ...n, ...n);
  }
  return { positions, normals, indices: triangles.map((_, k) => k) };
}
