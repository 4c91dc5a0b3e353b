// Plots of a run: panels with a common time axis and cursor, and the locus of the flux.
// For any number of rows, a plot gets two points per pixel: minimum and maximum.

import uPlot from "uplot";

const BLOCK = 64; // rows per block whose minimum and maximum are stored

// Factor and unit with which a value has one to three digits before the point.
export function prefixed(value, unit) {
  for (const [factor, prefix] of [
    [1, ""],
    [1e-3, "m"],
    [1e-6, "µ"],
    [1e-9, "n"],
  ])
    if (Math.abs(value) >= factor) return [factor, `${prefix}${unit}`];
  return [1, unit];
}

// Columns of a run, with minimum and maximum of blocks of rows.
export class View {
  constructor(columns) {
    this.columns = columns;
    this.t = columns.t;
    this.rows = columns.t.length;
    this.blocks = new Map();
  }
  has(name) {
    return name in this.columns;
  }

  // The row at or before a time.
  row(time) {
    let low = 0,
      high = this.rows;
    while (high - low > 1) {
      const m = (low + high) >> 1;
      if (this.t[m] <= time) low = m;
      else high = m;
    }
    return low;
  }

  // Minimum and maximum of complete blocks of rows; with `known`, of their valid rows only.
  pyramid(name, known = false) {
    const key = known ? `${name} if valid` : name,
      valid = known ? this.columns.valid : null,
      d = this.columns[name],
      size = Math.ceil(d.length / BLOCK);
    if (!this.blocks.has(key))
      this.blocks.set(key, {
        least: new Float64Array(size),
        most: new Float64Array(size),
        count: 0,
      });
    const found = this.blocks.get(key);
    for (const end = Math.floor(this.rows / BLOCK); found.count < end; found.count++) {
      let low = Infinity,
        high = -Infinity;
      for (let k = found.count * BLOCK; k < (found.count + 1) * BLOCK; k++) {
        if (valid && !valid[k]) continue;
        const v = d[k];
        if (v < low) low = v;
        if (v > high) high = v;
      }
      found.least[found.count] = low;
      found.most[found.count] = high;
    }
    return found;
  }

  // Minimum and maximum of rows first … last - 1.
  range(name, first, last, known = false) {
    const d = this.columns[name],
      valid = known ? this.columns.valid : null;
    let low = Infinity,
      high = -Infinity,
      k = first;
    if (last - first > 4 * BLOCK) {
      const { least, most } = this.pyramid(name, known),
        start = Math.ceil(first / BLOCK),
        end = Math.floor(last / BLOCK);
      for (let b = start; b < end; b++) {
        if (least[b] < low) low = least[b];
        if (most[b] > high) high = most[b];
      }
      for (; k < start * BLOCK; k++) {
        if (valid && !valid[k]) continue;
        const v = d[k];
        if (v < low) low = v;
        if (v > high) high = v;
      }
      k = end * BLOCK;
    }
    for (; k < last; k++) {
      if (valid && !valid[k]) continue;
      const v = d[k];
      if (v < low) low = v;
      if (v > high) high = v;
    }
    return [low, high];
  }

  // Minimum and maximum of the valid rows of a window, or of all its rows if none is valid.
  extent(name, from, to) {
    const first = this.row(from),
      last = this.row(to) + 1;
    if (this.has("valid")) {
      const found = this.range(name, first, last, true);
      if (found[0] <= found[1]) return found;
    }
    return this.range(name, first, last);
  }

  // [x, ...ys] for a plot `width` pixels wide; `maps` convert values to displayed units.
  sample(names, from, to, width, maps = []) {
    const first = Math.max(0, this.row(from) - 1),
      last = Math.min(this.rows, this.row(to) + 3),
      count = last - first;
    if (count <= 3 * width) {
      const x = Array.from(this.t.subarray(first, last));
      return [
        x,
        ...names.map((name, n) =>
          Array.from(this.columns[name].subarray(first, last), (v) =>
            v === v ? (maps[n] ? maps[n](v) : v) : null,
          ),
        ),
      ];
    }
    const x = new Array(2 * width),
      ys = names.map(() => new Array(2 * width)),
      edge = (p) => first + Math.floor((p * count) / width);
    for (let p = 0; p < width; p++) {
      const a = edge(p),
        b = Math.max(edge(p + 1), a + 1);
      x[2 * p] = this.t[a];
      x[2 * p + 1] = this.t[(a + b) >> 1];
      names.forEach((name, n) => {
        const [low, high] = this.range(name, a, b),
          map = maps[n] ?? ((v) => v);
        ys[n][2 * p] = low === Infinity ? null : map(low);
        ys[n][2 * p + 1] = high === -Infinity ? null : map(high);
      });
    }
    return [x, ...ys];
  }

