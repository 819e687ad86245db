/* The recorded motion: reads the embedded numbers and places every body between two recorded frames. */

/** Bytes of an embedded base64 block as an array of the given type. */
function embedded(id, Type) {
  const text = atob(document.getElementById(id).textContent.trim());
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) {
    bytes[i] = text.charCodeAt(i);
  }
  return new Type(bytes.buffer);
}

class Motion {
  /** `turning`: numbers of the bodies whose orientation is recorded, in the order of their quaternions. */
  constructor(bodies, turning) {
    this.times = embedded("times", Float64Array);
    this.positions = embedded("positions", Float32Array);
    this.quaternions = embedded("quaternions", Float32Array);
    this.amplitudes = embedded("amplitudes", Float32Array);
    this.bodies = bodies;
    this.slots = new Map(turning.map((body, k) => [body, k]));
    this.r = new Float32Array(3 * bodies);
    this.e = new Float32Array(4 * turning.length);
    this.p = new Float32Array(this.amplitudes.length / this.times.length);
    this.A = new Float32Array(9);
  }

  get start() {
    return this.times[0];
  }

  get end() {
    return this.times[this.times.length - 1];
  }

  /** Time between frames, on average. */
  get interval() {
    return (this.end - this.start) / (this.times.length - 1) || 1;
  }

  /** Number of the last recorded frame not after a time. */
  frame(time) {
    let low = 0, high = this.times.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (this.times[middle] <= time) {
        low = middle;
      } else {
        high = middle - 1;
      }
    }
    return low;
  }

  /** Place every body at a time. */
  place(time) {
    const k = this.frame(time), next = Math.min(k + 1, this.times.length - 1);
    const span = this.times[next] - this.times[k];
    const s = span > 0 ? (time - this.times[k]) / span : 0;
    this.between(this.positions, this.r, k, next, s);
    this.between(this.quaternions, this.e, k, next, s, 4);
    this.between(this.amplitudes, this.p, k, next, s);
  }

  /** Mix two frames into `out`; quaternions (`width` 4) go the short way and keep unit length. */
  between(values, out, k, next, s, width = 1) {
    const a = k * out.length, b = next * out.length;
    for (let i = 0; i < out.length; i += width) {
      let product = 0;
      for (let j = i; j < i + width; j++) {
        product += values[a + j] * values[b + j];
      }
      const t = width === 4 && product < 0 ? -s : s;
      let square = 0;
      for (let j = i; j < i + width; j++) {
        out[j] = (1 - s) * values[a + j] + t * values[b + j];
        square += out[j] * out[j];
      }
      for (let j = i; width === 4 && j < i + width; j++) {
        out[j] /= Math.sqrt(square);
      }
    }
  }

  /** Rotation matrix (columns) of a body as placed; the same array every time. */
  orientation(body) {
    const slot = this.slots.get(body);
    return slot === undefined ? IDENTITY : rotation(this.e, 4 * slot, this.A);
  }

  /** Global position of a point of a body as placed. */
  point(body, at) {
    const A = this.orientation(body), i = 3 * body;
    return [0, 1, 2].map((k) => this.r[i + k] + A[k] * at[0] + A[3 + k] * at[1] + A[6 + k] * at[2]);
  }
}

/** Point k of a bar's axis in its frame, with these amplitudes; the deflection, not the shortening, times `scale`. */
function bent({ first, x, shapes, shortenings }, k, p, scale) {
  const phi = shapes[k], G = shortenings[k];
  let w = 0, s = 0;
  for (let i = 0; i < phi.length; i++) {
    w += phi[i] * p[first + i];
    for (let j = 0; G && j < phi.length; j++) {
      s += 0.5 * p[first + i] * G[i][j] * p[first + j];
    }
  }
  return [x[k] - s, scale * w, 0];
}

const IDENTITY = new Float32Array([1, 0, 0, 0, 1, 0, 0, 0, 1]);
