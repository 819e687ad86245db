/* Draws solids, skins and lines with WebGL 2. Knows nothing of mechanisms. */

const SHADING = `
vec3 lit(vec3 color, vec3 normal, vec3 eye, vec3 point) {
  vec3 n = normalize(normal), v = normalize(eye - point);
  float key = max(dot(n, light), 0.0);
  float sky = 0.5 + 0.5 * dot(n, up);
  float glint = pow(max(dot(n, normalize(light + v)), 0.0), 48.0);
  float front = max(dot(n, v), 0.0);
  float rim = pow(1.0 - front, 3.0);
  return color * (0.34 + 0.22 * sky + 0.42 * key + 0.14 * front) + vec3(0.22) * glint + vec3(0.07) * rim;
}`;

const UNIFORMS = `#version 300 es
precision highp float;
uniform mat4 camera;
uniform vec3 eye, light, up;
uniform float floorHeight;
uniform vec4 shade;  // color of a shadow; alpha 0: no shadow is being drawn
vec3 fallen(vec3 p) { return shade.a > 0.0 ? p - light * ((dot(p, up) - floorHeight) / dot(light, up)) : p; }
`;

/* Solids: one instance is the columns of a 3x3 matrix, an origin and a color. */
const SOLID = [
  `${UNIFORMS}
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
layout(location = 2) in vec3 x;
layout(location = 3) in vec3 y;
layout(location = 4) in vec3 z;
layout(location = 5) in vec3 origin;
layout(location = 6) in vec3 color;
uniform float wire;  // thickness of a wire whose middle the positions are, against the length of x; 0: none
out vec3 point, facing, tint;
void main() {
  vec3 solid = mat3(cross(y, z), cross(z, x), cross(x, y)) * normal;
  vec3 turned = mat3(normalize(x), normalize(y), normalize(z)) * normal;
  facing = wire > 0.0 ? turned : solid;
  point = fallen(mat3(x, y, z) * position + origin + (wire > 0.0 ? wire * length(x) * turned : vec3(0.0)));
  tint = color;
  gl_Position = camera * vec4(point, 1.0);
}`,
  `${UNIFORMS}${SHADING}
in vec3 point, facing, tint;
out vec4 pixel;
uniform float opacity;
void main() {
  vec3 seen = dot(facing, eye - point) < 0.0 ? -facing : facing;  // of a panel, or through glass, the back
  pixel = shade.a > 0.0 ? shade : vec4(lit(tint, seen, eye, point), opacity);
}`,
];

/* A skin: light shines through it, and its back is paler; each cell has the color of its last corner. */
const SKIN = [
  `${UNIFORMS}
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
layout(location = 2) in vec3 color;
out vec3 point, facing;
flat out vec3 own;
void main() {
  point = fallen(position);
  facing = normal;
  own = color;
  gl_Position = camera * vec4(point, 1.0);
}`,
  `${UNIFORMS}${SHADING}
uniform float mesh, opacity, pale;
in vec3 point, facing;
flat in vec3 own;
out vec4 pixel;
void main() {
  bool front = dot(facing, eye - point) > 0.0;
  vec3 tint = front ? own : mix(own, vec3(0.9), pale);
  vec3 n = front ? facing : -facing;
  vec3 seen = mix(lit(tint, n, eye, point), lit(tint, -n, eye, point), 0.25);
  pixel = shade.a > 0.0 ? shade : mesh > 0.0 ? vec4(0.5 * seen, 0.4 * opacity) : vec4(seen, opacity);
}`,
];

