// Results of a run as plots, text and sliders, for the page and for reports.

import { Locus, Panels, View, prefixed } from "./plots.js";

const deg = (v) => (v * 180) / Math.PI;
export const element = (tag, attributes = {}, ...children) => {
  const out = Object.assign(document.createElement(tag), attributes);
  for (const [name, value] of Object.entries(attributes))
    if (name.includes("-") || name === "for" || name === "role") out.setAttribute(name, value);
  out.append(...children.filter((one) => one != null));
  return out;
};

// Make a button switch between the light and the dark theme.
export function themed(button, panels, then) {
  button.addEventListener("click", () => {
    const { dataset } = document.documentElement;
    const dark = matchMedia("(prefers-color-scheme: dark)").matches;
    dataset.theme = (dataset.theme ?? (dark ? "dark" : "light")) === "dark" ? "light" : "dark";
    panels.forEach((one) => one.resize());
    then();
  });
}

// Format a number with three digits and an SI prefix.
export function si(value, unit) {
  if (!Number.isFinite(value)) return "–";
  const [factor, named] = prefixed(value, unit);
  return `${Number((value / factor).toPrecision(3))} ${named}`;
}

// Parameters that a run may estimate: [name, title, unit].
const PARAMETERS = [
  ["resistance", "Resistance", "Ω"],
  ["inverter_voltage", "Inverter voltage", "V"],
  ["psi_f", "Magnet flux", "Wb"],
];

// Add the edges of a ± 2σ band for columns with a standard deviation.
export function banded(columns) {
  for (const [name] of PARAMETERS) {
    const std = columns[`${name}_std`];
    if (!std) continue;
    columns[`${name} +`] = columns[name].map((v, k) => v + 2 * std[k]);
    columns[`${name} -`] = columns[name].map((v, k) => v - 2 * std[k]);
  }
  return columns;
}

// Names of the columns of the error budget.
const layer = (n) => `budget ${n}`;

// Add the layers of the error budget, stacked, at the rows of the columns.
export function budgeted(columns, budget) {
  if (!budget) return columns;
  const { t, layers } = budget,
    rows = columns.t.length,
    stacked = layers.map(() => new Float64Array(rows));
  for (let k = 0, at = 0; k < rows; k++) {
    while (
      at + 1 < t.length &&
      Math.abs(t[at + 1] - columns.t[k]) <= Math.abs(t[at] - columns.t[k])
    )
      at++;
    let sum = 0;
    layers.forEach((variances, n) => (stacked[n][k] = sum += variances[at]));
  }
  return { ...columns, ...Object.fromEntries(stacked.map((values, n) => [layer(n), values])) };
}

// The panel of the error budget: variance of the position by cause.
function budgetPanel(view, { budget }) {
  if (!budget || !view.has(layer(0))) return [];
  const factor = deg(1) ** 2;
  return [
    {
      id: "budget",
      title: "σ² by cause",
      unit: "°²",
      // the highest layer first: each fills the space down to zero
      series: budget.names
        .map((label, n) => ({
          name: layer(n),
          less: n ? layer(n - 1) : undefined,
          label,
          color: `--layer-${n}`,
          fill: `--layer-${n}`,
          map: (v) => factor * v,
        }))
        .reverse(),
    },
  ];
}

// Units of panels that get the prefix of their values.
const PREFIXED = ["V", "A", "Ω", "Wb", "m"];

// Give a panel the prefix that suits its valid rows.
function scaled(view, spec) {
  if (!PREFIXED.includes(spec.unit)) return spec;
  const same = (v) => v,
    ends = spec.series.flatMap(({ name, map = same }) =>
      view.extent(name, view.t[0], view.t[view.rows - 1]).map((v) => Math.abs(map(v))),
    ),
    [factor, unit] = prefixed(Math.max(...ends.filter(Number.isFinite)), spec.unit);
  return {
    ...spec,
    unit,
    series: spec.series.map((s) => ({ ...s, map: (v) => (s.map ?? same)(v) / factor })),
  };
}

// A panel of two components, if the view has them.
function pair(view, id, title, unit, names, labels) {
  if (!names.every((name) => view.has(name))) return [];
  const series = names.map((name, n) => ({
    name,
    label: labels[n],
    color: n ? "--orange" : "--blue",
  }));
  return [{ id, title, unit, series }];
}

