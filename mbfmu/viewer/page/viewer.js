/* The page: time, camera and options in the hands of the reader. */

const SHOWN = ["grid", "shadow", "labels", "mesh", "forces", "beside"]; // by switches
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
  /** `motion` and, or null, `beside`: the runs of the scene. */
  constructor(scene, motion, beside) {
    this.scene = scene;
    this.canvas = element("view");
    this.motion = motion;
    this.beside = beside;
    this.motions = [motion, beside].filter((run) => run);
    this.renderer = new Renderer(this.canvas);
    this.stage = new Stage(this.renderer, scene, this.motion, this.beside);
    this.camera = new Camera(scene.stage);
    this.clock = new Clock(motion.times);
    this.hovered = null;
    this.theme = matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
    this.clock.playing = this.clock.end > this.clock.start && !matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.prepareControls();
    this.preparePlot();
    this.prepareLabels();
    handPointer(this);
    handKeys(this);
    freeKeys();
    this.stale = true;
    new ResizeObserver(() => (this.stale = true)).observe(this.canvas);
    requestAnimationFrame((now) => this.tick(now));
  }

  prepareControls() {
    const { note, bodies, picture } = this.scene;
    const beside = this.scene.against && `compared with ${this.scene.against.title}`;
    const grid = `grid ${figures(this.stage.floor.spacing)} m`;
    element("note").textContent = [note, beside, grid].filter((text) => text).join(" · ");
    const slider = element("time");
    slider.min = this.clock.start;
    slider.max = this.clock.end;
    slider.addEventListener("input", () => this.halt(Number(slider.value)));
    element("play").addEventListener("click", () => {
      this.clock.toggle();
      this.stale = true;
    });
    for (const speed of SPEEDS) {
      element("speed").add(new Option(`${speed}×`, speed, false, speed === this.clock.speed));
    }
    element("speed").addEventListener("change", (event) => (this.clock.speed = Number(event.target.value)));
    bodies.forEach((name, k) => k > 0 && element("trace").add(new Option(name, k)));
    element("trace").addEventListener("change", (event) => {
      const body = event.target.value === "" ? null : Number(event.target.value);
      this.stage.trace(body, body === null ? null : picture.middles[body]);
      this.stale = true;
    });
    element("mesh-option").hidden = picture.skins.length === 0;
    element("forces-option").hidden = this.scene.arrows.length === 0;
    element("beside-option").hidden = !this.beside;
    for (const name of SHOWN) {
      element(`show-${name}`).addEventListener("change", () => (this.stale = true));
    }
    this.prepareLegend();
    this.prepareFields();
    this.prepareReadouts();
    element("reset").addEventListener("click", () => this.reset());
    element("theme").addEventListener("click", () => this.switchTheme());
    element("save").addEventListener("click", () => this.save());
    document.documentElement.dataset.theme = this.theme;
  }

  /** What the arrows mean: their scale, and whose they are. */
  prepareLegend() {
    const kinds = Object.keys(KINDS).filter((kind) => this.scene.arrows.some((arrow) => arrow.kind === kind));
    element("legend").append(`arrows: ${this.stage.arrows.legend.join(", ")}`);
    for (const kind of kinds) {
      const dot = document.createElement("i");
      dot.style.background = KINDS[kind];
      element("legend").append(dot, KIND_NAMES[kind]);
    }
  }

  /** What the colors of surfaces mean. */
  prepareFields() {
    const { stops, against } = this.scene, runs = [this.scene, against];
    const found = runs.flatMap((run) => [...(run?.fields ?? []), ...(run?.hull_fields ?? [])]).filter((field) => field);
    for (const { title: text, low, limit } of new Map(found.map((field) => [field.title, field])).values()) {
      const title = document.createElement("p"), bar = document.createElement("i"), scale = document.createElement("p");
      const shown = low < 0 ? stops : stops.slice((stops.length - 1) / 2); // zero has the middle one
      title.textContent = text;
      bar.style.background = `linear-gradient(to right, ${shown.join(", ")})`;
      for (const value of limit > 0 ? [...new Set([low, 0, limit])] : [0]) {
        const tick = document.createElement("span");
        tick.textContent = figures(value, 3);
        scale.append(tick);
      }
      element("fields").append(title, bar, scale);
    }
    element("fields").hidden = found.length === 0;
  }

  /** A line for each output that the model reads out. */
  prepareReadouts() {
    this.shown_outputs = this.scene.picture.shown_outputs.map((name) => {
      const line = document.createElement("div"), label = document.createElement("i");
      const value = document.createElement("output");
      label.textContent = name;
      line.append(label, value);
      element("shown_outputs").append(line);
      return { name, value };
    });
  }

  preparePlot() {
    const plotted = this.motion.outputs.length > 0;
    element("plot-option").hidden = !plotted;
    const show = () => document.body.classList.toggle("plotted", plotted && element("show-plot").checked);
    element("show-plot").checked = window.innerWidth > 760;
    element("show-plot").addEventListener("change", show);
    show();
    element("options").open = this.canvas.clientWidth > 800; // it would stand before the motion
    this.plot = new Plot(element("curves"), element("choice"), this.motions, (time) => this.halt(time));
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

  /** Stop at a time. */
  halt(time) {
    this.clock.halt(time);
    this.stale = true;
  }

  /** Pick the body that is seen at a place of the canvas. */
  pick(x, y) {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const { eye, right, up, back } = this.camera.look();
    const slope = Math.tan(this.camera.field / 2);
    const across = slope * this.camera.aspect * ((2 * x) / width - 1), above = slope * (1 - (2 * y) / height);
    this.stage.figure.place(this.clock.time);
    this.hold(picked(this.stage.figure, eye, combined([right, up, back], [across, above, -1])));
  }

  /** Have a body, or none, highlighted and told of. */
  hold(body) {
    this.stage.figure.picked = body;
    element("card").hidden = body === null;
    this.stale = true;
  }

  tell() {
    const body = this.stage.figure.picked;
    if (body === null) {
      return;
    }
    const rows = told(this.scene, this.motion, body, this.clock.time).map((words) => {
      const row = document.createElement("tr");
      words.forEach((word) => (row.insertCell().textContent = word));
      return row;
    });
    element("card").firstChild.replaceChildren(...rows);
  }

  reset() {
    this.camera.reset();
    this.stale = true;
  }

  switchTheme() {
    this.theme = this.theme === "dark" ? "light" : "dark";
    document.documentElement.dataset.theme = this.theme;
    this.plot.rebuild();
    this.stale = true;
  }

  /** Hand the picture to the reader as a file. */
  save() {
    this.draw();
    this.canvas.toBlob((blob) => {
      const link = document.createElement("a");
      link.href = URL.createObjectURL(blob);
      link.download = `${this.scene.title.replaceAll("/", "_")}_${this.clock.time.toFixed(3)}.png`;
      link.click();
      URL.revokeObjectURL(link.href);
    });
  }

  tick(now) {
    this.clock.loop = element("loop").checked;
    this.stale ||= this.clock.playing;
    this.clock.tick(now);
    if (this.stale) {
      this.stale = false;
      this.draw();
    }
    requestAnimationFrame((later) => this.tick(later));
  }

  draw() {
    const theme = THEMES[this.theme];
    const show = Object.fromEntries(
      SHOWN.map((name) => [name, element(`show-${name}`).checked]),
    );
    const height = Math.max(this.canvas.clientHeight, 1);
    const margins = { top: Math.min(50 / height, 0.2), bottom: Math.min(90 / height, 0.3), side: 0.05 };
    this.camera.resize(this.renderer.resize(), margins);
    this.stage.place(this.clock.time);
    const look = this.camera.look();
    this.stage.draw(look, theme, show);
    this.drawTriad(look);
    this.placeLabels(look, show.labels);
    const digits = Math.min(Math.max(Math.ceil(-Math.log10(this.motion.interval) - 1e-9), 0), 9);
    this.plot.show(this.clock.time);
    this.shown_outputs.forEach(({ name, value }) => (value.textContent = reading(this.motions, name, this.clock.time)));
    this.tell();
    element("legend").hidden = !show.forces;
    element("time").value = this.clock.time;
    element("speed").value = this.clock.speed;
    element("clock").textContent = `${this.clock.time.toFixed(digits)} / ${this.clock.end.toFixed(digits)} s`;
    element("play").textContent = this.clock.playing ? "❚❚" : "▶";
    document.body.dataset.state = "ready";
  }

  /** Place the global axes, seen from where the camera stands, into a corner. */
  drawTriad(look) {
    const gl = this.renderer.gl, scale = window.devicePixelRatio || 1, size = 92, left = 12;
    const bottom = this.canvas.clientHeight - document.querySelector("footer").offsetTop + 8; // it may take two rows
    this.renderer.viewport(left * scale, bottom * scale, size * scale, size * scale);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    const flat = new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, -0.5, 0, 0, 0, 0, 1.5]);
    const turned = product(flat, view([0, 0, 0], look.right, look.up, look.back));
    this.renderer.world = { ...this.renderer.world, matrix: turned };
    const colors = ["#d9483b", "#3f9b4b", "#3b6fd9"];
    colors.forEach((color, k) => {
      this.renderer.drawLines(this.triadLines[k], [...rgb(color), 1], 2.5);
      const [x, y, , w] = transformed(turned, IDENTITY.slice(3 * k, 3 * k + 3));
      const [right, above] = [x, y].map((along) => size * (0.5 + (0.58 * along) / w));
      const [across, down] = [left + right, this.canvas.clientHeight - bottom - above];
      this.triad[k].style.transform = `translate(${across}px, ${down}px) translate(-50%, -50%)`;
      this.triad[k].style.color = color;
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
      const held = label.body === this.stage.figure.picked;
      label.span.hidden = !label.place || !(all || held || label === nearest);
      if (!label.span.hidden) {
        label.span.style.transform = `translate(${label.place[0] + 10}px, ${label.place[1] - 24}px)`;
      }
    }
  }
}

async function start() {
  const scene = JSON.parse(element("scene").textContent);
  const motion = new Motion(scene, await recorded());
  const beside = scene.against && new Motion(scene.against, await recorded("-against"));
  return new Viewer(scene, motion, beside);
}

start().catch((error) => {
  const message = document.createElement("p");
  message.className = "failed";
  message.textContent = error.message;
  document.body.append(message);
  document.body.dataset.state = "failed";
});