  // The column `valid` for a window, cached because all panels need the same.
  known(...asked) {
    const key = [this.rows, this.t[0], ...asked].join();
    if (this.asked !== key) this.valid = this.sample(["valid"], ...asked);
    this.asked = key;
    return this.valid;
  }

  // Turns of the rotor in a window, from the electrical speed.
  turns(from, to) {
    if (!this.has("speed_e")) return 0;
    const speed = this.columns.speed_e,
      first = this.row(from),
      last = this.row(to) + 1,
      step = Math.max(1, Math.floor((last - first) / 10_000));
    let sum = 0;
    for (let k = first; k < last; k += step) if (speed[k] === speed[k]) sum += Math.abs(speed[k]);
    return (sum * step * (to - from)) / (last - first) / (2 * Math.PI);
  }

  // Mean, rms, minimum and maximum of the valid rows of a window.
  statistics(name, from, to) {
    const { valid } = this.columns,
      first = this.row(from),
      last = this.row(to) + 1,
      d = this.columns[name],
      step = Math.max(1, Math.floor((last - first) / 200_000));
    let n = 0,
      sum = 0,
      square = 0;
    for (let k = first; k < last; k += step) {
      const v = d[k];
      if (v === v && (!valid || valid[k])) {
        n++;
        sum += v;
        square += v * v;
      }
    }
    const [least, most] = this.range(name, first, last, Boolean(valid));
    return { mean: sum / n, rms: Math.sqrt(square / n), least, most };
  }
}

// The latest rows of a stream: columns that grow and drop their oldest rows when full.
export class Recent extends View {
  constructor(names, flags, capacity) {
    const columns = {};
    for (const name of names)
      columns[name] = new (flags.has(name) ? Uint8Array : Float64Array)(capacity);
    super(columns);
    this.capacity = capacity;
    this.rows = 0;
  }

  append(columns) {
    const count = columns.t.length;
    if (this.rows + count > this.capacity) this.forget(this.capacity / 2);
    for (const [name, values] of Object.entries(this.columns)) {
      const given = columns[name].subarray(Math.max(0, count - this.capacity / 2));
      values.set(given, this.rows);
    }
    this.rows += Math.min(count, this.capacity / 2);
  }

  // Drop the oldest rows, in complete blocks, until at most `keep` rows are left.
  forget(keep) {
    const out = Math.ceil(Math.max(0, this.rows - keep) / BLOCK) * BLOCK;
    for (const values of Object.values(this.columns)) values.copyWithin(0, out, this.rows);
    for (const one of this.blocks.values()) {
      one.least.copyWithin(0, out / BLOCK, one.count);
      one.most.copyWithin(0, out / BLOCK, one.count);
      one.count = Math.max(0, one.count - out / BLOCK);
    }
    this.rows = Math.max(0, this.rows - out);
  }
}

const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

// Tick steps of axes in degrees.
const DEGREES = [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 30, 90, 180];

const tick = (v) => (v == null ? "" : String(Number(v.toPrecision(6))));

// Marks of faults in the column `quality` (logs/quality/marks.py).
const FAULTS = 1 | 2 | 4 | 8 | 16 | 32 | 128;

