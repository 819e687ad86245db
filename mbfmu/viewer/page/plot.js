/* Curves of the outputs beside the motion: which, is chosen by clicks; a click or a drag in them sets the clock. */

const CURVES = ["#4269d0", "#e07b00", "#d9483b", "#3ca951", "#a463f2", "#38b2c4", "#d4569a", "#9c6b4e"];

/** A column as uPlot takes it: what is no number is a gap. */
const gapped = (values) => Array.from(values, (x) => (Number.isFinite(x) ? x : null));

/** Value of an output of a run at a time, between two frames. */
function valueAt(motion, name, time) {
  const values = motion.outputs.find((output) => output.name === name)?.values;
  const [k, next, s] = motion.around(time);
  return values && time <= motion.end ? (1 - s) * values[k] + s * values[next] : NaN;
}

/** What an output is at a time in every run that has it then, with its unit. */
function reading(motions, name, time) {
  const { unit } = motions[0].outputs.find((output) => output.name === name);
  const values = motions.map((motion) => valueAt(motion, name, time)).filter((x) => !Number.isNaN(x));
  return `${values.map((x) => figures(x)).join(" | ")}${unit && unit !== "1" ? ` ${unit}` : ""}`;
}

/** Times, and under each chosen output the values of every run that has it, as one table over all times. */
function table(motions, names) {
  const tables = motions.map((motion) => {
    const own = names.map((name) => motion.outputs.find((output) => output.name === name));
    return [Array.from(motion.times), ...own.map((output) => gapped(output?.values ?? []))];
  });
  tables.forEach((columns) => columns.forEach((column) => (column.length = columns[0].length)));
  return tables.length > 1 ? uPlot.join(tables) : tables[0];
}

/** What stands at the ticks of an axis: as many figures as tell one from the next. */
function ticks(values) {
  const step = Math.abs(values[1] - values[0]) || 1, largest = Math.max(...values.map(Math.abs));
  const count = Math.min(Math.max(Math.ceil(Math.log10(largest / step) - 1e-9) + 1, 1), 15);
  return values.map((x) => (Math.abs(x) < 0.5 * step ? "0" : figures(x, count)));
}

class Plot {
  /** `goTo` is called with the time that a reader points at. */
  constructor(root, choice, motions, goTo) {
    this.root = root;
    this.motions = motions;
    this.goTo = goTo;
    this.chosen = [];
    this.chips = new Map(motions[0].outputs.map(({ name, unit }) => [name, this.chip(name, unit)]));
    choice.append(...this.chips.values());
    this.now = document.createElement("div");
    this.now.className = "now";
    new ResizeObserver(() => this.fit()).observe(root);
    if (this.chips.size > 0) {
      this.toggle(motions[0].outputs[0].name);
    }
  }

  chip(name, unit) {
    const button = document.createElement("button");
    button.title = unit;
    button.append(document.createElement("i"), name, document.createElement("output"));
    button.addEventListener("click", () => this.toggle(name));
    return button;
  }

  /** Show an output, or hide it. */
  toggle(name) {
    const { chosen } = this;
    this.chosen = chosen.includes(name) ? chosen.filter((other) => other !== name) : [...chosen, name];
    this.rebuild();
  }

  color(name) {
    const k = this.motions[0].outputs.findIndex((output) => output.name === name);
    return CURVES[k % CURVES.length];
  }

  unit(name) {
    return this.motions[0].outputs.find((output) => output.name === name).unit || "1";
  }

  rebuild() {
    this.plot?.destroy();
    this.plot = null;
    for (const [name, chip] of this.chips) {
      const on = this.chosen.includes(name);
      chip.setAttribute("aria-pressed", on);
      chip.firstChild.style.background = on ? this.color(name) : "";
      chip.lastChild.textContent = on ? chip.lastChild.textContent : "";
    }
    const { clientWidth: width, clientHeight: height } = this.root;
    if (this.chosen.length === 0 || width < 60 || height < 60) {
      return;
    }
    this.plot = new uPlot(this.options(width, height), table(this.motions, this.chosen), this.root);
    this.plot.over.append(this.now);
    this.listen(this.plot.over);
  }

  options(width, height) {
    const style = getComputedStyle(document.documentElement);
    const [ink, edge] = ["--ink", "--edge"].map((name) => style.getPropertyValue(name));
    const units = [...new Set(this.chosen.map((name) => this.unit(name)))];
    const look = { stroke: ink, grid: { stroke: edge, width: 1 }, ticks: { stroke: edge, width: 1 } };
    const axes = units.map((unit, k) => ({
      ...look, scale: unit, label: unit, side: k % 2 ? 1 : 3, labelSize: 18, labelGap: 2,
      values: (_, splits) => ticks(splits), size: (_, texts) => 20 + 7 * Math.max(3, ...(texts ?? []).map((t) => t.length)),
      grid: { ...look.grid, show: k === 0 },
    }));
    const series = this.motions.flatMap((_, run) => this.chosen.map((name) => ({
      label: name, scale: this.unit(name), stroke: this.color(name), width: run ? 1 : 1.6, points: { show: false },
      ...(run && { dash: [6, 4] }), spanGaps: this.motions.length > 1,
    })));
    return {
      width, height, axes: [{ ...look, label: "s", size: 34, labelSize: 16, labelGap: 0 }, ...axes],
      series: [{}, ...series], scales: { x: { time: false } }, legend: { show: false },
      cursor: { drag: { x: false, y: false }, points: { show: false }, y: false },
      hooks: { draw: [() => this.show(this.time ?? this.motions[0].start)] }, // the axes have their widths only then
    };
  }

  listen(over) {
    const point = (event) => {
      if (event.buttons & 1) {
        this.goTo(this.plot.posToVal(event.clientX - over.getBoundingClientRect().left, "x"));
      }
    };
    over.addEventListener("pointerdown", (event) => {
      over.setPointerCapture(event.pointerId);
      point(event);
    });
    over.addEventListener("pointermove", point);
  }

  fit() {
    const { clientWidth: width, clientHeight: height } = this.root;
    if (this.plot && width >= 60 && height >= 60) {
      this.plot.setSize({ width, height });
    } else {
      this.rebuild();
    }
  }

  /** Move the cursor to a time, and tell the values there. */
  show(time) {
    this.time = time;
    if (!this.plot) {
      return;
    }
    this.now.style.transform = `translateX(${this.plot.valToPos(time, "x")}px)`;
    for (const name of this.chosen) {
      this.chips.get(name).lastChild.textContent = reading(this.motions, name, time);
    }
  }
}