// The panels of a run.
export function panels(view, found) {
  const { position } = found,
    [a, b] = found.ports,
    angle = position.unit === "°";
  const factor = (v) => v * position.factor;
  const out = [],
    drawn = [
      {
        id: "position",
        title: position.title,
        unit: position.unit,
        turning: angle,
        series: [
          { name: position.name, label: "estimated", color: "--blue", map: factor },
          ...(view.has("truth")
            ? [{ name: "truth", label: "true", color: "--orange", map: factor, dash: [6, 4] }]
            : []),
        ],
      },
    ];
  const error = `${position.name}_error`,
    std = `${position.name}_std`;
  if (view.has(error))
    out.push({
      id: "error",
      title: "Position error",
      unit: position.unit,
      bands: [[2, 3]],
      series: [
        { name: error, label: "error", color: "--blue", map: factor },
        ...(view.has(std)
          ? [
              { name: std, label: "± 2σ", color: "--grey", map: (v) => 2 * factor(v) },
              { name: std, unlisted: true, color: "--grey", map: (v) => -2 * factor(v) },
            ]
          : []),
      ],
    });
  else if (view.has(std))
    out.push({
      id: "sigma",
      title: "Position σ",
      unit: position.unit,
      series: [{ name: std, label: "σ", color: "--blue", map: factor }],
    });
  if (view.has("speed_e")) {
    const rpm = found.n_p ? 30 / Math.PI / found.n_p : 1;
    out.push({
      id: "speed",
      title: found.n_p ? "Speed" : "Electrical speed",
      unit: found.n_p ? "rpm" : "rad/s",
      series: [
        {
          name: "speed_e",
          label: found.n_p
            ? `speed; 1000 rpm are ${Math.round(1000 / rpm)} rad/s electrical`
            : "speed",
          color: "--blue",
          map: (v) => rpm * v,
        },
      ],
    });
  }
  const axes = angle ? ["d", "q"] : [a, b];
  for (const [id, title, unit] of [
    ["i", "Current", "A"],
    ["u", "Voltage", "V"],
  ])
    out.push(
      ...pair(
        view,
        title.toLowerCase(),
        title,
        unit,
        axes.map((axis) => `${id}_${axis}`),
        axes,
      ),
    );
  out.push(...drawn, ...budgetPanel(view, found));
  const greek = { alpha: "α", beta: "β" };
  out.push(
    ...pair(
      view,
      "drift",
      "Drift",
      "V",
      found.ports.map((port) => `drift_${port}`),
      found.ports.map((port) => greek[port] ?? port),
    ),
  );
  for (const [name, named, unit] of PARAMETERS) {
    if (!view.has(name)) continue;
    const bands = view.has(`${name} +`),
      title = name === "psi_f" && !found.adaptive ? "Length of λ − L i" : named;
    out.push({
      id: name,
      title,
      unit,
      bands: bands ? [[2, 3]] : [],
      series: [
        { name, label: title === named ? named.toLowerCase() : "length", color: "--blue" },
        ...(bands
          ? [
              { name: `${name} +`, label: "± 2σ", color: "--grey" },
              { name: `${name} -`, unlisted: true, color: "--grey" },
            ]
          : []),
      ],
    });
  }
  if (view.has("innovation"))
    out.push({
      id: "residual",
      title: "Residual",
      unit: "σ",
      series: [{ name: "innovation", label: "residual", color: "--blue" }],
    });
  return out.map((spec) => scaled(view, spec));
}

// Sliders: [name in the machine file, label, unit].
const SLIDERS = [
  ["R_s", "R_s", "Ω"],
  ["L_s", "L_s", "H"],
  ["L_d", "L_d", "H"],
  ["L_q", "L_q", "H"],
  ["L_sigma", "L_σ", "H"],
  ["R_R", "R_R", "Ω"],
  ["psi_f", "ψ_f", "Wb"],
  ["psi_R", "ψ_R", "Wb"],
  ["inverter_voltage", "Inverter voltage", "V"],
];

export class Results {
  constructor(box, ask) {
    this.ask = ask;
    this.box = box;
    this.words = element("div", { className: "words" });
    this.canvas = element("canvas", {
      className: "locus",
      role: "img",
      tabIndex: 0,
      "aria-label": "Flux locus",
    });
    this.sliders = element("div", { className: "sliders" });
    this.charts = element("div", { className: "charts" });
    this.table = element("table", { className: "values" });
    this.note = element("p", { className: "note", role: "status", "aria-live": "polite" });
    const button = (textContent, label, onclick) =>
      element("button", { type: "button", textContent, "aria-label": label, onclick });
    const zooms = [
      button("+", "Zoom in", () => this.panels.closer(2)),
      " ",
      button("−", "Zoom out", () => this.panels.closer(0.5)),
      " ",
      button("Show all", "Show all", () => this.panels.zoom(...this.panels.full)),
    ];
    box.replaceChildren(
      this.words,
      element(
        "section",
        { className: "picture" },
        element(
          "div",
          { className: "side" },
          this.canvas,
          element("h3", { textContent: "Change parameters" }),
          this.sliders,
          this.note,
        ),
        element(
          "div",
          { className: "main" },
          element(
            "p",
            { className: "hint" },
            ...zooms,
            " Drag over a plot to zoom, double-click to show all. A shaded background marks rows without a valid position, a red strip rows with a fault.",
          ),
          this.charts,
        ),
      ),
      element(
        "details",
        { open: false },
        element("summary", { textContent: "Values at the cursor and in the window, as a table" }),
        this.table,
      ),
    );
    this.locus = new Locus(this.canvas);
    this.panels = new Panels(this.charts, {
      onWindow: () => this.window(),
      onCursor: (row) => this.cursor(row),
    });
  }