// Shade the time without a valid position; a strip at the lower edge shows rows with a fault.
function shade(view) {
  return (u) => {
    if (!view().has("valid")) return;
    const { ctx, bbox } = u,
      { min, max } = u.scales.x,
      width = Math.max(1, Math.round(bbox.width / devicePixelRatio / 2));
    const [x, valid] = view().known(min, max, width);
    ctx.save();
    ctx.fillStyle = style("--invalid");
    for (let k = 0; k < x.length - 1; k++) {
      if (valid[k] !== 0) continue;
      const left = Math.max(bbox.left, u.valToPos(x[k], "x", true)),
        right = Math.min(bbox.left + bbox.width, u.valToPos(x[k + 1], "x", true));
      if (right > left) ctx.fillRect(left, bbox.top, Math.max(1, right - left), bbox.height);
    }
    if (view().has("quality")) {
      const [t, marks] = view().sample(["quality"], min, max, width),
        height = 4 * devicePixelRatio;
      ctx.fillStyle = style("--red");
      for (let k = 0; k < t.length - 1; k++) {
        if (!(marks[k] & FAULTS)) continue;
        const left = Math.max(bbox.left, u.valToPos(t[k], "x", true)),
          right = Math.min(bbox.left + bbox.width, u.valToPos(t[k + 1], "x", true));
        if (right >= left)
          ctx.fillRect(left, bbox.top + bbox.height - height, Math.max(1, right - left), height);
      }
    }
    ctx.restore();
  };
}

// More turns of an angle than this would fill their panel.
const MOST_TURNS = 60;
function message(u) {
  if (!u.message) return;
  const { ctx, bbox } = u;
  ctx.save();
  ctx.fillStyle = style("--soft");
  ctx.font = `${12 * devicePixelRatio}px system-ui`;
  ctx.textAlign = "center";
  ctx.fillText(u.message, bbox.left + bbox.width / 2, bbox.top + bbox.height / 2);
  ctx.restore();
}

// A curve that rises and falls within each pixel is drawn as columns of pixels, because stroking it
// would take longer than all other drawing.
const linear = uPlot.paths.linear();
function steep(u, n) {
  const y = u.data[n],
    { min, max } = u.scales.y;
  if (!y || !u.thinned) return false; // else neighbouring points are no minimum and maximum
  let way = 0;
  for (let k = 1; k < y.length; k++) way += Math.abs(y[k] - y[k - 1]);
  return (way / (max - min)) * u.bbox.height > 10 * u.bbox.width;
}
function columns(u, n) {
  if (!steep(u, n)) return;
  const { ctx, bbox } = u,
    [x, y] = [u.data[0], u.data[n]],
    right = bbox.left + bbox.width,
    bottom = bbox.top + bbox.height;
  ctx.save();
  ctx.fillStyle = u.series[n].stroke();
  ctx.globalAlpha = u.series[n].dash ? 0.5 : 1;
  for (let k = 0; k + 1 < x.length; k += 2) {
    if (y[k] == null || y[k + 1] == null) continue;
    const at = Math.round(u.valToPos(x[k], "x", true)),
      [a, b] = [y[k], y[k + 1]].map((v) => u.valToPos(v, "y", true)),
      top = Math.max(bbox.top, Math.round(Math.min(a, b))),
      end = Math.min(bottom, Math.round(Math.max(a, b))),
      next = k + 2 < x.length ? Math.round(u.valToPos(x[k + 2], "x", true)) : at + 1;
    if (at >= bbox.left && next <= right)
      ctx.fillRect(at, top, Math.max(1, next - at), Math.max(1, end - top));
  }
  ctx.restore();
}

// The panels of a run. `specs`: [{id, title, unit, turning, series:
// [{name, label, color, dash, map, fill, less, unlisted}]}]; the legend shows the value less that of
// the column `less`; a panel that is `turning` shows an angle
export class Panels {
  constructor(box, { onWindow, onCursor }) {
    this.box = box;
    this.onWindow = onWindow;
    this.onCursor = onCursor;
    this.charts = [];
    this.view = null;
    this.busy = false;
    new ResizeObserver(() => this.resize()).observe(box);
  }
  get width() {
    return Math.max(260, this.box.clientWidth);
  }

