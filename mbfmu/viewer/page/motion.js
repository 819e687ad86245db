/* The recorded motion: unpacks the embedded numbers and places every body between two recorded frames. */

/**
 * The numbers of an embedded block as an array of the given type, frame after frame. They are packed: words of 32 bits,
 * column after column, each less the one before, their first bytes before all second ones, deflated, in base64.
 */
async function embedded(id, Type, frames) {
  const bytes = Uint8Array.from(atob(document.getElementById(id).textContent), (c) => c.charCodeAt(0));
  const whole = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const planes = new Uint8Array(await new Response(whole).arrayBuffer()), count = planes.length / 4;
  const words = new Uint32Array(count), columns = frames ? count / frames : Type.BYTES_PER_ELEMENT / 4;
  const rows = count / columns;
  for (let column = 0, i = 0; column < columns; column++) {
    for (let row = 0, word = 0; row < rows; row++, i++) {
      word += planes[i] | (planes[count + i] << 8) | (planes[2 * count + i] << 16) | (planes[3 * count + i] << 24);
      words[row * columns + column] = word |= 0;
    }
  }
  return new Type(words.buffer);
}

/** The numbers over time of the run whose blocks end in `suffix`. */
async function recorded(suffix = "") {
  const times = await embedded(`times${suffix}`, Float64Array), found = { times };
  for (const name of ["positions", "quaternions", "amplitudes", "outputs", "forces"]) {
    found[name] = await embedded(name + suffix, Float32Array, times.length);
  }
  return found;
}

/** Number of the last recorded frame not after a time. */
function frameAt(times, time) {
  let low = 0, high = times.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (times[middle] <= time) {
      low = middle;
    } else {
      high = middle - 1;
    }
  }
  return low;
}

/** Outputs with their values over time, which are embedded frame after frame, less their first. */
function columns(outputs, table) {
  const wide = outputs.length;
  return outputs.map(({ name, unit, base }, k) => {
    const values = Float64Array.from({ length: table.length / wide }, (_, i) => base + table[i * wide + k]);
    return { name, unit, values };
  });
}

class Motion {
  /** `turning`: numbers of the bodies whose orientation is recorded, in the order of their quaternions. */
  constructor({ bodies, turning, outputs, arrows }, recorded) {
    Object.assign(this, recorded);
    this.outputs = columns(outputs, recorded.outputs);
    this.slots = new Map(turning.map((body, k) => [body, k]));
    this.r = new Float32Array(3 * bodies.length);
    this.e = new Float32Array(4 * turning.length);
    this.p = new Float32Array(this.amplitudes.length / this.times.length);
    this.f = new Float32Array(3 * arrows.length);
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

  /** The frames a time lies between, and how far from the first to the second; a time outside is brought inside. */
  around(time) {
    const k = frameAt(this.times, time), next = Math.min(k + 1, this.times.length - 1);
    const span = this.times[next] - this.times[k];
    return [k, next, span > 0 ? Math.max((time - this.times[k]) / span, 0) : 0];
  }

  /** Place every body at a time. */
  place(time) {
    const [k, next, s] = (this.now = this.around(time));
    this.between(this.positions, this.r, k, next, s);
    this.between(this.quaternions, this.e, k, next, s, 4);
    this.between(this.amplitudes, this.p, k, next, s);
    this.between(this.forces, this.f, k, next, s);
  }

  /** Velocity of a point of a body: differences over the frames before and after, mixed. The bodies stay placed. */
  velocity(body, at, time) {
    const [first, second, s] = this.around(time);
    const place = (k) => {
      this.place(this.times[k]);
      return this.point(body, at);
    };
    const rate = (k) => {
      const [a, b] = [Math.max(k - 1, 0), Math.min(k + 1, this.times.length - 1)];
      const way = add(place(b), place(a), -1);
      return b > a ? scaled(way, 1 / (this.times[b] - this.times[a])) : [0, 0, 0];
    };
    const mixed = add(scaled(rate(first), 1 - s), rate(second), s);
    this.place(time);
    return mixed;
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

  /** Value of an output, by its number, at the time everything is placed at. */
  value(column) {
    const [k, next, s] = this.now, { values } = this.outputs[column];
    return (1 - s) * values[k] + s * values[next];
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
