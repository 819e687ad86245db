/* The reader's pointer and keys. */

/** Let the pointer turn, shift and zoom the camera of a viewer, and pick bodies. */
function handPointer(viewer) {
  const pointers = new Map();
  const { canvas, camera } = viewer;
  const middle = () => {
    const all = [...pointers.values()];
    return [0, 1].map((k) => all.reduce((sum, p) => sum + p[k], 0) / all.length);
  };
  const spread = () => {
    const [a, b] = [...pointers.values()];
    return b ? Math.hypot(a[0] - b[0], a[1] - b[1]) : 0;
  };
  let traveled = 0; // by the pointer since it went down, pixels: a click does not turn
  canvas.addEventListener("pointerdown", (event) => {
    traveled = 0;
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  canvas.addEventListener("pointermove", (event) => {
    viewer.stale = true;
    if (!pointers.has(event.pointerId)) {
      viewer.hovered = [event.clientX, event.clientY];
      return;
    }
    const before = middle(), wide = spread();
    traveled += Math.hypot(event.movementX, event.movementY);
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    const [dx, dy] = middle().map((x, k) => (x - before[k]) / canvas.clientHeight);
    if (pointers.size > 1 || event.buttons & 6 || event.shiftKey) {
      camera.shift(dx, dy);
    } else {
      camera.turn(4 * dx, 4 * dy);
    }
    if (wide > 0 && spread() > 0) {
      camera.zoom(wide / spread());
    }
  });
  for (const name of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(name, (event) => pointers.delete(event.pointerId));
  }
  canvas.addEventListener("click", (event) => traveled < 4 && viewer.pick(event.clientX, event.clientY));
  canvas.addEventListener("pointerleave", () => {
    viewer.hovered = null;
    viewer.stale = true;
  });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("dblclick", () => viewer.reset());
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    camera.zoom(Math.exp(Math.min(Math.max(event.deltaY, -100), 100) * 0.0016));
    viewer.stale = true;
  }, { passive: false });
}

/** Let keys do what the page says they do. */
function handKeys(viewer) {
  const { clock } = viewer;
  const actions = {
    " ": () => clock.toggle(),
    ArrowRight: () => clock.step(1),
    ArrowLeft: () => clock.step(-1),
    Home: () => clock.goTo(clock.start),
    End: () => clock.goTo(clock.end),
    "+": () => clock.changeSpeed(1),
    "-": () => clock.changeSpeed(-1),
    g: () => element("show-grid").click(),
    l: () => element("show-labels").click(),
    m: () => element("show-mesh").click(),
    f: () => element("show-forces").click(),
    b: () => element("show-beside").click(),
    o: () => element("show-plot").click(),
    Escape: () => viewer.hold(null),
    r: () => viewer.reset(),
    t: () => viewer.switchTheme(),
    p: () => viewer.save(),
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
    viewer.stale = true;
  });
}

/** What was clicked does not keep the space bar. */
function freeKeys() {
  addEventListener("click", ({ detail }) => {
    if (detail > 0 && document.activeElement?.matches("button, summary, input[type=checkbox]")) {
      document.activeElement.blur();
    }
  });
}
