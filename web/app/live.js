// Live view: bytes from a serial port or `fluxobs live`, and their estimates as a strip chart.

import { banded, element, panels } from "./results.js";
import { Panels, Recent } from "./plots.js";

const LONGEST = 60, // seconds kept
  SILENT = 2000, // ms without rows before a message says so
  MOST = 1 << 21; // most rows kept
const QUICK = new Set(["position", "speed", "drift"]);
const SPANS = [1, 2, 5, 10, 30, 60];

// Read a serial port until it is closed.
export async function serial(baudRate) {
  const port = await navigator.serial.requestPort();
  await port.open({ baudRate, bufferSize: 1 << 16 });
  const reader = port.readable.getReader();
  return {
    name: "serial port",
    async *pieces() {
      for (let got = await reader.read(); !got.done; got = await reader.read()) yield got.value;
    },
    async close() {
      await reader.cancel();
      reader.releaseLock();
      await port.close();
    },
  };
}

// Read the stream of `fluxobs live`.
export function socket(address, name) {
  const made = new WebSocket(address),
    waiting = [];
  let wake = () => {},
    ended = false;
  made.binaryType = "arraybuffer";
  made.onmessage = ({ data }) => {
    waiting.push(new Uint8Array(data));
    wake();
  };
  made.onclose = () => {
    ended = true;
    wake();
  };
  return {
    name,
    async *pieces() {
      while (waiting.length || !ended) {
        if (waiting.length) yield waiting.shift();
        else await new Promise((resolve) => (wake = resolve));
      }
    },
    close: () => made.close(),
  };
}

function joined(pieces) {
  const out = new Uint8Array(pieces.reduce((sum, one) => sum + one.length, 0));
  let at = 0;
  for (const one of pieces) {
    out.set(one, at);
    at += one.length;
  }
  return out;
}

export class Live {
  constructor(box, ask, download) {
    this.ask = ask;
    this.download = download;
    this.words = element("p", { className: "strong", role: "status", "aria-live": "off" });
    this.notes = element("p", { className: "note" });
    this.now = element("dl", { className: "now" });
    this.charts = element("div", { className: "charts" });
    const button = (textContent, onclick) =>
      element("button", { type: "button", textContent, onclick });
    this.hold = button("Hold", () => this.holding(!this.held));
    this.record = button("Record", () => this.recording(!this.tape));
    this.stop = button("Stop", () => this.source?.close());
    this.span = element(
      "select",
      { id: "span" },
      ...SPANS.map((s) =>
        element("option", { value: s, textContent: `${s} s`, selected: s === 5 }),
      ),
    );
    box.replaceChildren(
      this.words,
      this.now,
      element(
        "p",
        {},
        this.hold,
        " ",
        this.record,
        " ",
        this.stop,
        " ",
        element("label", { className: "inline" }, "Time shown ", this.span),
      ),
      element(
        "p",
        { className: "hint" },
        "Hold stops the plots, so that you can zoom and read values. A shaded background marks rows without a valid position.",
      ),
      this.charts,
      this.notes,
    );
    this.panels = new Panels(this.charts, { onWindow: () => {}, onCursor: () => {} });
  }

  // Estimate a stream until it ends.
  async run(source, given) {
    this.source = source;
    this.view = null;
    this.waiting = [];
    this.tape = null;
    this.holding(false);
    this.stop.disabled = this.record.disabled = false;
    this.frames = 0;
    this.words.textContent = `${source.name}: waiting for its first rows`;
    this.found = await this.ask("watch", given);
    const reading = (async () => {
      for await (const piece of source.pieces()) this.waiting.push(piece);
      this.ended = true;
    })();
    this.ended = false;
    try {
      while (!this.ended || this.waiting.length) {
        await Promise.race([
          new Promise(requestAnimationFrame),
          new Promise((r) => setTimeout(r, 100)),
        ]);
        await this.step();
      }
      await reading;
      await this.step(true);
      this.say(true);
      this.words.textContent += "; the stream has ended";
    } finally {
      await this.recording(false);
      this.stop.disabled = this.record.disabled = true;
      this.source = null;
      source.close();
    }
  }

  // Process the bytes received since the last frame, then draw the next frame.
  async step(last = false) {
    if (this.waiting.length || last) {
      const bytes = joined(this.waiting.splice(0));
      const { columns, status, notes, recorded } = await this.ask("feed", { bytes, last }, [
        bytes.buffer,
      ]);
      this.tape?.push(...recorded);
      this.status = status;
      this.notes.textContent = notes.join(". ");
      if (columns.t?.length) {
        this.add(banded(columns));
        this.came = performance.now();
      }
    }
    if (this.view && !this.held) this.draw();
    this.say();
  }

  add(columns) {
    if (!this.view) {
      const h = columns.t[1] - columns.t[0] || 1e-3;
      const rows = Math.min(MOST, Math.ceil((2 * LONGEST) / h / 128) * 128);
      this.view = new Recent(Object.keys(columns), new Set(["valid"]), rows);
      this.view.append(columns);
      this.panels.show(this.view, panels(this.view, this.found));
      return;
    }
    this.view.append(columns);
  }

  draw() {
    const to = this.view.t[this.view.rows - 1];
    // in each frame, draw the panels that change quickly and one of the other panels
    const others = this.panels.specs.filter(({ id }) => !QUICK.has(id)),
      next = others[this.frames++ % others.length];
    this.panels.roll(
      to - Number(this.span.value),
      to,
      (spec) => QUICK.has(spec.id) || spec === next,
    );
  }

  say(last = false) {
    const { status: s, view } = this,
      now = performance.now();
    if (!s || (now - (this.said ?? 0) < 200 && !last)) return;
    this.said = now;
    const counts = [
      [s.lost, "lost"],
      [s.damaged, "damaged"],
      [s.restarts, "restarts of the sender"],
    ];
    this.words.textContent = [
      `${this.source?.name ?? ""}: ${s.rows} rows, ${((100 * s.valid) / Math.max(1, s.rows)).toFixed(1)} % valid`,
      ...counts.filter(([n]) => n).map(([n, what]) => `${n} ${what}`),
      ...(s.rows && !s.valid
        ? ["not valid yet: if this lasts, record the stream and check the recording"]
        : []),
      ...(s.waiting ? [`waiting: ${s.waiting}`] : []),
      ...(now - this.came > SILENT && !last ? ["no rows for more than 2 s"] : []),
      ...(this.tape ? ["recording"] : []),
    ].join(", ");
    if (!view) return;
    const row = view.rows - 1;
    this.now.replaceChildren(
      ...this.panels.specs.map(({ title, unit, series: [{ name, map = (v) => v }] }) =>
        element(
          "div",
          {},
          element("dt", { textContent: title }),
          element("dd", { textContent: `${map(view.columns[name][row]).toPrecision(4)} ${unit}` }),
        ),
      ),
    );
  }

  holding(on) {
    this.held = on;
    this.hold.textContent = on ? "Go on" : "Hold";
    if (on && this.view) this.panels.refill(true);
  }

  // Start a recording, or end it and save it as a file.
  async recording(on) {
    if (on === Boolean(this.tape)) return;
    await this.ask("record", { on });
    this.record.textContent = on ? "Save the recording" : "Record";
    if (!on) this.download("stream.csv", this.tape, "text/csv");
    this.tape = on ? [] : null;
  }
}