  show(view, specs, keep = false) {
    const same =
      keep && this.view && this.view.rows === view.rows && this.specs?.length === specs.length;
    this.view = view;
    this.specs = specs;
    if (same) {
      this.refill(true);
      return;
    }
    this.charts.forEach((one) => one.destroy());
    this.box.replaceChildren();
    this.full = [view.t[0], view.t[view.rows - 1]];
    this.window = [...this.full];
    const sync = uPlot.sync("time");
    this.charts = specs.map((spec, n) => {
      const holder = document.createElement("figure");
      holder.className = "panel";
      holder.tabIndex = 0;
      holder.dataset.panel = spec.id;
      holder.setAttribute("role", "img");
      holder.addEventListener("keydown", (event) => this.key(event));
      this.box.append(holder);
      const chart = new uPlot(
        {
          width: this.width,
          height: spec.height ?? 150,
          title: "",
          legend: { show: true, live: true },
          // a dot marks the row at the cursor, unless rows are thinned
          cursor: {
            sync: { key: sync.key },
            drag: { x: true, y: false },
            points: { size: (u) => (u.thinned ? 0 : 6) },
          },
          select: { show: true },
          scales: {
            x: { time: false, range: () => this.window },
            y: { range: () => this.scale(spec) },
          },
          axes: [
            {
              stroke: () => style("--ink"),
              grid: { stroke: () => style("--line"), width: 1 },
              ticks: { stroke: () => style("--line") },
              values: (u, ticks) => ticks.map(tick),
              label: n === specs.length - 1 ? "Time in s" : undefined,
              labelSize: 18,
              size: n === specs.length - 1 ? 30 : 24,
              font: "11px system-ui",
              labelFont: "11px system-ui",
            },
            {
              stroke: () => style("--ink"),
              grid: { stroke: () => style("--line"), width: 1 },
              ticks: { stroke: () => style("--line") },
              values: (u, ticks) => ticks.map(tick),
              space: 22,
              ...(spec.unit === "°" ? { incrs: DEGREES } : {}),
              label: `${spec.title}${spec.unit ? ` in ${spec.unit}` : ""}`,
              labelSize: 18,
              size: 72,
              font: "11px system-ui",
              labelFont: "11px system-ui",
            },
          ],
          series: [
            { label: "t", value: (u) => this.time(u), class: n ? "off" : undefined },
            ...spec.series.map((s) => ({
              label: s.label,
              class: s.unlisted ? "off" : undefined,
              stroke: () => style(s.color),
              fill: s.fill ? () => style(s.fill) : undefined,
              width: s.width ?? 1.25,
              dash: s.dash,
              paths: (u, n, ...rest) => (steep(u, n) ? null : linear(u, n, ...rest)),
              spanGaps: false,
              points: { show: (u, i) => u.data[0].length < u.width / 8, size: 4 },
              value: (u) => this.at(u, s),
            })),
          ],
          bands: (spec.bands ?? []).map((b) => ({ series: b, fill: () => style("--band") })),
          hooks: {
            drawClear: [shade(() => this.view), message],
            drawSeries: [columns],
            setSelect: [(u) => this.select(u)],
            setCursor: [
              (u) => {
                if (u.cursor.left >= 0 && !this.busy) this.cursor(u);
              },
            ],
          },
        },
        [[], ...spec.series.map(() => [])],
        holder,
      );
      chart.over.addEventListener("dblclick", () => this.zoom(...this.full));
      return chart;
    });
    this.refill();
  }

  // The range of a panel, from valid rows, so that the start does not hide the rest.
  scale({ series }) {
    let low = Infinity,
      high = -Infinity;
    for (const { name, map } of series)
      for (const v of this.view.extent(name, ...this.window)) {
        const y = map ? map(v) : v;
        if (y < low) low = y;
        if (y > high) high = y;
      }
    return low <= high && Number.isFinite(low) && Number.isFinite(high)
      ? uPlot.rangeNum(low, high, 0.1, true)
      : [-1, 1];
  }

  // The row under the cursor of a panel.
  under(u) {
    const { view } = this;
    if (this.going || !(u.cursor.left >= 0)) return this.row;
    const time = u.posToVal(u.cursor.left, "x") + (view.t[1] - view.t[0]) / 2;
    return Math.min(view.rows - 1, Math.max(0, view.row(time)));
  }

