// The page: from a log and a machine to estimates, findings and files.

import { parts, start } from "./ask.js";
import { Live, serial, socket } from "./live.js";
import { Recent } from "./plots.js";
import { Results, element, themed } from "./results.js";

const $ = (id) => document.getElementById(id);
const state = { files: [], known: null, found: null };

// Messages name the flags of the command line; here, the fields of the form.
const FIELDS = {
  frame: "Frame",
  lag: "Lag",
  "sample-time": "Sample time",
  from: "From",
  to: "To",
  header: "Header",
  column: "Columns",
  unit: "Units",
  scale: "Scales",
  offset: "Offsets",
  adc: "Converters",
  truth: "Truth",
  unknowns: "Unknowns",
  memory: "Memory",
  preset: "Tool",
};
const worded = (text) =>
  text.replace(/--([a-z-]+)/g, (flag, name) => (FIELDS[name] ? `“${FIELDS[name]}”` : flag));

function say(text, kind = "") {
  const box = $("status");
  box.textContent = worded(text);
  box.className = kind;
}
function fail(error) {
  say(error.message, "error");
  $("progress").hidden = true;
  console.error(error, error.workerStack ?? "");
}

const ask = await start((share) => {
  $("progress").hidden = false;
  $("progress").value = share;
});
const results = new Results($("results"), (action, given) => ask(action, given));
state.known = await ask("machines");

// ---- the machine ----------------------------------------------------------------------------

for (const name of Object.keys(state.known.examples))
  $("example").append(element("option", { value: name, textContent: name }));
$("example").addEventListener("change", () => {
  if ($("example").value) {
    $("machine").value = state.known.examples[$("example").value];
    again();
  }
});
$("machine").addEventListener("change", () => again());
$("machine-file").addEventListener("change", async (event) => {
  const [file] = event.target.files;
  if (file) {
    await openMachine(file);
    again();
  }
});
async function openMachine(file) {
  $("machine").value = await file.text();
  $("example").value = "";
}

for (const kind of Object.keys(state.known.kinds))
  if (kind !== "maglev-2dof")
    $("kind").append(element("option", { value: kind, textContent: kind }));
// SI prefixes as the user may type them: 35 mΩ, 20 µH, 900.
const PREFIX = { n: 1e-9, u: 1e-6, µ: 1e-6, μ: 1e-6, m: 1e-3, k: 1e3 };
const SHEET = {
  kv: "KV in rpm/V",
  poles: "Poles",
  n_p: "Pole pairs",
  R_line: "R between terminals in Ω",
  L_line: "L between terminals in H",
  rated_current_rms: "Rated current in A rms",
  K_e: "K_e in V/krpm",
  K_t: "K_t in Nm/A",
  rated_speed_rpm: "Rated speed in rpm",
};
for (const [name, label] of Object.entries(SHEET))
  $("sheet-fields").append(
    element(
      "label",
      {},
      label,
      element("input", {
        name,
        inputMode: "decimal",
        placeholder: name.startsWith("R_") ? "e.g. 70 m" : name.startsWith("L_") ? "e.g. 60 µ" : "",
      }),
    ),
  );
$("sheet").addEventListener("submit", async (event) => {
  event.preventDefault();
  const fields = {};
  for (const { name, value } of $("sheet").querySelectorAll("input")) {
    if (!value.trim()) continue;
    const found = /^\s*([-+]?[\d.,]+(?:e[-+]?\d+)?)\s*([nuµμmk]?)\s*[a-zA-ZΩ/]*\s*$/i.exec(value);
    if (!found) {
      $("assumed").textContent = `${SHEET[name]}: ${value} is not a number`;
      return;
    }
    fields[name] = Number(found[1].replace(",", ".")) * (PREFIX[found[2]] ?? 1);
  }
  try {
    const { text, assumed } = await ask("sheet", { kind: $("kind").value, fields });
    $("machine").value = text;
    $("example").value = "";
    $("assumed").textContent = assumed.length ? `Assumed: ${assumed.join("; ")}.` : "";
    again();
  } catch (error) {
    $("assumed").textContent = error.message;
  }
});

// ---- the log ----------------------------------------------------------------------------------

// Open files that were chosen or dropped: a log, a machine file, or both.
async function open(all) {
  const files = all.filter((file) => !file.name.toLowerCase().endsWith(".toml"));
  for (const file of all) if (!files.includes(file)) await openMachine(file);
  if (!files.length) {
    if (all.length) again();
    return;
  }
  if (state.files[0] === DEMO && files[0].name !== DEMO) $("lag").value = "";
  state.chosen = performance.now();
  say(`Reading ${files.map((one) => one.name).join(", ")} …`);
  try {
    const read = [];
    for (const file of files) {
      const packed = file.name.toLowerCase().endsWith(".gz");
      const stream = packed ? file.stream().pipeThrough(new DecompressionStream("gzip")) : null;
      read.push({
        name: file.name,
        bytes: await (packed ? new Response(stream).arrayBuffer() : file.arrayBuffer()),
      });
    }
    state.files = read.map((one) => one.name);
    await ask(
      "open",
      { files: read },
      read.map((one) => one.bytes),
    );
    $("opened").textContent = state.files.join(", ");
    document.body.classList.add("opened");
    await again();
  } catch (error) {
    fail(error);
  }
}

