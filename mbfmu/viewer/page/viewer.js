/* The page: time, camera and options in the hands of the reader. */

const SPEEDS = [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 1000];

const THEMES = {
  light: {
    background: rgb("#eef1f5"),
    grid: [0.3, 0.35, 0.43, 0.4],
    shadow: [0.1, 0.13, 0.2, 0.17],
    path: [0.85, 0.2, 0.3, 1],
  },
  dark: {
    background: rgb("#161a21"),
    grid: [0.65, 0.7, 0.8, 0.26],
    shadow: [0, 0, 0, 0.42],
    path: [1, 0.45, 0.5, 1],
  },
};

const element = (id) => document.getElementById(id);

class Viewer {
  constructor(scene) {
    this.scene = scene;
    this.canvas = element("view");
    this.motion = new Motion(scene.bodies.length, scene.turning);
    this.renderer = new Renderer(this.canvas);
    this.stage = new Stage(this.renderer, scene, this.motion);
    this.camera = new Camera(scene.stage);
    this.time = this.motion.start;
    this.speed = this.fittingSpeed();
    this.hovered = null;
    this.theme = matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
    this.playing = this.motion.end > this.motion.start && !matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.prepareControls();
    this.prepareLabels();
    this.preparePointer();
    this.prepareKeys();
    this.stale = true;
    new ResizeObserver(() => (this.stale = true)).observe(this.canvas);
    this.last = performance.now();
    requestAnimationFrame((now) => this.tick(now));
  }

  /** Real time, unless the motion would be over in a moment or last for minutes. */
  fittingSpeed() {
    const span = this.motion.end - this.motion.start;
    if (span >= 2 && span <= 120) {
      return 1;
    }
    return SPEEDS.findLast((speed) => span / speed >= 5) ?? SPEEDS[0];
  }

  prepareControls() {
    const { note, bodies, picture } = this.scene;
    element("note").textContent = [note, `grid ${this.stage.floor.spacing} m`].filter((text) => text).join(" · ");
    const slider = element("time");
    slider.min = this.motion.start;
    slider.max = this.motion.end;
    slider.addEventListener("input", () => {
      this.playing = false;
      this.goTo(Number(slider.value));
    });
    element("play").addEventListener("click", () => this.toggle());
    for (const speed of SPEEDS) {
      element("speed").add(new Option(`${speed}×`, speed, false, speed === this.speed));
    }
    element("speed").addEventListener("change", (event) => (this.speed = Number(event.target.value)));
    bodies.forEach((name, k) => k > 0 && element("trace").add(new Option(name, k)));
    element("trace").addEventListener("change", (event) => {
      const body = event.target.value === "" ? null : Number(event.target.value);
      this.stage.trace(body, body === null ? null : picture.middles[body]);
      this.stale = true;
    });
    element("mesh-option").hidden = picture.skins.length === 0;
    for (const name of ["grid", "shadow", "labels", "mesh"]) {
      element(`show-${name}`).addEventListener("change", () => (this.stale = true));
    }
    element("reset").addEventListener("click", () => this.reset());
    element("theme").addEventListener("click", () => this.switchTheme());
    element("save").addEventListener("click", () => this.save());
    document.documentElement.dataset.theme = this.theme;
  }

  prepareLabels() {
    const label = (text, kind) => {
      const span = document.createElement("span");
      span.textContent = text;
      span.className = kind;
      element("labels").append(span);
      return span;
    };
    const { skins, unnamed } = this.scene.picture;
    const nameless = new Set([...skins.flatMap((skin) => skin.bodies.flat()), ...unnamed]);
    this.labels = this.scene.bodies
      .map((text, k) => ({ body: k, at: this.scene.picture.middles[k], span: null, text }))
      .filter(({ body }) => body > 0 && !nameless.has(body));
    this.labels.forEach((entry) => (entry.span = label(entry.text, "")));
    this.triad = ["x", "y", "z"].map((name) => label(name, "axis"));
    const lines = [0, 1, 2].map((k) => [0, 0, 0, ...IDENTITY.slice(3 * k, 3 * k + 3)]);
    this.triadLines = lines.map((points) => this.renderer.lines(points, true));
  }

