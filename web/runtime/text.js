// Lines of delimited text as numbers: the counterpart of fluxobs/logs/formats/text/parse.py.

const Ragged = $exception("Ragged", ValueError);
const $tens = Float64Array.from({ length: 23 }, (_, n) => 10 ** n);
const [TAB, NEWLINE, RETURN, SPACE, QUOTE, PLUS, COMMA, MINUS_SIGN, POINT] = [9, 10, 13, 32, 34, 43, 44, 45, 46];

// The number in bytes a … b - 1, correctly rounded; undefined if it is none.
function $numberIn(d, a, b, mark) {
  while (a < b && (d[a] === SPACE || d[a] === TAB)) a++;
  while (b > a && (d[b - 1] === SPACE || d[b - 1] === TAB)) b--;
  let at = a, sign = 1, mantissa = 0, digits = 0, power = 0, seen = 0;
  if (d[at] === MINUS_SIGN) { sign = -1; at++; } else if (d[at] === PLUS) at++;
  let c = d[at];
  for (; at < b && (c = d[at]) >= 48 && c <= 57; at++) { mantissa = mantissa * 10 + (c - 48); seen++; if (mantissa > 0) digits++; }
  if (at < b && d[at] === mark) {
    at++;
    for (; at < b && (c = d[at]) >= 48 && c <= 57; at++) { mantissa = mantissa * 10 + (c - 48); seen++; power--; if (mantissa > 0) digits++; }
  }
  if (seen && at < b && (d[at] | 32) === 101) {
    at++;
    let up = 1, e = 0, any_ = false;
    if (d[at] === MINUS_SIGN) { up = -1; at++; } else if (d[at] === PLUS) at++;
    for (; at < b && (c = d[at]) >= 48 && c <= 57; at++) { e = e * 10 + (c - 48); any_ = true; }
    if (!any_) return undefined;
    power += up * e;
  }
  if (!seen || at < b) { // a word: nan, inf; or no number
    const found = $number(String.fromCharCode(...d.subarray(a, b)));
    return found === null || seen ? undefined : found;
  }
  if (digits <= 15 && power >= -22 && power <= 22) return sign * (power < 0 ? mantissa / $tens[-power] : mantissa * $tens[power]);
  const text = String.fromCharCode(...d.subarray(a, b));
  return Number(mark === COMMA ? text.replace(",", ".") : text);
}

class Cells {
  constructor(rows, numbers, texts, extra) { this.rows = rows; this.numbers = numbers; this.texts = texts; this.extra = extra; }

  static of(block, structure, numbers, texts) {
    const width = structure.names.length, mark = structure.decimal_comma ? COMMA : POINT, delimiter = structure.delimiter.charCodeAt(0);
    let rows = 0;
    for (let n = block.indexOf(NEWLINE); n >= 0; n = block.indexOf(NEWLINE, n + 1)) rows++;
    if (block.length && block[block.length - 1] !== NEWLINE) rows++;
    const values = new Map(numbers.map((n) => [n, new Float64Array(rows).fill(NaN)])), lost = new Map(numbers.map((n) => [n, []]));
    const words = new Map(texts.map((n) => [n, new Array(rows).fill(null)])), extra = [];
    const columns = Array.from({ length: width }, (_, n) => values.get(n)), wanted = Array.from({ length: width }, (_, n) => words.get(n));
    const holes = Array.from({ length: width }, (_, n) => lost.get(n));
    const last = Math.max(-1, ...numbers, ...texts), size = block.length;
    let at = 0, row = 0;
    while (at < size) {
      let n = 0;
      for (;;) {
        let a = at, b, quoted = false;
        if (block[at] === QUOTE) {
          quoted = true;
          for (at++; at < size && !(block[at] === QUOTE && block[at + 1] !== QUOTE); at++) if (block[at] === QUOTE) at++;
          a++; b = at; at++;
          while (at < size && block[at] !== delimiter && block[at] !== NEWLINE) at++;
        } else {
          while (at < size && block[at] !== delimiter && block[at] !== NEWLINE) at++;
          b = at;
          if (b > a && block[b - 1] === RETURN && (at >= size || block[at] === NEWLINE)) b--;
        }
        if (n < width) {
          const into = columns[n], text = wanted[n];
          if (into) { const v = b > a ? $numberIn(block, a, b, mark) : undefined; if (v === undefined) holes[n].push(row); else into[row] = v; }
          if (text && (b > a || quoted)) { const t = $decoded(block.subarray(a, b), "utf-8", "replace"); text[row] = quoted ? t.replaceAll('""', '"') : t; }
        } else if (n === width) { if ($strings.strip($decoded(block.subarray(a, b), "utf-8", "replace"))) extra.push(row); } else throw Ragged("a line with too many cells");
        n++;
        if (at >= size || block[at] === NEWLINE) { at++; break; }
        at++;
        if (at >= size) { n++; break; }
      }
      for (; n <= last; n++) if (holes[n]) holes[n].push(row);
      row++;
    }
    const short = row < rows; // a quotation mark went over the end of a line
    return new Cells(short ? row : rows, new Map([...values].map(([n, v]) => [n, { values: v, holes: lost.get(n) }])), words, extra);
  }