const zone = $("drop");
zone.addEventListener("dragover", (event) => {
  event.preventDefault();
  zone.classList.add("over");
});
zone.addEventListener("dragleave", () => zone.classList.remove("over"));
addEventListener("dragover", (event) => event.preventDefault());
addEventListener("drop", (event) => {
  event.preventDefault();
  zone.classList.remove("over");
  open([...event.dataTransfer.files]);
});
$("files").addEventListener("change", (event) => {
  const files = [...event.target.files];
  event.target.value = "";
  open(files);
}); // cleared, so that the same file can be chosen and read again
$("demo").addEventListener("click", async () => {
  $("example").value = "servo-400w";
  $("machine").value = state.known.examples["servo-400w"];
  $("lag").value = "0"; // its drive is known, and this excerpt is too short to tell it
  open([new File([parts.demo], DEMO)]);
});

// ---- options --------------------------------------------------------------------------------

for (const name of state.known.presets)
  $("preset").append(element("option", { value: name, textContent: name }));

// Read the options of the form, with the names of Python's arguments.
function options() {
  const number = (id) => {
    const text = $(id).value.trim().replace(",", ".");
    if (!text) return null;
    if (!Number.isFinite(Number(text))) throw new Error(`${id}: ${text} is not a number`);
    return Number(text);
  };
  const pairs = (id) =>
    Object.fromEntries(
      $(id)
        .value.split(/[\n;]+|,\s*(?=\w+\s*=)/)
        .map((one) => one.trim())
        .filter(Boolean)
        .map((one) => {
          const at = one.indexOf("=");
          if (at < 1) throw new Error(`${id}: expected CHANNEL=VALUE, got ${one}`);
          return [one.slice(0, at).trim(), one.slice(at + 1).trim()];
        }),
    );
  const numbers = (id) =>
    Object.fromEntries(
      Object.entries(pairs(id)).map(([k, v]) => {
        if (!Number.isFinite(Number(v))) throw new Error(`${id}: ${v} is not a number`);
        return [k, Number(v)];
      }),
    );
  return {
    options: {
      preset: $("preset").value || null,
      frame: $("frame").value || null,
      lag: number("lag"),
      sample_time: number("sample-time"),
      header: $("header").value.trim() || null,
      columns: pairs("columns"),
      unit: pairs("unit"),
      scale: numbers("scale"),
      offset: numbers("offset"),
      adc: pairs("adc"),
      truth: pairs("truth"),
      start: number("from"),
      stop: number("to"),
    },
    unknowns: $("unknowns").value,
    memory: number("memory"),
    causal: $("causal").checked,
  };
}

const DEMO = "demo-excerpt.csv"; // only its first rows are in the page
const quoted = (word) =>
  /^[\w@%+=:,./-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\"'\"'")}'`;
function command(given) {
  if (state.files[0] === DEMO) return "fluxobs demo";
  const { options: o, unknowns, memory, causal } = given,
    words = [
      "fluxobs",
      "estimate",
      quoted(state.files[0]),
      "--machine",
      $("example").value || "motor.toml",
    ];
  const one = (flag, value) => {
    if (value !== null && value !== "") words.push(flag, quoted(String(value)));
  };
  for (const file of state.files.slice(1)) one("--join", file);
  one("--preset", o.preset);
  one("--frame", o.frame);
  one("--lag", o.lag);
  one("--sample-time", o.sample_time);
  one("--header", o.header);
  one("--from", o.start);
  one("--to", o.stop);
  for (const [flag, of] of [
    ["--column", o.columns],
    ["--unit", o.unit],
    ["--scale", o.scale],
    ["--offset", o.offset],
    ["--adc", o.adc],
    ["--truth", o.truth],
  ])
    for (const [k, v] of Object.entries(of)) one(flag, `${k}=${v}`);
  if (unknowns !== "auto") one("--unknowns", unknowns);
  one("--memory", memory);
  if (causal) words.push("--causal");
  return [...words, "--out", "estimates.parquet"].join(" ");
}

async function list(given) {
  const { channels, notes } = await ask("channels", { options: given.options });
  const rows = channels.map((one) =>
    element(
      "tr",
      {},
      element("th", { scope: "row", textContent: one.column }),
      ...[
        one.unit,
        one.taken_for,
        one.range ? one.range.map((v) => Number(v.toPrecision(4))).join(" … ") : "–",
        one.first.map((v) => (v === null ? "–" : Number(v.toPrecision(6)))).join(", "),
      ].map((c) => element("td", { textContent: c })),
    ),
  );
  $("listing").replaceChildren(
    element(
      "thead",
      {},
      element(
        "tr",
        {},
        ...["column", "unit", "taken for", "range", "first values"].map((c) =>
          element("th", { scope: "col", textContent: c }),
        ),
      ),
    ),
    element("tbody", {}, ...rows),
  );
  $("listing-notes").textContent = notes.join(". ");
}