  preparePointer() {
    const pointers = new Map();
    const canvas = this.canvas;
    const middle = () => {
      const all = [...pointers.values()];
      return [0, 1].map((k) => all.reduce((sum, p) => sum + p[k], 0) / all.length);
    };
    const spread = () => {
      const [a, b] = [...pointers.values()];
      return b ? Math.hypot(a[0] - b[0], a[1] - b[1]) : 0;
    };
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, [event.clientX, event.clientY]);
    });
    canvas.addEventListener("pointermove", (event) => {
      this.stale = true;
      if (!pointers.has(event.pointerId)) {
        this.hovered = [event.clientX, event.clientY];
        return;
      }
      const before = middle(), wide = spread();
      pointers.set(event.pointerId, [event.clientX, event.clientY]);
      const [dx, dy] = middle().map((x, k) => (x - before[k]) / canvas.clientHeight);
      if (pointers.size > 1 || event.buttons & 6 || event.shiftKey) {
        this.camera.shift(dx, dy);
      } else {
        this.camera.turn(4 * dx, 4 * dy);
      }
      if (wide > 0 && spread() > 0) {
        this.camera.zoom(wide / spread());
      }
    });
    for (const name of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(name, (event) => pointers.delete(event.pointerId));
    }
    canvas.addEventListener("pointerleave", () => {
      this.hovered = null;
      this.stale = true;
    });
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("dblclick", () => this.reset());
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.camera.zoom(Math.exp(Math.min(Math.max(event.deltaY, -100), 100) * 0.0016));
      this.stale = true;
    }, { passive: false });
  }

  prepareKeys() {
    const actions = {
      " ": () => this.toggle(),
      ArrowRight: () => this.step(1),
      ArrowLeft: () => this.step(-1),
      Home: () => this.goTo(this.motion.start),
      End: () => this.goTo(this.motion.end),
      "+": () => this.changeSpeed(1),
      "-": () => this.changeSpeed(-1),
      g: () => element("show-grid").click(),
      l: () => element("show-labels").click(),
      m: () => element("show-mesh").click(),
      r: () => this.reset(),
      t: () => this.switchTheme(),
      p: () => this.save(),
    };
    addEventListener("keydown", (event) => {
      const action = actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
      const { target } = event;
      const button = target instanceof HTMLButtonElement || target.type === "checkbox";
      const taken = target instanceof HTMLSelectElement || (button && event.key === " ");
      if (!action || taken || event.ctrlKey || event.metaKey || event.altKey) {
        return;
      }
      event.preventDefault();
      action();
    });
  }

  toggle() {
    this.playing = !this.playing;
    if (this.playing && this.time >= this.motion.end) {
      this.time = this.motion.start;
    }
    this.stale = true;
  }

  goTo(time) {
    this.time = Math.min(Math.max(time, this.motion.start), this.motion.end);
    this.stale = true;
  }

  /** To the next or the last recorded frame. */
  step(by) {
    this.playing = false;
    const k = this.motion.frame(this.time);
    const back = by < 0 && this.time > this.motion.times[k] ? 0 : by;
    const last = this.motion.times.length - 1;
    this.goTo(this.motion.times[Math.min(Math.max(k + back, 0), last)]);
  }

  changeSpeed(by) {
    const k = SPEEDS.indexOf(this.speed) + by;
    this.speed = SPEEDS[Math.min(Math.max(k, 0), SPEEDS.length - 1)];
    element("speed").value = this.speed;
  }

  reset() {
    this.camera.reset();
    this.stale = true;
  }

  switchTheme() {
    this.theme = this.theme === "dark" ? "light" : "dark";
    document.documentElement.dataset.theme = this.theme;
    this.stale = true;
  }

  /** Hand the picture to the reader as a file. */
  save() {
    this.draw();
    this.canvas.toBlob((blob) => {
      const link = document.createElement("a");
      link.href = URL.createObjectURL(blob);
      link.download = `${this.scene.title.replaceAll("/", "_")}_${this.time.toFixed(3)}.png`;
      link.click();
      URL.revokeObjectURL(link.href);
    });
  }

  tick(now) {
    const passed = Math.min((now - this.last) / 1000, 0.1);
    this.last = now;
    if (this.playing) {
      this.time += passed * this.speed;
      this.stale = true;
      if (this.time >= this.motion.end) {
        const again = element("loop").checked;
        this.time = again ? this.motion.start : this.motion.end;
        this.playing = again;
      }
    }
    if (this.stale) {
      this.stale = false;
      this.draw();
    }
    requestAnimationFrame((later) => this.tick(later));
  }

  draw() {
    const theme = THEMES[this.theme];
    const show = Object.fromEntries(
      ["grid", "shadow", "labels", "mesh"].map((name) => [name, element(`show-${name}`).checked]),
    );
    const height = Math.max(this.canvas.clientHeight, 1);
    const margins = { top: Math.min(50 / height, 0.2), bottom: Math.min(90 / height, 0.3), side: 0.05 };
    this.camera.resize(this.renderer.resize(), margins);
    this.stage.place(this.time);
    const look = this.camera.look();
    this.stage.draw(look, theme, show);
    this.drawTriad(look);
    this.placeLabels(look, show.labels);
    const digits = Math.min(Math.max(Math.ceil(-Math.log10(this.motion.interval) - 1e-9), 0), 9);
    element("time").value = this.time;
    element("clock").textContent = `${this.time.toFixed(digits)} / ${this.motion.end.toFixed(digits)} s`;
    element("play").textContent = this.playing ? "❚❚" : "▶";
    document.body.dataset.state = "ready";
  }

  /** Place the global axes, seen from where the camera stands, into a corner. */
  drawTriad(look) {
    const gl = this.renderer.gl, scale = window.devicePixelRatio || 1, size = 92, left = 12, bottom = 66;
    this.renderer.viewport(left * scale, bottom * scale, size * scale, size * scale);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    const flat = new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, -0.5, 0, 0, 0, 0, 1.5]);
    const turned = product(flat, view([0, 0, 0], look.right, look.up, look.back));
    this.renderer.world = { ...this.renderer.world, matrix: turned };
    const colours = ["#d9483b", "#3f9b4b", "#3b6fd9"];
    colours.forEach((colour, k) => {
      this.renderer.drawLines(this.triadLines[k], [...rgb(colour), 1], 2.5);
      const [x, y, , w] = transformed(turned, IDENTITY.slice(3 * k, 3 * k + 3));
      const [right, above] = [x, y].map((along) => size * (0.5 + (0.58 * along) / w));
      const [across, down] = [left + right, this.canvas.clientHeight - bottom - above];
      this.triad[k].style.transform = `translate(${across}px, ${down}px) translate(-50%, -50%)`;
      this.triad[k].style.color = colour;
    });
  }

  /** Names at their bodies: all, or the one under the pointer. */
  placeLabels(look, all) {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    let nearest = null, least = 28;
    for (const label of this.labels) {
      const [x, y, , w] = transformed(look.matrix, this.motion.point(label.body, label.at));
      label.place = w > 0 ? [(0.5 + (0.5 * x) / w) * width, (0.5 - (0.5 * y) / w) * height] : null;
      if (label.place && this.hovered) {
        const away = Math.hypot(label.place[0] - this.hovered[0], label.place[1] - this.hovered[1]);
        [nearest, least] = away < least ? [label, away] : [nearest, least];
      }
    }
    for (const label of this.labels) {
      label.span.hidden = !label.place || !(all || label === nearest);
      if (!label.span.hidden) {
        label.span.style.transform = `translate(${label.place[0] + 10}px, ${label.place[1] - 24}px)`;
      }
    }
  }
}

try {
  new Viewer(JSON.parse(element("scene").textContent));
} catch (error) {
  const message = document.createElement("p");
  message.className = "failed";
  message.textContent = error.message;
  document.body.append(message);
  document.body.dataset.state = "failed";
}