  between(first, last) {
    const inside = (rows) => rows.filter((r) => r >= first && r < last).map((r) => r - first);
    return new Cells(last - first, new Map([...this.numbers].map(([n, c]) => [n, { values: c.values.subarray(first, last), holes: inside(c.holes) }])), new Map([...this.texts].map(([n, t]) => [n, t.slice(first, last)])), inside(this.extra));
  }
  get surplus() { return this.extra.length > 0; }
  number(n) { const { values, holes } = this.numbers.get(n); return $tuple([new NdArray(values, [this.rows], "f"), holes.length === 0]); }
  text(n) { return this.texts.get(n); }
  seconds(n, forms, origin) {
    const texts = this.texts.get(n), read = forms.map((form) => { const parse = $stamps(form); return texts.map((t) => (t === null ? null : parse(t.trim().replaceAll(",", ".")))); });
    const missing = (stamps) => stamps.filter((s) => s === null).length, found = min(read, $kw({ key: missing }));
    origin ??= found.find((s) => s !== null) ?? null;
    const values = Float64Array.from(found, (s) => (s === null ? NaN : ((s[0] - origin[0]) * 1e9 + (s[1] - origin[1])) / 1e9));
    return $tuple([new NdArray(values, [values.length], "f"), missing(found) === 0, origin]);
  }
}

// A reader of stamps in one of the forms of strftime → [seconds, nanoseconds].
const $months = ["jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec"];
function $stamps(form) {
  const iso = form === "%+" ? "%Y-%m-%d[ T]%H:%M:%S%.f%z" : form.replace(/[.]/g, (c, at) => (form[at - 1] === "%" ? c : "\\."));
  const names = [], source = iso.replace(/%(\.f|[a-zA-Z])/g, (_, k) => { names.push(k); return { Y: "(\\d{4})", y: "(\\d\\d)", m: "(\\d\\d?)", d: "(\\d\\d?)", H: "(\\d\\d?)", M: "(\\d\\d)", S: "(\\d\\d)", b: "([A-Za-z]{3})", ".f": "(\\.\\d+)?", z: "(Z|[-+]\\d\\d:?\\d\\d)" }[k]; });
  const pattern = new RegExp(`^${source}$`);
  return (text) => {
    const found = pattern.exec(text);
    if (!found) return null;
    const part = Object.fromEntries(names.map((name, n) => [name, found[n + 1]]));
    const month = part.b ? $months.indexOf(part.b.toLowerCase()) + 1 : Number(part.m ?? 1), day = Number(part.d ?? 1);
    const year = part.y ? Number(part.y) + (Number(part.y) < 70 ? 2000 : 1900) : Number(part.Y ?? 1970);
    if (!(month >= 1 && month <= 12 && day >= 1 && day <= new Date(Date.UTC(year, month, 0)).getUTCDate()) || Number(part.H) > 23 || Number(part.M) > 59) return null;
    let seconds = Date.UTC(year, month - 1, day, Number(part.H), Number(part.M), Number(part.S)) / 1000;
    if (part.z && part.z !== "Z") seconds -= (part.z[0] === "-" ? -1 : 1) * (Number(part.z.slice(1, 3)) * 3600 + Number(part.z.slice(-2)) * 60);
    return [seconds, Math.round(Number(`0${part[".f"] ?? ".0"}`) * 1e9)];
  };
}
$module("fluxobs.logs.formats.text.parse", ($m) => Object.assign($m, { Ragged, Cells: { of: (...a) => Cells.of(...a) } }));

// Nothing is read ahead, and nothing is written, in a page.
$module("fluxobs.output", ($m) => Object.assign($m, { ahead: (parts) => parts, check_new: () => null, write_text: () => null }));
$module("fluxobs.html", () => {});