  show(found, columns) {
    this.found = found;
    this.first = columns;
    this.changed = {};
    this.view = new View(budgeted(banded(columns), found.budget));
    this.panels.show(this.view, panels(this.view, found));
    if (this.ask) this.makeSliders();
  }

  // Show other columns of the same rows.
  swap(columns) {
    this.view = new View(banded(columns));
    this.panels.show(this.view, panels(this.view, this.found), true);
    this.window();
  }

  window() {
    if (!this.view) return;
    this.locus.draw(this.view, this.panels.window, this.found.ports, this.panels.row);
    this.values();
  }
  cursor(row) {
    cancelAnimationFrame(this.frame);
    this.frame = requestAnimationFrame(() => {
      this.locus.draw(this.view, this.panels.window, this.found.ports, row);
      this.values();
    });
  }

  values() {
    const rows = this.panels.specs
      .flatMap((spec) =>
        spec.series.filter((s) => !s.fill && s.color !== "--grey").map((s) => [spec, s]),
      )
      .map(([spec, s]) => {
        const map = s.map ?? ((v) => v),
          { mean, rms, least, most } = this.view.statistics(s.name, ...this.panels.window),
          row = this.panels.row;
        const turns = spec.id === "position" && spec.unit === "°"; // an angle has no mean
        const cells = [
          row == null ? NaN : this.view.columns[s.name][row],
          turns ? NaN : mean,
          turns ? NaN : rms,
          least,
          most,
        ].map((v) => (Number.isFinite(v) ? map(v).toPrecision(5) : "–"));
        const alone = spec.series.every((other) => other === s || other.color === "--grey"),
          label = alone ? "" : `, ${s.label}`;
        return element(
          "tr",
          {},
          element("th", {
            scope: "row",
            textContent: `${spec.title}${label}${spec.unit ? ` [${spec.unit}]` : ""}`,
          }),
          ...cells.map((c) => element("td", { textContent: c })),
        );
      });
    const head = element(
      "tr",
      {},
      ...[
        "",
        this.panels.row == null
          ? "at the cursor"
          : `at ${this.view.t[this.panels.row].toFixed(6)} s`,
        "mean",
        "rms",
        "minimum",
        "maximum",
      ].map((c) => element("th", { scope: "col", textContent: c })),
    );
    this.table.replaceChildren(
      element("caption", {
        textContent: `Valid rows from ${this.panels.window.map((t) => t.toPrecision(5)).join(" to ")} s`,
      }),
      element("thead", {}, head),
      element("tbody", {}, ...rows),
    );
  }

  explain({ summary, warnings = [], findings = [], check_notes: notes = [] }) {
    this.changedRow = element(
      "tr",
      { hidden: this.changedRow?.hidden ?? true, className: "changed" },
      element("th", { scope: "row", textContent: "with sliders" }),
      element("td", { textContent: this.changedRow?.lastChild.textContent ?? "" }),
    );
    this.words.replaceChildren(
      element(
        "table",
        { className: "summary" },
        element(
          "tbody",
          {},
          this.changedRow,
          ...summary.map(([label, value]) =>
            element(
              "tr",
              {},
              element("th", { scope: "row", textContent: label }),
              element("td", { textContent: value }),
            ),
          ),
        ),
      ),
      ...warnings.map((text) =>
        element("p", { className: "warning", role: "alert", textContent: text }),
      ),
      ...(findings.length
        ? [
            element(
              "details",
              { className: "verdicts", open: findings.some((one) => !one.as_given) },
              element("summary", {
                textContent: `Does the log agree with the machine file and the options? ${findings.every((one) => one.as_given) ? "Yes, as far as the log can show." : "Not in every respect."}`,
              }),
              element(
                "table",
                {},
                element(
                  "tbody",
                  {},
                  ...findings.map((one) =>
                    element(
                      "tr",
                      { className: one.as_given ? "good" : "bad" },
                      element("th", { scope: "row", textContent: one.kind }),
                      element("td", { textContent: one.as_given ? "as given" : "NOT as given" }),
                      element("td", {
                        textContent: [
                          one.words,
                          one.sure,
                          one.others.length ? `Fits equally well: ${one.others.join("; ")}` : "",
                        ]
                          .filter(Boolean)
                          .map((text) => text[0].toUpperCase() + text.slice(1))
                          .join(". "),
                      }),
                    ),
                  ),
                ),
              ),
              ...notes.map((text) => element("p", { textContent: text })),
            ),
          ]
        : []),
    );
  }