  // Time and value of that row, as text.
  time(u) {
    const row = this.under(u);
    return row == null ? "" : `${this.view.t[row].toFixed(6)} s`;
  }
  at(u, { name, less, map }) {
    const row = this.under(u);
    if (row == null || !this.view.has(name)) return "";
    const v = this.view.columns[name][row] - (less ? this.view.columns[less][row] : 0);
    return Number.isFinite(v) ? (map ? map(v) : v).toPrecision(5) : "";
  }

  // Show these seconds, like a strip chart; redraw only the panels for which `wanted` is true.
  roll(from, to, wanted) {
    this.full = [this.view.t[0], this.view.t[this.view.rows - 1]];
    this.window = [from, to];
    this.fill(wanted, 2);
  }

  refill(quick = false) {
    const began = performance.now();
    this.fill();
    this.drawn = performance.now() - began;
    this.describe();
    const under = this.charts.find((one) => one.cursor.left >= 0);
    if (under && !this.going) setTimeout(() => this.cursor(under)); // after the new scales are set
    if (!quick || this.row != null) this.onWindow(...this.window);
  }

  fill(wanted = () => true, coarse = 1) {
    this.busy = true;
    this.charts.forEach((chart, n) => {
      if (!wanted(this.specs[n])) return;
      const { series } = this.specs[n],
        width = Math.round(chart.width / coarse);
      const data = this.view.sample(
        series.map((s) => s.name),
        ...this.window,
        width,
        series.map((s) => s.map),
      );
      chart.thinned = data[0].length === 2 * width;
      const turns = this.specs[n].turning ? this.view.turns(...this.window) : 0;
      chart.message =
        turns > MOST_TURNS ? `${Math.round(turns)} electrical turns: zoom in to see the angle` : "";
      if (chart.message) for (const values of data.slice(1)) values.fill(null);
      chart.setData(data, true);
    });
    this.busy = false;
  }

  describe() {
    this.charts.forEach((chart, n) => {
      const { title, unit, series } = this.specs[n],
        words = series.slice(0, 2).map((s) => {
          const { least, most } = this.view.statistics(s.name, ...this.window),
            [a, b] = [least, most].map(s.map ?? ((v) => v));
          return `${s.label} from ${a.toPrecision(3)} to ${b.toPrecision(3)} ${unit}`;
        });
      chart.root.parentElement.setAttribute(
        "aria-label",
        `${title} over time, ${this.window[0].toPrecision(4)} to ${this.window[1].toPrecision(4)} s: ${words.join("; ")}. Arrow keys move the cursor, plus and minus zoom, Home shows all.`,
      );
    });
  }

  select(u) {
    if (u.select.width < 3) return;
    const from = u.posToVal(u.select.left, "x"),
      to = u.posToVal(u.select.left + u.select.width, "x");
    this.charts.forEach((one) => one.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false));
    this.zoom(from, to);
  }

  zoom(from, to) {
    const least = 4 * Math.abs(this.view.t[1] - this.view.t[0] || 1e-6),
      middle = (from + to) / 2,
      half = Math.max(to - from, least) / 2;
    this.window = [Math.max(this.full[0], middle - half), Math.min(this.full[1], middle + half)];
    this.refill();
  }

  cursor(u) {
    const row = this.under(u);
    if (row === this.row) return;
    this.row = row;
    this.onCursor(row);
  }

  // Move the cursor to a row in all panels.
  go(row) {
    this.going = true;
    this.row = Math.min(this.view.rows - 1, Math.max(0, row));
    const time = this.view.t[this.row];
    if (time < this.window[0] || time > this.window[1]) {
      const half = (this.window[1] - this.window[0]) / 2;
      this.zoom(time - half, time + half);
    }
    this.busy = true;
    this.charts.forEach((one) => one.setCursor({ left: one.valToPos(time, "x"), top: 10 }));
    this.busy = this.going = false;
    this.onCursor(this.row);
  }

  // Zoom around the cursor, or around the middle.
  closer(factor) {
    const [from, to] = this.window,
      middle = this.row == null ? (from + to) / 2 : this.view.t[this.row],
      half = (to - from) / 2 / factor;
    this.zoom(middle - half, middle + half);
  }

  key(event) {
    const {
        view,
        window: [from, to],
      } = this,
      middle = (from + to) / 2;
    const step = event.shiftKey
        ? 1
        : Math.max(1, Math.round((view.row(to) - view.row(from)) / 200)),
      row = this.row ?? view.row(middle);
    const keys = {
      ArrowRight: () => this.go(row + step),
      ArrowLeft: () => this.go(row - step),
      "+": () => this.closer(2),
      "=": () => this.closer(2),
      "-": () => this.closer(0.5),
      Home: () => this.zoom(...this.full),
    };
    if (!keys[event.key]) return;
    event.preventDefault();
    keys[event.key]();
  }

  resize() {
    if (this.view) {
      this.charts.forEach((one) => one.setSize({ width: this.width, height: one.height }));
      this.refill(true);
    }
  }
}

