// Arrays of NumPy in files: .npy, and .npz, an archive of them.

const $u16 = (b, at) => b[at] | (b[at + 1] << 8),
  $u32 = (b, at) => ($u16(b, at) | ($u16(b, at + 2) << 16)) >>> 0;

// [name, shape, columns or values] of the bytes of a .npy file
function $npy(b, path) {
  if (b[0] !== 0x93 || $decoded(b.subarray(1, 6), "latin-1") !== "NUMPY")
    throw ValueError("it does not begin as an array of NumPy");
  const [size, at] = b[6] === 1 ? [$u16(b, 8), 10] : [$u32(b, 8), 12],
    head = $decoded(b.subarray(at, at + size), "latin-1");
  const shape = [.../'shape':\s*\(([^)]*)\)/.exec(head)[1].matchAll(/\d+/g)].map((m) =>
      Number(m[0]),
    ),
    fortran = /'fortran_order':\s*True/.test(head);
  const data = b.subarray(at + size),
    view = new DataView(data.buffer, data.byteOffset, data.byteLength);
  const reader = (kind) => {
    const [, order, letter, width] = /^([<>|=])?([a-zA-Z?])(\d*)$/.exec(kind) ?? [];
    const little = order !== ">",
      w = Number(width || 1);
    const get = {
      f4: "getFloat32",
      f8: "getFloat64",
      i1: "getInt8",
      i2: "getInt16",
      i4: "getInt32",
      u1: "getUint8",
      u2: "getUint16",
      u4: "getUint32",
      b1: "getUint8",
    }[`${letter === "?" ? "b" : letter}${w}`];
    if (get) return [w, (p) => view[get](p, little)];
    if (letter === "i" || letter === "u")
      return [w, (p) => Number(view[letter === "i" ? "getBigInt64" : "getBigUint64"](p, little))];
    return [letter === "U" ? 4 * w : w, null];
  };
  const fields = /'descr':\s*\[(.*?)\]\s*,\s*'/.exec(head);
  if (fields) {
    const list = [...fields[1].matchAll(/\(\s*'([^']*)'\s*,\s*'([^']*)'\s*\)/g)].map((m) => [
      m[1],
      reader(m[2]),
    ]);
    const row = list.reduce((s, [, [w]]) => s + w, 0),
      rows = $product(shape);
    let off = 0;
    return {
      shape,
      columns: list
        .map(([name, [w, get]]) => {
          const from = off;
          off += w;
          return [
            name,
            get ? Float64Array.from({ length: rows }, (_, k) => get(k * row + from)) : null,
          ];
        })
        .filter((one) => one[1]),
    };
  }
  const [w, get] = reader(/'descr':\s*'([^']*)'/.exec(head)[1]);
  if (!get) return null; // text or objects
  const count = $product(shape),
    values = new Float64Array(count);
  for (let k = 0; k < count; k++) values[k] = get(k * w);
  return {
    shape,
    array: new NdArray(values, fortran ? [...shape].reverse() : shape, "f"),
    turned: fortran,
  };
}

// Inflate, as archives have it: no promise may stand in a synchronous reader.
function $inflate(b, size) {
  const out = new Uint8Array(size);
  let at = 0,
    bit = 0,
    hold = 0,
    to = 0;
  const need = (n) => {
    while (bit < n) {
      hold |= b[at++] << bit;
      bit += 8;
    }
    const v = hold & ((1 << n) - 1);
    hold >>>= n;
    bit -= n;
    return v;
  };
  const tree = (lengths) => {
    const count = new Uint16Array(16),
      first = new Uint16Array(16),
      symbols = [];
    for (const l of lengths) count[l]++;
    count[0] = 0;
    const offset = new Uint16Array(16);
    for (let l = 1; l < 15; l++) offset[l + 1] = offset[l] + count[l];
    lengths.forEach((l, s) => {
      if (l) symbols[offset[l]++] = s;
    });
    return { count, symbols, first };
  };
  const read = ({ count, symbols }) => {
    let code = 0,
      first = 0,
      index = 0;
    for (let l = 1; l < 16; l++) {
      code |= need(1);
      if (code - count[l] < first) return symbols[index + code - first];
      index += count[l];
      first = (first + count[l]) << 1;
      code <<= 1;
    }
    throw ValueError("the archive is damaged");
  };
  const LENGTH = [
      3, 4, 5, 6, 7, 8, 9, 10, 11, 13, 15, 17, 19, 23, 27, 31, 35, 43, 51, 59, 67, 83, 99, 115, 131,
      163, 195, 227, 258,
    ],
    LENGTH_MORE = [
      0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 4, 4, 4, 4, 5, 5, 5, 5, 0,
    ];
  const BACK = [
      1, 2, 3, 4, 5, 7, 9, 13, 17, 25, 33, 49, 65, 97, 129, 193, 257, 385, 513, 769, 1025, 1537,
      2049, 3073, 4097, 6145, 8193, 12289, 16385, 24577,
    ],
    ORDER = [16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15];
  for (let last = 0; !last;) {
    last = need(1);
    const kind = need(2);
    if (kind === 0) {
      bit = 0;
      hold = 0;
      const n = $u16(b, at);
      at += 4;
      out.set(b.subarray(at, at + n), to);
      at += n;
      to += n;
      continue;
    }
    if (kind === 3) throw ValueError("the archive is damaged");
    let literals, distances;
    if (kind === 1) {
      literals = tree(
        Array.from({ length: 288 }, (_, n) => (n < 144 ? 8 : n < 256 ? 9 : n < 280 ? 7 : 8)),
      );
      distances = tree(new Array(30).fill(5));
    } else {
      const nl = need(5) + 257,
        nd = need(5) + 1,
        nc = need(4) + 4,
        code = new Array(19).fill(0),
        lengths = [];
      for (let n = 0; n < nc; n++) code[ORDER[n]] = need(3);
      const codes = tree(code);
      while (lengths.length < nl + nd) {
        const s = read(codes);
        if (s < 16) lengths.push(s);
        else {
          const [v, n] =
            s === 16
              ? [lengths[lengths.length - 1], need(2) + 3]
              : s === 17
                ? [0, need(3) + 3]
                : [0, need(7) + 11];
          for (let k = 0; k < n; k++) lengths.push(v);
        }
      }
      literals = tree(lengths.slice(0, nl));
      distances = tree(lengths.slice(nl));
    }
    for (;;) {
      const s = read(literals);
      if (s < 256) {
        out[to++] = s;
        continue;
      }
      if (s === 256) break;
      const length = LENGTH[s - 257] + need(LENGTH_MORE[s - 257]),
        d = read(distances),
        back = BACK[d] + need(d < 2 ? 0 : (d >> 1) - 1);
      for (let k = 0; k < length; k++, to++) out[to] = out[to - back];
    }
  }
  return out;
}

