// A report: text and plots of a run, and runs with other parameters if it contains the record.

import { start, unpack } from "./ask.js";
import { Results, element, themed } from "./results.js";

const $ = (id) => document.getElementById(id);
const began = performance.now();

// Decode bytes from text with seven bits per character (fluxobs/page/columns.py).
const ESCAPED = [0, 13, 60];
function bytesOf(text) {
  const out = new Uint8Array(Math.floor((text.length * 7) / 8));
  for (let n = 0, at = 0, hold = 0, bits = 0; n < text.length; n++) {
    const code = text.charCodeAt(n);
    hold = (hold << 7) | (code < 128 ? code : ESCAPED[code - 128]);
    bits += 7;
    if (bits >= 8) {
      bits -= 8;
      out[at++] = hold >> bits;
      hold &= (1 << bits) - 1;
    }
  }
  return out;
}

// Unpack a column packed by fluxobs/page/columns.py.
const blocks = $("blocks").textContent;
async function column({ kind, size, rows, planes, data: [from, length], missing }) {
  const bytes = await unpack(bytesOf(blocks.substr(from, length)));
  if (kind === "flags")
    return Uint8Array.from({ length: rows }, (_, n) => (bytes[n >> 3] >> (n & 7)) & 1);
  const out = new Float64Array(rows);
  if (kind === "double") {
    const raw = new Uint8Array(out.buffer);
    for (let plane = 0; plane < 8; plane++)
      for (let n = 0, from = plane * rows; n < rows; n++, from++) raw[8 * n + plane] = bytes[from];
    return out;
  }
  let whole = 0;
  for (let n = 0; n < rows; n++) {
    let z = bytes[n];
    if (planes > 1) z |= bytes[rows + n] << 8;
    if (planes > 2) z |= bytes[2 * rows + n] << 16;
    if (planes > 3) z |= bytes[3 * rows + n] << 24;
    whole += (z >>> 1) ^ -(z & 1);
    out[n] = kind === "over" ? whole / size : whole * size;
  }
  if (missing) {
    const gone = await column(missing);
    for (let n = 0; n < rows; n++) if (gone[n]) out[n] = NaN;
  }
  return out;
}
const unpackedColumns = async (packed) =>
  Object.fromEntries(
    await Promise.all(Object.entries(packed).map(async ([name, one]) => [name, await column(one)])),
  );

const table = (caption, head, rows) =>
  element(
    "div",
    { className: "wide" },
    element(
      "table",
      {},
      element("caption", { textContent: caption }),
      element(
        "thead",
        {},
        element("tr", {}, ...head.map((c) => element("th", { scope: "col", textContent: c }))),
      ),
      element(
        "tbody",
        {},
        ...rows.map((row) =>
          element("tr", {}, ...row.map((c) => element("td", { textContent: c }))),
        ),
      ),
    ),
  );

const { words, found, record, columns } = JSON.parse($("data").textContent);
$("title").textContent = words.log;
document.title = `${words.log}: fluxobs`;
$("what").textContent = `${found.rows} rows at ${+(1 / found.sample_time).toPrecision(6)} Hz`;

let ask = null;
const results = new Results($("results"), record ? (action, given) => ask(action, given) : null);
$("words").replaceWith(results.words);
results.explain(words);
const more = [table("Channels", ["channel", "column", "scale and offset"], words.taken)];
more.push(
  element("h3", { textContent: "Machine" }),
  element("pre", {}, element("code", { textContent: words.machine })),
);
if (words.notes.length)
  more.push(
    element("h3", { textContent: "Notes" }),
    element("ul", {}, ...words.notes.map((text) => element("li", { textContent: text }))),
  );
more.push(
  element("h3", { textContent: "Commands" }),
  ...words.commands.map((text) => element("p", {}, element("code", { textContent: text }))),
);
$("more").append(...more);

try {
  if (record) {
    ask = await start((share) => {
      $("progress").hidden = false;
      $("progress").value = share;
    });
    const data = await unpackedColumns(record.columns),
      t = record.t ? await column(record.t) : null;
    const made = await ask("rerun", { ...record, columns: data, t, machine: words.machine });
    results.show(found, made.columns);
    $("status").textContent =
      "Computed in this browser from the record in this file. Move a slider to see the same rows with other parameters.";
  } else {
    results.show(found, await unpackedColumns(columns));
    $("status").textContent =
      "The record is not in this file, so nothing can be recomputed. Curves are rounded to a quarter of their noise.";
  }
} catch (error) {
  $("status").textContent = error.message;
  $("status").className = "error";
  console.error(error, error.workerStack ?? "");
}
$("progress").hidden = true;
document.body.dataset.milliseconds = (performance.now() - began).toFixed(0);
document.body.dataset.done = "1";
themed($("theme"), [results.panels], () => results.window());
window.fluxobs = { results, found, words };