// The locus of the flux over the window, with the row at the cursor.
export class Locus {
  constructor(canvas) {
    this.canvas = canvas;
  }
  draw(view, [from, to], ports, row) {
    let [x, y] = ports.map((port) => view.columns[`flux_${port}`]),
      what = "Flux λ";
    if (!x && view.has("theta_e") && view.has("psi_f")) {
      // a report without the flux shows the vector λ − L i, from its angle and length
      const { theta_e: angle, psi_f: length } = view.columns,
        made = (turn) => new Proxy(angle, { get: (_, k) => length[k] * turn(angle[k]) });
      [x, y, what] = [made(Math.cos), made(Math.sin), "Vector λ − L i"];
    }
    const { canvas } = this,
      size = canvas.clientWidth,
      scale = devicePixelRatio,
      ctx = canvas.getContext("2d");
    if (!x || !size) return;
    canvas.width = canvas.height = size * scale;
    const first = view.row(from),
      last = view.row(to) + 1,
      step = Math.max(1, Math.floor((last - first) / 6000));
    const { valid } = view.columns,
      [, some] = valid ? view.range("valid", first, last) : [0, 0],
      shown = (k) => (!some || valid[k]) && Number.isFinite(x[k]); // all rows if none is valid
    let most = 1e-12;
    for (let k = first; k < last; k += step)
      if (shown(k)) most = Math.max(most, Math.abs(x[k]), Math.abs(y[k]));
    const edge = 1.15 * most,
      [factor, unit] = prefixed(edge, "Wb");
    const at = (v, up) => ((up ? -v : v) / edge + 1) * (size / 2);
    ctx.scale(scale, scale);
    ctx.strokeStyle = style("--line");
    ctx.beginPath();
    ctx.moveTo(0, size / 2);
    ctx.lineTo(size, size / 2);
    ctx.moveTo(size / 2, 0);
    ctx.lineTo(size / 2, size);
    ctx.stroke();
    ctx.fillStyle = style("--ink");
    ctx.font = "11px system-ui";
    ctx.fillText(`${what}; edge ${(edge / factor).toPrecision(3)} ${unit}`, 6, 14);
    ctx.strokeStyle = style("--blue");
    ctx.lineWidth = 1;
    ctx.beginPath();
    for (let k = first, gap = true; k < last; k += step) {
      if (!shown(k)) gap = true;
      else {
        const [a, b] = [at(x[k]), at(y[k], true)];
        if (gap) ctx.moveTo(a, b);
        else ctx.lineTo(a, b);
        gap = false;
      }
    }
    ctx.stroke();
    if (row == null) return;
    ctx.strokeStyle = ctx.fillStyle = style("--red");
    ctx.lineWidth = 2;
    ctx.beginPath();
    ctx.moveTo(size / 2, size / 2);
    ctx.lineTo(at(x[row]), at(y[row], true));
    ctx.stroke();
    ctx.beginPath();
    ctx.arc(at(x[row]), at(y[row], true), 4, 0, 2 * Math.PI);
    ctx.fill();
    canvas.setAttribute(
      "aria-label",
      `${what}, locus; at the cursor ${(x[row] / factor).toPrecision(4)} and ${(y[row] / factor).toPrecision(4)} ${unit}`,
    );
  }
}