let turn = 0;
async function again() {
  if (!state.files.length) return;
  const mine = ++turn;
  try {
    const given = options(),
      machine = $("machine").value;
    if (!machine.trim()) {
      say("Choose or describe the machine to estimate the log.", "hint");
      await list(given);
      return;
    }
    say("Estimating …");
    $("progress").hidden = false;
    $("progress").removeAttribute("value");
    document.body.classList.add("busy");
    const began = performance.now();
    const { columns, ...found } = await ask("estimate", { machine, ...given });
    if (mine !== turn) return;
    state.found = found;
    $("results").hidden = $("files-out").hidden = false;
    results.explain({ summary: found.summary });
    results.show(state.found, columns);
    requestAnimationFrame(() =>
      setTimeout(() => {
        document.body.dataset.seconds = ((performance.now() - state.chosen) / 1000).toFixed(3);
      }),
    ); // after it is drawn
    const seconds = (performance.now() - began) / 1000;
    $("taken").textContent = [
      ...found.notes,
      `${found.rows} rows, ${(1 / found.sample_time).toPrecision(6)} Hz, frame ${found.frame}, lag ${found.lag}`,
    ].join(". ");
    $("command").textContent = command(given);
    say(`Estimated and drawn in ${seconds.toFixed(2)} s. Checking …`);
    await list(given); // the table of columns is not urgent
    const explained = await ask("explain");
    if (mine !== turn) return;
    results.explain({
      ...explained,
      warnings: explained.warnings.map(worded),
      summary: explained.summary.map(([label, value]) => [label, worded(value)]),
    });
    state.explained = explained;
    document.body.classList.remove("busy");
    say(`Estimated and drawn in ${seconds.toFixed(2)} s.`, "good");
    document.body.dataset.done = String(mine);
  } catch (error) {
    if (mine === turn) {
      fail(error);
      document.body.classList.remove("busy");
      document.body.dataset.done = String(mine);
    }
  }
  $("progress").hidden = true;
}
for (const id of [
  "preset",
  "frame",
  "lag",
  "sample-time",
  "header",
  "columns",
  "unit",
  "scale",
  "offset",
  "adc",
  "truth",
  "from",
  "to",
  "unknowns",
  "memory",
  "causal",
])
  $(id).addEventListener("change", () => again());

// ---- files ----------------------------------------------------------------------------------

function download(name, parts, type) {
  const link = element("a", {
    href: URL.createObjectURL(new Blob(parts, { type })),
    download: name,
  });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}
$("save-csv").addEventListener("click", () => {
  const columns = results.first, // with the given values, not those of the sliders
    drawn = (name) =>
      !/ [+-]$|^[iu]_/.test(name) &&
      !["truth", "raw", "innovation", "adapting", "unexplained"].includes(name),
    names = Object.keys(columns).filter(drawn),
    parts = [`${names.join(",")}\n`];
  const flags = names.map((name) => name === "valid"),
    data = names.map((name) => columns[name]);
  for (let first = 0; first < columns.t.length; first += 20_000) {
    const lines = [];
    for (let k = first; k < Math.min(first + 20_000, columns.t.length); k++)
      lines.push(data.map((d, n) => (flags[n] ? (d[k] ? "true" : "false") : d[k])).join(","));
    parts.push(`${lines.join("\n")}\n`);
  }
  download("estimates.csv", parts, "text/csv");
});
$("save-machine").addEventListener("click", async () => {
  try {
    download("motor.toml", [(await ask("machine_file")).text], "text/plain");
  } catch (error) {
    fail(error);
  }
});
$("copy").addEventListener("click", () => navigator.clipboard?.writeText($("command").textContent));

// ---- a stream -------------------------------------------------------------------------------

const live = new Live(
  $("live-view"),
  (action, given, moved) => ask(action, given, moved),
  download,
);
async function watch(open, given) {
  try {
    if (!given.machine.trim()) throw new Error("Choose the machine first, then watch the stream.");
    const source = await open();
    $("live-view").hidden = false;
    say("");
    await live.run(source, given);
  } catch (error) {
    if (error.name !== "NotFoundError") fail(error); // the user chose no port
  }
}
$("serial-port").hidden = !navigator.serial;
$("serial").addEventListener("click", () =>
  watch(() => serial(Number($("baud").value)), { ...options(), machine: $("machine").value }),
);
const served = JSON.parse($("live").textContent);
if (served) {
  $("machine").value = served.machine;
  document.querySelector("main").prepend($("live-view"));
  document.body.classList.add("served");
  watch(() => socket(`ws://${location.host}/stream`, served.name), served);
}

themed($("theme"), [results.panels, live.panels], () => results.window());
document.body.dataset.ready = "1";
window.fluxobs = { state, results, live, ask, Recent };
