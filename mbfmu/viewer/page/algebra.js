/* Vectors and 4x4 matrices; a matrix is 16 numbers, column after column, as WebGL takes it. */

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const add = (a, b, scale = 1) => [a[0] + scale * b[0], a[1] + scale * b[1], a[2] + scale * b[2]];
const scaled = (a, s) => [a[0] * s, a[1] * s, a[2] * s];
const unit = (a) => scaled(a, 1 / Math.hypot(...a));

/** Sum of the vectors `axes` weighted with the numbers `along`. */
const combined = (axes, along) =>
  axes.reduce((sum, axis, k) => add(sum, axis, along[k]), [0, 0, 0]);

/** Product of two matrices. */
function product(a, b) {
  const out = new Float32Array(16);
  for (let column = 0; column < 4; column++) {
    for (let row = 0; row < 4; row++) {
      for (let k = 0; k < 4; k++) {
        out[4 * column + row] += a[4 * k + row] * b[4 * column + k];
      }
    }
  }
  return out;
}

/** Homogeneous coordinates of a point. */
function transformed(m, p) {
  return [0, 1, 2, 3].map((row) => m[row] * p[0] + m[4 + row] * p[1] + m[8 + row] * p[2] + m[12 + row]);
}

/** Perspective with a vertical field of view (rad). */
function perspective(field, aspect, near, far) {
  const f = 1 / Math.tan(field / 2);
  const depth = near - far;
  return new Float32Array([
    f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (near + far) / depth, -1, 0, 0, (2 * near * far) / depth, 0,
  ]);
}

/** View of a camera at `eye` with the axes right, up and back. */
function view(eye, right, up, back) {
  return new Float32Array([
    right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2], 0,
    -dot(right, eye), -dot(up, eye), -dot(back, eye), 1,
  ]);
}

/** Columns of the rotation matrix of the unit quaternion (w, x, y, z) that starts at `e[i]`, into `out`. */
function rotation(e, i, out) {
  const w = e[i], x = e[i + 1], y = e[i + 2], z = e[i + 3];
  out[0] = 1 - 2 * (y * y + z * z);
  out[1] = 2 * (x * y + w * z);
  out[2] = 2 * (x * z - w * y);
  out[3] = 2 * (x * y - w * z);
  out[4] = 1 - 2 * (x * x + z * z);
  out[5] = 2 * (y * z + w * x);
  out[6] = 2 * (x * z + w * y);
  out[7] = 2 * (y * z - w * x);
  out[8] = 1 - 2 * (x * x + y * y);
  return out;
}

/** Red, green and blue from 0 to 1 of "#rrggbb". */
const rgb = (text) => [1, 3, 5].map((i) => parseInt(text.slice(i, i + 2), 16) / 255);

/** A number with so many figures and no more zeros than it needs. */
function figures(x, count = 4) {
  const size = Math.abs(x), text = String(Number(x.toPrecision(count)));
  return size > 0 && (size >= 1e5 || size < 1e-4) ? Number(x.toPrecision(count)).toExponential() : text;
}
