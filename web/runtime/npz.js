// Arrays of NumPy in files: .npy, and .npz, which is an archive of .npy files.

const $u16 = (b, at) => b[at] | (b[at + 1] << 8),
  $u32 = (b, at) => ($u16(b, at) | ($u16(b, at + 2) << 16)) >>> 0;

// Return [name, shape, columns or values] from the bytes of a .npy file
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
  if (!get) return null; // text or objects, which are not supported
  const count = $product(shape),
    values = new Float64Array(count);
  for (let k = 0; k < count; k++) values[k] = get(k * w);
  return {
    shape,
    array: new NdArray(values, fortran ? [...shape].reverse() : shape, "f"),
    turned: fortran,
  };
}

// Return names and contents of an archive.
function $unzipped(b) {
  try {
    return Object.entries($unzip(b));
  } catch (e) {
    throw ValueError(`it is no archive that can be read: ${e.message}`);
  }
}

$module("fluxobs.logs.formats.npz", ($m) => {
  $m.open_npz = (path) => {
    const { Contents, tables } = $import("fluxobs.logs.formats.nested"),
      found = Contents();
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