  makeSliders() {
    const { values, memory } = this.found.parameters,
      given = Object.fromEntries(
        SLIDERS.filter(([name]) =>
          name === "inverter_voltage" ? name in values : values[name] != null,
        ).map(([name]) => [name, values[name]]),
      );
    const rows = [];
    const add = (key, label, unit, value, [low, high], logarithmic) => {
      const id = `slider-${key}`,
        out = element("output", { for: id, textContent: si(value, unit) });
      const to = logarithmic ? (x) => value * 2 ** x : (x) => x,
        from = logarithmic ? () => 0 : () => value;
      const input = element("input", {
        id,
        type: "range",
        min: low,
        max: high,
        step: "any",
        value: from(),
      });
      input.addEventListener("input", () => {
        const v = to(Number(input.value));
        out.textContent = key === "lag" ? `${v.toFixed(2)} samples` : si(v, unit);
        this.changed[key] = v;
        this.recompute();
      });
      if (key === "lag") out.textContent = `${value.toFixed(2)} samples`;
      rows.push(
        element(
          "div",
          { className: "slider" },
          element("label", { for: id, textContent: label }),
          input,
          out,
        ),
      );
    };
    for (const [name, label, unit] of SLIDERS) {
      if (!(name in given)) continue;
      if (name === "inverter_voltage")
        add(name, label, unit, given[name] ?? 0, [0, Math.max(2, 4 * (given[name] ?? 0))], false);
      else add(name, label, unit, given[name], [-1.5, 1.5], true);
    }
    add("memory", "Memory", "s", this.found.memory ?? memory, [-3, 3], true);
    add("lag", "Lag", "", this.found.lag, [this.found.lag - 2, this.found.lag + 2], false);
    const back = element("button", {
      type: "button",
      textContent: "Reset to given values",
      onclick: () => {
        this.changed = {};
        this.makeSliders();
        this.swap(this.first);
        this.changedRow.hidden = true;
        this.note.textContent = "";
      },
    });
    const learnt = this.found.adaptive
      ? "Each run learns R_s, ψ_f and the inverter voltage from the log, as far as they are identifiable; the sliders set their starting values."
      : null;
    this.sliders.replaceChildren(
      ...(learnt ? [element("p", { className: "note", textContent: learnt })] : []),
      ...rows,
      back,
    );
  }

  // Allow one run at a time; a request during a run waits for its end.
  async recompute() {
    if (this.running) {
      this.waiting = true;
      return;
    }
    this.running = true;
    const began = performance.now(),
      { memory, lag, ...changes } = this.changed;
    try {
      const { columns } = await this.ask("again", {
        changes,
        memory,
        lag,
        unknowns: this.found.unknowns,
      });
      this.swap(columns);
      this.took = performance.now() - began;
      this.changedRow.hidden = false;
      this.changedRow.lastChild.textContent = this.judged(columns);
      this.note.textContent = "";
    } catch (error) {
      this.note.textContent = error.message;
    }
    this.running = false;
    if (this.waiting) {
      this.waiting = false;
      this.recompute();
    }
  }

  // Summarise the run with these parameters in one line.
  judged(columns) {
    const valid = columns.valid,
      error = columns[`${this.found.position.name}_error`],
      { factor, unit } = this.found.position;
    let known = 0,
      square = 0,
      scored = 0,
      residual = 0;
    for (let k = 0; k < valid.length; k++)
      if (valid[k]) {
        known++;
        if (error && error[k] === error[k]) {
          scored++;
          square += error[k] ** 2;
        }
        if (columns.innovation) residual += columns.innovation[k] ** 2;
      }
    const parts = [`valid on ${((100 * known) / valid.length).toFixed(1)} % of the rows`];
    if (scored)
      parts.push(`error ${(factor * Math.sqrt(square / scored)).toPrecision(3)}${unit} rms`);
    if (columns.innovation && known)
      parts.push(`residual ${Math.sqrt(residual / known).toPrecision(3)} of its noise`);
    return `${parts.join("; ")}; the rows below are those of the values as given`;
  }
}
