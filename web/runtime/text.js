// Parse lines of delimited text as numbers: the counterpart of fluxobs/logs/formats/text/parse.py.

// Ask the parser in WebAssembly about a block of bytes.
function $asked(block, question) {
  const at = $wasm.allocate(Math.max(8, block.length));
  $octets(at, block.length).set(block);
  const out = question(at, block.length);
  $wasm.release(at);
  return out;
}
const $countOf = (block, byte) => $asked(block, (at, size) => $wasm.count_of(at, size, byte));
const $hasPair = (block, [one, other]) =>
  $asked(block, (at, size) => $wasm.has_pair(at, size, one, other)) > 0;

const Ragged = $exception("Ragged", ValueError);
// Return the number in a text, correctly rounded; undefined if the text is no number.
function $numberIn(text, comma) {
  const found = $number(comma ? text.replace(",", ".") : text);
  return found === null || (comma && text.includes(".")) ? undefined : found;
}

class Cells {
  constructor(rows, numbers, texts, extra) {
    this.rows = rows;
    this.numbers = numbers;
    this.texts = texts;
    this.extra = extra;
  }

  static of(block, structure, numbers, texts) {
    const width = structure.names.length,
      comma = structure.decimal_comma;
    const rows = $countOf(block, 10) + (block.length && block[block.length - 1] !== 10 ? 1 : 0);
    const slots = new Int32Array(width).fill(-1);
    numbers.forEach((n, k) => {
      slots[n] = k;
    });
    for (const n of texts) slots[n] = -2;
    const memory = [],
      allocate = (size) => {
        const at = $wasm.allocate(Math.max(8, size));
        memory.push(at);
        return at;
      };
    try {
      const text = allocate(block.length),
        at = allocate(4 * width),
        out = allocate(8 * rows * numbers.length),
        found = allocate(4);
      let most = (texts.length + 1) * rows + 64,
        places,
        count;
      do {
        // repeat if the host must read more cells than expected
        places = allocate(16 * most);
        $octets(text, block.length).set(block);
        new Int32Array($wasm.memory.buffer, at, width).set(slots);
        count = $wasm.part(
          text,
          block.length,
          structure.delimiter.charCodeAt(0),
          comma ? 44 : 46,
          width,
          at,
          out,
          rows,
          places,
          most,
          found,
        );
        most = (width + 2) * rows + 64;
      } while (count < 0 && memory.length < 8);
      if (count < 0) throw Ragged("a line with too many cells");
      const values = numbers.map((_, k) => $numbers(out + 8 * rows * k, rows).slice()),
        holes = numbers.map(() => []);
      const words = new Map(texts.map((n) => [n, new Array(rows).fill(null)])),
        extra = [];
      const list = new Uint32Array($wasm.memory.buffer, places, 4 * count).slice(),
        done = new Uint32Array($wasm.memory.buffer, found, 1)[0];
      for (let k = 0; k < list.length; k += 4) {
        const [row, column, begin, end] = list.subarray(k, k + 4);
        let word = $decoded(block.subarray(begin, end), "utf-8", "replace");
        const quoted = word[0] === '"';
        if (quoted) word = word.slice(1, word.lastIndexOf('"')).replaceAll('""', '"');
        if (column > width && $strings.strip(word)) throw Ragged("a line with too many cells");
        if (column === width) {
          if ($strings.strip(word)) extra.push(row);
          continue;
        }
        if (column > width) continue;
        const slot = slots[column];
        if (slot === -2) {
          if (word || quoted) words.get(column)[row] = word;
          continue;
        }
        const value = word ? $numberIn(word, comma) : undefined;
        values[slot][row] = value ?? NaN;
        if (value === undefined) holes[slot].push(row);
      }
      return new Cells(
        done,
        new Map(numbers.map((n, k) => [n, { values: values[k], holes: holes[k] }])),
        words,
        extra,
      );
    } finally {
      memory.forEach((one) => $wasm.release(one));
    }
  }

  between(first, last) {
    const inside = (rows) => rows.filter((r) => r >= first && r < last).map((r) => r - first);
    return new Cells(
      last - first,
      new Map(
        [...this.numbers].map(([n, c]) => [
          n,
          { values: c.values.subarray(first, last), holes: inside(c.holes) },
        ]),
      ),
      new Map([...this.texts].map(([n, t]) => [n, t.slice(first, last)])),
      inside(this.extra),
    );
  }
  get surplus() {
    return this.extra.length > 0;
  }
  number(n) {
    const { values, holes } = this.numbers.get(n);
    return $tuple([new NdArray(values, [this.rows], "f"), holes.length === 0]);
  }
  text(n) {
    return this.texts.get(n);
  }
  seconds(n, forms, origin) {
    const texts = this.texts.get(n),
      read = forms.map((form) => {
        const parse = $stamps(form);
        return texts.map((t) => (t === null ? null : parse(t.trim().replaceAll(",", "."))));
      });
    const missing = (stamps) => stamps.filter((s) => s === null).length,
      found = min(read, $kw({ key: missing }));
    origin ??= found.find((s) => s !== null) ?? null;
    const values = Float64Array.from(found, (s) =>
      s === null ? NaN : ((s[0] - origin[0]) * 1e9 + (s[1] - origin[1])) / 1e9,
    );
    return $tuple([new NdArray(values, [values.length], "f"), missing(found) === 0, origin]);
  }
}