/* Line segments of a width in pixels; ends of a segment follow one another in the buffer. */
const LINE = [
  `${UNIFORMS}
layout(location = 0) in vec2 corner;
layout(location = 1) in vec3 from;
layout(location = 2) in vec3 to;
uniform vec2 size;
uniform float width, reached;
out vec3 point;
out float strength;
void main() {
  vec4 a = camera * vec4(from, 1.0), b = camera * vec4(to, 1.0);
  float behind = 1e-3;
  if (a.w < behind && b.w > behind) { a = mix(a, b, (behind - a.w) / (b.w - a.w)); }
  if (b.w < behind && a.w > behind) { b = mix(b, a, (behind - b.w) / (a.w - b.w)); }
  vec2 along = (b.xy / b.w - a.xy / a.w) * size;
  vec2 side = length(along) > 0.0 ? normalize(vec2(-along.y, along.x)) : vec2(0.0);
  vec4 end = mix(a, b, corner.x);
  gl_Position = end + vec4(side * corner.y * width / size * end.w, 0.0, 0.0);
  point = mix(from, to, corner.x);
  strength = float(gl_InstanceID) < reached ? 1.0 : 0.3;
}`,
  `${UNIFORMS}
uniform vec4 color;
uniform vec4 fade;  // center, and the distance from it at which lines have vanished; 0: nowhere
in vec3 point;
in float strength;
out vec4 pixel;
void main() {
  float near = fade.w > 0.0 ? 1.0 - smoothstep(0.45 * fade.w, fade.w, distance(point, fade.xyz)) : 1.0;
  pixel = vec4(color.rgb, color.a * strength * near);
}`,
];

const INSTANCE = 15; // numbers an instance of a solid has
/* A hull: as a skin, with colors between those of the corners. */
const HULL = SKIN.map((source) => source.replaceAll("flat ", ""));

const VERTEX = 9; // numbers a point of a skin has

class Renderer {
  constructor(canvas) {
    this.canvas = canvas;
    this.gl = canvas.getContext("webgl2", { alpha: false, antialias: true, stencil: true });
    if (!this.gl) {
      throw new Error("The animation needs WebGL 2, which this browser does not support. Use a current browser.");
    }
    this.programs = { solid: this.program(SOLID), skin: this.program(SKIN), hull: this.program(HULL), line: this.program(LINE) };
    this.corners = this.buffer(new Float32Array([0, -1, 1, -1, 0, 1, 1, 1]));
    const gl = this.gl;
    gl.enable(gl.DEPTH_TEST);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
  }