// Names and contents of an archive.
function* $unzipped(b) {
  let end = b.length - 22;
  while (end >= 0 && $u32(b, end) !== 0x06054b50) end--;
  if (end < 0) throw ValueError("it is no archive");
  let at = $u32(b, end + 16);
  for (let n = $u16(b, end + 10); n > 0; n--) {
    const method = $u16(b, at + 10),
      packed = $u32(b, at + 20),
      size = $u32(b, at + 24),
      name = $u16(b, at + 28),
      from = $u32(b, at + 42);
    const start = from + 30 + $u16(b, from + 26) + $u16(b, from + 28),
      raw = b.subarray(start, start + packed);
    if (method !== 0 && method !== 8) throw ValueError("the archive is packed in an unknown way");
    yield [
      $decoded(b.subarray(at + 46, at + 46 + name)),
      method === 0 ? raw.slice() : $inflate(raw, size),
    ];
    at += 46 + name + $u16(b, at + 30) + $u16(b, at + 32);
  }
}

$module("fluxobs.logs.formats.npz", ($m) => {
  $m.open_npz = (path) => {
    const { Found, tables } = $import("fluxobs.logs.formats.nested"),
      found = Found();
    try {
      for (const [name, data] of $unzipped(path.read_bytes())) {
        const made = $npy(data, path),
          bare = $strings.removesuffix(name, ".npy");
        if (made === null || made.columns) continue;
        found.add(bare, made.turned ? made.array.T : made.array);
      }
    } catch (e) {
      if (!isinstance(e, ValueError)) throw e;
      throw $import("fluxobs.errors").RecordError(
        `${str(path)}: not a readable .npz file: ${str(e)}`,
      );
    }
    return tables(path, found);
  };
});
$module("fluxobs.logs.formats.npy", ($m) => {
  $m.open_npy = $fn("path header", (path, header = null) => {
    const { RecordError } = $import("fluxobs.errors"),
      { ArrayTable } = $import("fluxobs.logs.formats.arrays");
    let made;
    try {
      made = $npy(path.read_bytes(), path);
    } catch (e) {
      if (!isinstance(e, ValueError)) throw e;
      throw RecordError(`${str(path)}: not a readable .npy file: ${str(e)}`);
    }
    let columns;
    if (made && made.columns)
      columns = made.columns.map(([name, values]) => [
        name,
        new NdArray(values, [values.length], "f"),
      ]);
    else if (made && made.array.ndim === 2) {
      const matrix = made.turned ? made.array.T : made.array,
        width = Math.min(...matrix.shape),
        axis = matrix.shape[1] === width ? 1 : 0;
      if (header === null)
        throw RecordError(
          `${str(path)}: a matrix of ${width} columns has no names; give them with --header "t,u_a,…"`,
        );
      if (header.length !== width)
        throw RecordError(`${str(path)}: --header has ${header.length} names for ${width} columns`);
      columns = header.map((name, n) => [
        name,
        axis === 1 ? matrix.at($tuple([new Slice(null, null, null), n])) : matrix.at(n),
      ]);
    } else
      throw RecordError(
        `${str(path)}: its array has shape ${made ? repr($tuple(made.shape)) : "of text"}, not rows and columns`,
      );
    return [ArrayTable($dict(columns), path)];
  });
});