// Return a reader of time stamps in one of the forms of strftime → [seconds, nanoseconds].
const $months = [
  "jan",
  "feb",
  "mar",
  "apr",
  "may",
  "jun",
  "jul",
  "aug",
  "sep",
  "oct",
  "nov",
  "dec",
];
function $stamps(form) {
  const iso =
    form === "%+"
      ? "%Y-%m-%d[ T]%H:%M:%S%.f%z"
      : form.replace(/[.]/g, (c, at) => (form[at - 1] === "%" ? c : "\\."));
  const names = [],
    source = iso.replace(/%(\.f|[a-zA-Z])/g, (_, k) => {
      names.push(k);
      return {
        Y: "(\\d{4})",
        y: "(\\d\\d)",
        m: "(\\d\\d?)",
        d: "(\\d\\d?)",
        H: "(\\d\\d?)",
        M: "(\\d\\d)",
        S: "(\\d\\d)",
        b: "([A-Za-z]{3})",
        ".f": "(\\.\\d+)?",
        z: "(Z|[-+]\\d\\d:?\\d\\d)",
      }[k];
    });
  const pattern = new RegExp(`^${source}$`);
  return (text) => {
    const found = pattern.exec(text);
    if (!found) return null;
    const part = Object.fromEntries(names.map((name, n) => [name, found[n + 1]]));
    const month = part.b ? $months.indexOf(part.b.toLowerCase()) + 1 : Number(part.m ?? 1),
      day = Number(part.d ?? 1);
    const year = part.y
      ? Number(part.y) + (Number(part.y) < 70 ? 2000 : 1900)
      : Number(part.Y ?? 1970);
    if (
      !(
        month >= 1 &&
        month <= 12 &&
        day >= 1 &&
        day <= new Date(Date.UTC(year, month, 0)).getUTCDate()
      ) ||
      Number(part.H) > 23 ||
      Number(part.M) > 59
    )
      return null;
    let seconds =
      Date.UTC(year, month - 1, day, Number(part.H), Number(part.M), Number(part.S)) / 1000;
    if (part.z && part.z !== "Z")
      seconds -=
        (part.z[0] === "-" ? -1 : 1) *
        (Number(part.z.slice(1, 3)) * 3600 + Number(part.z.slice(-2)) * 60);
    return [seconds, Math.round(Number(`0${part[".f"] ?? ".0"}`) * 1e9)];
  };
}
$module("fluxobs.logs.formats.text.parse", ($m) =>
  Object.assign($m, { Ragged, Cells: { of: (...a) => Cells.of(...a) } }),
);

// A page neither reads ahead nor writes files, and has one thread.
$module("fluxobs.core.output", ($m) =>
  Object.assign($m, {
    ahead: (parts) => parts,
    *in_parallel(work, items) {
      for (const item of items) yield work(item);
    },
    check_new: () => null,
    write_text: () => null,
  }),
);
$module("fluxobs.core.html", () => {});
// A page sees only its own files.
$module("fluxobs.core.references", ($m) =>
  Object.assign($m, { beside: (folder, name) => $div(folder, name) }),
);
$module("fluxobs.core.input_files", ($m) => {
  const { loads } = $import("tomllib");
  Object.assign($m, {
    check_regular: () => null,
    parse_toml: (text) => loads(text),
    read_toml: (path) => loads(path.read_text()),
  });
});

// Formats whose libraries have no counterpart in JavaScript.
for (const name of ["polars_files", "mdf", "mat", "hdf5", "tdms", "ulog", "excel"])
  $module(`fluxobs.logs.formats.${name}`, ($m) => {
    const refuse = (path) => {
      throw $import("fluxobs.errors").RecordError(
        `${str(path)}: the page does not read ${path.suffix} files. On the command line \`fluxobs estimate\` does; or save it as CSV or .npz`,
      );
    };
    for (const form of [
      "parquet",
      "arrow",
      "json",
      "json_lines",
      "mdf",
      "mat",
      "hdf5",
      "tdms",
      "ulog",
      "excel",
    ])
      $m[`open_${form}`] = refuse;
  });