  program(sources) {
    const gl = this.gl, program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, sources[0]], [gl.FRAGMENT_SHADER, sources[1]]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) {
      const shaders = gl.getAttachedShaders(program).map((shader) => gl.getShaderInfoLog(shader));
      throw new Error(`A shader does not compile: ${shaders.join(" ")} ${gl.getProgramInfoLog(program)}`);
    }
    const uniforms = {};
    for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
      const { name } = gl.getActiveUniform(program, i);
      uniforms[name] = gl.getUniformLocation(program, name);
    }
    return { program, uniforms };
  }

  buffer(data, target = this.gl.ARRAY_BUFFER, usage = this.gl.STATIC_DRAW) {
    const buffer = this.gl.createBuffer();
    this.gl.bindBuffer(target, buffer);
    this.gl.bufferData(target, data, usage);
    return buffer;
  }

  attribute(location, buffer, size, stride, offset, divisor = 0) {
    const gl = this.gl;
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.enableVertexAttribArray(location);
    gl.vertexAttribPointer(location, size, gl.FLOAT, false, 4 * stride, 4 * offset);
    gl.vertexAttribDivisor(location, divisor);
  }

  /** `count` instances of a mesh, with a wire of this thickness; fill `data` and call `update`. */
  solids(mesh, count, wire) {
    const gl = this.gl, array = gl.createVertexArray(), data = new Float32Array(INSTANCE * count);
    gl.bindVertexArray(array);
    this.attribute(0, this.buffer(new Float32Array(mesh.positions)), 3, 3, 0);
    this.attribute(1, this.buffer(new Float32Array(mesh.normals)), 3, 3, 0);
    const buffer = this.buffer(data, gl.ARRAY_BUFFER, gl.DYNAMIC_DRAW);
    for (let k = 0; k < 5; k++) {
      this.attribute(2 + k, buffer, 3, INSTANCE, 3 * k, 1);
    }
    this.buffer(new Uint16Array(mesh.indices), gl.ELEMENT_ARRAY_BUFFER);
    gl.bindVertexArray(null);
    return { array, buffer, data, count, wire, indices: mesh.indices.length };
  }

  /**
   * A grid of rows x columns points whose back is so much paler; fill `data` with position, normal and color of each and
   * call `update`. The color at row i + 1, column j is that of the cell beyond (i, j).
   */
  skin(rows, columns, pale) {
    const faces = [], edges = [];
    for (let i = 0; i < rows; i++) {
      for (let j = 0; j < columns; j++) {
        const a = i * columns + j;
        if (i + 1 < rows && j + 1 < columns) {
          faces.push(a + 1, a, a + columns, a + columns + 1, a + 1, a + columns);
        }
        if (i + 1 < rows) {
          edges.push(a, a + columns);
        }
        if (j + 1 < columns) {
          edges.push(a, a + 1);
        }
      }
    }
    return this.surface(rows * columns, faces, edges, pale, "skin");
  }

  /** Triangles and lines between points, drawn by a program; `data` as for `skin`. */
  surface(count, faces, edges, pale, program) {
    const gl = this.gl, data = new Float32Array(VERTEX * count), array = gl.createVertexArray();
    gl.bindVertexArray(array);
    const buffer = this.buffer(data, gl.ARRAY_BUFFER, gl.DYNAMIC_DRAW);
    for (let k = 0; k < 3; k++) {
      this.attribute(k, buffer, 3, VERTEX, 3 * k);
    }
    gl.bindVertexArray(null);
    const index = (numbers) => this.buffer(new Uint32Array(numbers), gl.ELEMENT_ARRAY_BUFFER);
    return {
      array, buffer, data, pale, program,
      faces: index(faces), faceCount: faces.length, edges: index(edges), edgeCount: edges.length,
    };
  }

  update(item) {
    this.gl.bindBuffer(this.gl.ARRAY_BUFFER, item.buffer);
    this.gl.bufferSubData(this.gl.ARRAY_BUFFER, 0, item.data);
  }

  /** Lines through points (x, y, z, ...): a path, or pairs of points where `pairs`. */
  lines(points, pairs) {
    const gl = this.gl, array = gl.createVertexArray(), stride = pairs ? 6 : 3;
    gl.bindVertexArray(array);
    this.attribute(0, this.corners, 2, 2, 0);
    const buffer = this.buffer(new Float32Array(points));
    this.attribute(1, buffer, 3, stride, 0, 1);
    this.attribute(2, buffer, 3, stride, 3, 1);
    gl.bindVertexArray(null);
    return { array, buffer, count: pairs ? points.length / 6 : points.length / 3 - 1 };
  }

  discard(item) {
    this.gl.deleteVertexArray(item.array);
    this.gl.deleteBuffer(item.buffer);
  }

  /** Fit the drawing to the size of the canvas on the page; returns its width to height. */
  resize() {
    const scale = window.devicePixelRatio || 1;
    const width = Math.max(1, Math.round(this.canvas.clientWidth * scale));
    const height = Math.max(1, Math.round(this.canvas.clientHeight * scale));
    if (this.canvas.width !== width || this.canvas.height !== height) {
      this.canvas.width = width;
      this.canvas.height = height;
    }
    return width / height;
  }

  /** Begin a picture: `world` has camera (matrix), eye, light, up, floorHeight. */
  begin(world, background) {
    const gl = this.gl;
    this.viewport(0, 0, this.canvas.width, this.canvas.height);
    gl.clearColor(...background, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT | gl.STENCIL_BUFFER_BIT);
    this.world = world;
    this.shade = [0, 0, 0, 0];
    this.opacity = 1;
  }

  /** Draw into this part of the canvas from now on. */
  viewport(left, bottom, width, height) {
    this.gl.viewport(left, bottom, width, height);
    this.size = [width, height];
  }

  use(name) {
    const gl = this.gl, { program, uniforms } = this.programs[name];
    gl.useProgram(program);
    gl.uniformMatrix4fv(uniforms.camera, false, this.world.matrix);
    for (const key of ["eye", "light", "up"]) {
      if (uniforms[key]) {
        gl.uniform3fv(uniforms[key], this.world[key]);
      }
    }
    if (uniforms.floorHeight) {
      gl.uniform1f(uniforms.floorHeight, this.world.floorHeight);
    }
    if (uniforms.opacity) {
      gl.uniform1f(uniforms.opacity, this.opacity);
    }
    if (uniforms.shade) {
      gl.uniform4fv(uniforms.shade, this.shade);
    }
    return uniforms;
  }

  drawSolids(item) {
    const gl = this.gl, uniforms = this.use("solid");
    gl.uniform1f(uniforms.wire, item.wire);
    gl.bindVertexArray(item.array);
    gl.drawElementsInstanced(gl.TRIANGLES, item.indices, gl.UNSIGNED_SHORT, 0, item.count);
  }

  drawSkin(item, mesh) {
    const gl = this.gl, uniforms = this.use(item.program);
    gl.uniform1f(uniforms.pale, item.pale);
    gl.uniform1f(uniforms.mesh, 0);
    gl.bindVertexArray(item.array);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, item.faces);
    gl.enable(gl.POLYGON_OFFSET_FILL);
    gl.polygonOffset(1, 1);
    gl.drawElements(gl.TRIANGLES, item.faceCount, gl.UNSIGNED_INT, 0);
    gl.disable(gl.POLYGON_OFFSET_FILL);
    if (mesh) {
      const blended = gl.isEnabled(gl.BLEND);
      gl.enable(gl.BLEND);
      gl.uniform1f(uniforms.mesh, 1);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, item.edges);
      gl.drawElements(gl.LINES, item.edgeCount, gl.UNSIGNED_INT, 0);
      if (!blended) {
        gl.disable(gl.BLEND);
      }
    }
  }

  /** Draw lines `width` pixels wide; those from number `reached` on faintly. */
  drawLines(item, color, width, { fade = [0, 0, 0, 0], reached = Infinity } = {}) {
    const gl = this.gl, uniforms = this.use("line"), scale = window.devicePixelRatio || 1;
    gl.uniform4fv(uniforms.color, color);
    gl.uniform4fv(uniforms.fade, fade);
    gl.uniform2fv(uniforms.size, this.size);
    gl.uniform1f(uniforms.width, width * scale);
    gl.uniform1f(uniforms.reached, Math.min(reached, 1e9));
    gl.bindVertexArray(item.array);
    gl.enable(gl.BLEND);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, item.count);
    gl.disable(gl.BLEND);
  }

  /** Let what `draw` draws shine through, but not what is hidden by itself: its depths come first. */
  translucent(opacity, draw) {
    const gl = this.gl;
    gl.colorMask(false, false, false, false);
    draw();
    gl.colorMask(true, true, true, true);
    this.opacity = opacity;
    gl.enable(gl.BLEND);
    gl.depthFunc(gl.LEQUAL);
    draw();
    gl.depthFunc(gl.LESS);
    gl.disable(gl.BLEND);
    this.opacity = 1;
  }

  /** Draw all of some solids, front and back, over what is there, and hide nothing by them. */
  glass(item, opacity) {
    const gl = this.gl;
    this.opacity = opacity;
    gl.enable(gl.BLEND);
    gl.depthMask(false);
    this.drawSolids(item);
    gl.depthMask(true);
    gl.disable(gl.BLEND);
    this.opacity = 1;
  }

  /** Draw the shadows that `draw` casts on the floor, everywhere equally dark. */
  shadows(shade, draw) {
    const gl = this.gl;
    this.shade = shade;
    gl.enable(gl.STENCIL_TEST);
    gl.stencilFunc(gl.EQUAL, 0, 0xff);
    gl.stencilOp(gl.KEEP, gl.KEEP, gl.INCR);
    gl.enable(gl.BLEND);
    gl.depthMask(false);
    draw();
    gl.depthMask(true);
    gl.disable(gl.BLEND);
    gl.disable(gl.STENCIL_TEST);
    this.shade = [0, 0, 0, 0];
  }
}
