// NumPy arrays, as far as the package uses them: views with strides, broadcasting, boolean masks,
// complex numbers, small linear algebra. Integers are doubles without a fraction.

class NdArray {
  constructor(data, shape, dtype, im = null, strides = null, offset = 0) {
    this.data = data;
    this.im = im;
    this.shape = $tuple([...shape]);
    this.kind = dtype; // f, i, b, c
    this.strides = strides ?? $rowMajor(shape);
    this.offset = offset;
  }
  get ndim() {
    return this.shape.length;
  }
  get size() {
    return this.shape.reduce((a, b) => a * b, 1);
  }
  get dtype() {
    return { f: $np.float64, i: $np.int64, b: $np.bool_, c: $np.complex128 }[this.kind];
  }
  get T() {
    return new NdArray(
      this.data,
      [...this.shape].reverse(),
      this.kind,
      this.im,
      [...this.strides].reverse(),
      this.offset,
    );
  }
  get real() {
    return this.im
      ? new NdArray(this.data, this.shape, "f", null, this.strides, this.offset)
      : this;
  }
  get imag() {
    return this.im
      ? new NdArray(this.im, this.shape, "f", null, this.strides, this.offset)
      : $np.zeros(this.shape);
  }
  set real(value) {
    this.real.assign(value);
  }
  set imag(value) {
    this.imag.assign(value);
  }
  get contiguous() {
    let step = 1;
    for (let n = this.ndim - 1; n >= 0; n--) {
      if (this.shape[n] !== 1 && this.strides[n] !== step) return false;
      step *= this.shape[n];
    }
    return true;
  }
  // The elements in order. If this array stores them in order, the result shares its memory.
  flat() {
    const count = this.size;
    if (this.contiguous) {
      const cut = (d) =>
        d && (this.offset !== 0 || d.length !== count)
          ? d.subarray(this.offset, this.offset + count)
          : d;
      return [cut(this.data), cut(this.im)];
    }
    return [$gathered(this.data, this, count), this.im ? $gathered(this.im, this, count) : null];
  }
  *[Symbol.iterator]() {
    for (let n = 0; n < this.shape[0]; n++) yield this.at(n);
  }
  at(index) {
    return $select(this, index, true);
  }
  put(index, value) {
    $put(this, index, value);
  }
  assign(value) {
    if (
      value instanceof NdArray &&
      value.data !== this.data &&
      $alike(value.shape, this.shape) &&
      this.contiguous &&
      (this.im || !value.im)
    ) {
      const [d, im] = value.flat();
      this.data.set(d, this.offset);
      if (this.im) {
        if (im) this.im.set(im, this.offset);
        else this.im.fill(0, this.offset, this.offset + d.length);
      }
      return;
    }
    if (this.ndim === 0) {
      $scatter(this, [this.offset], [], value);
    } else this.put($ellipsis, value);
  }
  item() {
    const [d, im] = this.flat();
    return this.kind === "b" ? Boolean(d[0]) : im ? new Complex(d[0], im[0]) : d[0];
  }
  tolist() {
    return this.ndim === 0
      ? this.item()
      : [...this].map((x) => (x instanceof NdArray ? x.tolist() : x));
  }
  __str__() {
    return repr(this.tolist()).replaceAll(",", "");
  }
  __repr__() {
    return `array(${repr(this.tolist())})`;
  }
  __bool__() {
    if (this.size !== 1) throw ValueError("the truth of an array is not defined");
    return $t(this.item());
  }
  __len__() {
    return this.shape[0];
  }
  __eq__(other) {
    return $np.array_equal(this, other);
  }
  setflags() {
    return null;
  }
  copy() {
    const [d, im] = this.flat();
    return new NdArray(d.slice(), this.shape, this.kind, im ? im.slice() : null);
  }
  ravel() {
    return this.reshape(-1);
  }
  conj() {
    if (!this.im) return this;
    const [d, im] = this.flat();
    return new NdArray(
      d,
      this.shape,
      "c",
      im.map((x) => -x),
    );
  }
  conjugate() {
    return this.conj();
  }
}
NdArray.$isClass = true;
NdArray.$title = "ndarray";

const $rowMajor = (shape) => {
  const out = new Array(shape.length);
  let step = 1;
  for (let n = shape.length - 1; n >= 0; n--) {
    out[n] = step;
    step *= shape[n];
  }
  return out;
};
const $product = (shape) => shape.reduce((a, b) => a * b, 1);
const $store = (kind, count) => (kind === "b" ? new Uint8Array(count) : new Float64Array(count));
const $wrap = (x) => (x.ndim === 0 ? x.item() : x);

// The elements of a view in order.
function $gathered(data, { shape, strides, offset }, count) {
  const out = new data.constructor(count),
    n = shape.length;
  if (n === 0) {
    out[0] = data[offset];
    return out;
  }
  const rows = n > 1 ? shape[n - 2] : 1,
    cols = shape[n - 1],
    down = n > 1 ? strides[n - 2] : 0,
    right = strides[n - 1];
  let k = 0;
  for (const start of n > 2 ? $offsets(shape.slice(0, -2), strides.slice(0, -2), offset) : [offset])
    for (let i = 0, row = start; i < rows; i++, row += down)
      for (let j = 0, at = row; j < cols; j++, at += right) out[k++] = data[at];
  return out;
}

// Positions of the elements of a view in its data.
function $offsets(shape, strides, offset) {
  let out = new Int32Array([offset]);
  for (let n = 0; n < shape.length; n++) {
    const longer = new Int32Array(out.length * shape[n]),
      step = strides[n],
      size = shape[n];
    for (let k = 0, at = 0; k < out.length; k++)
      for (let m = 0, to = out[k]; m < size; m++, to += step) longer[at++] = to;
    out = longer;
  }
  return out;
}

const $rank = { b: 0, i: 1, f: 2, c: 3 };
// A number as an integer, converted as by x86 processors.
const $cut = (v) => (Math.abs(v) < 2 ** 63 ? Math.trunc(v) + 0 : -(2 ** 63));
// Check integer results in place: an error if a double cannot represent one exactly.
function $whole(out, name) {
  for (let n = 0; n < out.length; n++) out[n] = $exact(out[n], name) + 0;
  return out;
}

function $kindOf(x) {
  if (x instanceof NdArray) return x.kind;
  if (typeof x === "boolean") return "b";
  if (x instanceof Complex) return "c";
  return "f";
}

// Convert a list, number or array to an array.
function $as(x, kind = null) {
  if (x instanceof NdArray) {
    if (!kind || kind === x.kind) return x;
    const [d, im] = x.flat();
    if (kind === "b")
      return new NdArray(
        Uint8Array.from(d, (v, n) => (v !== 0 || (im && im[n] !== 0) ? 1 : 0)),
        x.shape,
        "b",
      );
    if (kind === "c")
      return new NdArray(Float64Array.from(d), x.shape, "c", new Float64Array(x.size));
    if (kind === "i") return new NdArray(Float64Array.from(d, $cut), x.shape, "i");
    return new NdArray(Float64Array.from(d), x.shape, kind);
  }
  if (x instanceof Float64Array) return new NdArray(x, [x.length], kind ?? "f");
  const shape = [],
    leaves = [];
  let found = "i";
  let seen = null;
  const walk = (y, depth) => {
    if (y instanceof NdArray) {
      if (shape.length < depth + y.ndim) shape.push(...y.shape.slice(shape.length - depth));
      seen = seen === null || $rank[y.kind] > $rank[seen] ? y.kind : seen;
      const [d, im] = y.flat();
      for (let n = 0; n < d.length; n++) leaves.push(im ? new Complex(d[n], im[n]) : d[n]);
      return;
    }
    if (
      Array.isArray(y) ||
      (y && typeof y === "object" && typeof y[Symbol.iterator] === "function")
    ) {
      const items = Array.isArray(y) ? y : [...y];
      if (shape.length === depth) shape.push(items.length);
      else if (shape[depth] !== items.length) throw ValueError("rows of an array differ in length");
      for (const one of items) walk(one, depth + 1);
      return;
    }
    const own =
      typeof y === "boolean"
        ? "b"
        : y instanceof Complex
          ? "c"
          : Number.isSafeInteger(y) && !Object.is(y, -0)
            ? "i"
            : "f";
    if (typeof y === "string" || y == null) {
      const value = typeof y === "string" ? float(y) : NaN;
      seen = "f";
      leaves.push(value);
      return;
    }
    if (typeof y !== "number" && typeof y !== "boolean" && !(y instanceof Complex))
      throw TypeError("an array holds numbers");
    seen = seen === null || $rank[own] > $rank[seen] ? own : seen;
    leaves.push(y);
  };
  walk(x, 0);
  found = kind ?? seen ?? "f";
  const data = $store(found, leaves.length),
    im = found === "c" ? new Float64Array(leaves.length) : null;
  leaves.forEach((v, n) => {
    if (v instanceof Complex) {
      data[n] = v.real;
      if (im) im[n] = v.imag;
    } else data[n] = found === "b" ? Number(v) !== 0 : found === "i" ? $cut(Number(v)) : Number(v);
  });
  return new NdArray(data, shape, found, im);
}

function $kind(dtype) {
  if (dtype == null) return null;
  if (typeof dtype === "string") return { f: "f", i: "i", b: "b", c: "c", u: "i" }[dtype[0]];
  return dtype === bool || dtype === $np.bool_
    ? "b"
    : dtype === int || dtype === $np.int64 || dtype === $np.intp
      ? "i"
      : dtype === complex || dtype === $np.complex128
        ? "c"
        : "f";
}

// ---- element by element ---------------------------------------------------------------------

function $shared(...shapes) {
  const most = Math.max(...shapes.map((s) => s.length)),
    out = [];
  for (let n = 0; n < most; n++) {
    let size = 1;
    for (const s of shapes) {
      const own = s[s.length - most + n] ?? 1;
      if (own !== 1 && size !== 1 && own !== size)
        throw ValueError(
          `shapes do not fit: ${shapes.map((one) => repr($tuple([...one]))).join(" ")}`,
        );
      if (own !== 1) size = own;
    }
    out.push(size);
  }
  return out;
}
const $alike = (a, b) => a.length === b.length && a.every((x, n) => x === b[n]);

function $expanded(x, shape) {
  if ($alike(x.shape, shape)) return x;
  const missing = shape.length - x.ndim;
  if (missing < 0 || x.shape.some((size, n) => size !== 1 && size !== shape[missing + n]))
    throw ValueError(
      `an array of shape ${repr(x.shape)} does not go into ${repr($tuple([...shape]))}`,
    );
  const strides = shape.map((size, n) =>
    n < missing || (x.shape[n - missing] === 1 && size !== 1) ? 0 : x.strides[n - missing],
  );
  return new NdArray(x.data, shape, x.kind, x.im, strides, x.offset);
}

// x and y have steps 0 (one number) or 1. Each loop is a separate function, which the engine
// compiles for the types of its arrays.
const $loops = {
  add(n, x, p, y, q, o) {
    for (let k = 0; k < n; k++) o[k] = x[k * p] + y[k * q];
  },
  sub(n, x, p, y, q, o) {
    for (let k = 0; k < n; k++) o[k] = x[k * p] - y[k * q];
  },
  mul(n, x, p, y, q, o) {
    for (let k = 0; k < n; k++) o[k] = x[k * p] * y[k * q];
  },
  div(n, x, p, y, q, o) {
    for (let k = 0; k < n; k++) o[k] = x[k * p] / y[k * q];
  },
  floordiv(n, x, p, y, q, o) {
    for (let k = 0; k < n; k++) o[k] = $down(x[k * p], y[k * q]);
  },
  mod(n, x, p, y, q, o) {
    for (let k = 0; k < n; k++) o[k] = $left(x[k * p], y[k * q]);
  },
  pow(n, x, p, y, q, o) {
    if (q === 0 && y[0] === 2) for (let k = 0; k < n; k++) o[k] = x[k * p] * x[k * p];
    else for (let k = 0; k < n; k++) o[k] = $powered(x[k * p], y[k * q]);
  },
  max(n, x, p, y, q, o) {
    for (let k = 0; k < n; k++) {
      const a = x[k * p],
        b = y[k * q];
      o[k] = a > b || a !== a ? a : b;
    }
  },
  min(n, x, p, y, q, o) {
    for (let k = 0; k < n; k++) {
      const a = x[k * p],
        b = y[k * q];
      o[k] = a < b || a !== a ? a : b;
    }
  },
  hypot(n, x, p, y, q, o) {
    for (let k = 0; k < n; k++) o[k] = $hypot(x[k * p], y[k * q]);
  },
  atan2(n, x, p, y, q, o) {
    for (let k = 0; k < n; k++) o[k] = Math.atan2(x[k * p], y[k * q]);
  },
  lt(n, x, p, y, q, o) {
    for (let k = 0; k < n; k++) o[k] = x[k * p] < y[k * q] ? 1 : 0;
  },
  le(n, x, p, y, q, o) {
    for (let k = 0; k < n; k++) o[k] = x[k * p] <= y[k * q] ? 1 : 0;
  },
  gt(n, x, p, y, q, o) {
    for (let k = 0; k < n; k++) o[k] = x[k * p] > y[k * q] ? 1 : 0;
  },
  ge(n, x, p, y, q, o) {
    for (let k = 0; k < n; k++) o[k] = x[k * p] >= y[k * q] ? 1 : 0;
  },
  eq(n, x, p, y, q, o) {
    for (let k = 0; k < n; k++) o[k] = x[k * p] === y[k * q] ? 1 : 0;
  },
  ne(n, x, p, y, q, o) {
    for (let k = 0; k < n; k++) o[k] = x[k * p] !== y[k * q] ? 1 : 0;
  },
  and(n, x, p, y, q, o) {
    for (let k = 0; k < n; k++) o[k] = x[k * p] & y[k * q];
  },
  or(n, x, p, y, q, o) {
    for (let k = 0; k < n; k++) o[k] = x[k * p] | y[k * q];
  },
  xor(n, x, p, y, q, o) {
    for (let k = 0; k < n; k++) o[k] = x[k * p] ^ y[k * q];
  },
};
// As exact as the C library's hypot, and faster than Math.hypot, which accepts any number of
// arguments.
function $hypot(a, b) {
  const s = a * a + b * b;
  return s > 1e-280 && s < 1e280 ? Math.sqrt(s) : Math.hypot(a, b);
}

function $complexLoop(word, n, x, xi, p, y, yi, q, o, oi) {
  for (let k = 0; k < n; k++) {
    const a = x[k * p],
      b = xi ? xi[k * p] : 0,
      c = y[k * q],
      d = yi ? yi[k * q] : 0;
    switch (word) {
      case "add":
        o[k] = a + c;
        oi[k] = b + d;
        break;
      case "sub":
        o[k] = a - c;
        oi[k] = b - d;
        break;
      case "mul":
        o[k] = a * c - b * d;
        oi[k] = a * d + b * c;
        break;
      case "div":
        // like NumPy, which multiplies by an inverse
        if (c === 0 && d === 0) {
          o[k] = a / Math.abs(c);
          oi[k] = b / Math.abs(c);
        } else if (Math.abs(c) >= Math.abs(d)) {
          const r = d / c,
            s = 1 / (c + d * r);
          o[k] = (a + b * r) * s;
          oi[k] = (b - a * r) * s;
        } else {
          const r = c / d,
            s = 1 / (c * r + d);
          o[k] = (a * r + b) * s;
          oi[k] = (b * r - a) * s;
        }
        break;
      case "pow": {
        if (d === 0 && Number.isInteger(c) && c >= 0 && c < 64) {
          let re = 1,
            im = 0;
          for (let m = 0; m < c; m++) [re, im] = [re * a - im * b, re * b + im * a];
          o[k] = re;
          oi[k] = im;
          break;
        }
        const r = Math.log(Math.hypot(a, b)),
          t = Math.atan2(b, a),
          size = Math.exp(r * c - t * d),
          turn = r * d + t * c;
        o[k] = size * Math.cos(turn);
        oi[k] = size * Math.sin(turn);
        break;
      }
      case "eq":
        o[k] = a === c && b === d ? 1 : 0;
        break;
      case "ne":
        o[k] = a === c && b === d ? 0 : 1;
        break;
      default:
        throw TypeError(`no operator ${word} of complex arrays`);
    }
  }
}

const $logical = new Set(["lt", "le", "gt", "ge", "eq", "ne"]);

// Operations whose integer form differs from the float form.
const $integers = {
  ...$bitwise,
  floordiv: (a, b) => (b === 0 ? 0 : $down(a, b)),
  mod: (a, b) => (b === 0 ? 0 : $left(a, b)),
  pow: (a, b) => {
    if (b < 0) throw ValueError("integers to negative integer powers");
    if (Math.abs(a) < 2) return a === -1 ? 1 - 2 * (b % 2) : b === 0 ? 1 : a;
    let out = 1;
    for (let n = 0; n < b && Math.abs(out) < 2 ** 53; n++) out *= a;
    return out;
  },
};

function $binary(word, a, b) {
  if (typeof a === "string" || typeof b === "string" || a == null || b == null) {
    if (word === "eq" || word === "ne") return word === "ne";
    throw TypeError(`an array and ${repr(typeof a === "object" ? b : a)} do not go together`);
  }
  const x = $as(a),
    y = $as(b);
  const shape = $alike(x.shape, y.shape) ? x.shape : $shared(x.shape, y.shape);
  const n = $product(shape);
  const side = (z) => (z.size === 1 ? [...z.flat(), 0] : [...$expanded(z, shape).flat(), 1]);
  const [xd, xi, p] = side(x),
    [yd, yi, q] = side(y);
  if (xi || yi) {
    const kind = $logical.has(word) ? "b" : "c";
    const out = $store(kind, n),
      im = kind === "c" ? new Float64Array(n) : null;
    $complexLoop(word, n, xd, xi, p, yd, yi, q, out, im);
    return new NdArray(out, shape, kind, im);
  }
  let kind = "f";
  const logical = x.kind === "b" && y.kind === "b";
  if ($logical.has(word)) kind = "b";
  else if (!["div", "hypot", "atan2"].includes(word) && x.kind !== "f" && y.kind !== "f")
    kind = logical && !["floordiv", "mod", "pow"].includes(word) ? "b" : "i";
  if (logical && word === "sub") throw TypeError("no operator sub of logical arrays");
  if ($bitwise[word] && kind === "f") throw TypeError(`no operator ${word} of floats`);
  const out = $store(kind, n);
  if (kind === "i" && $integers[word]) {
    for (let k = 0; k < n; k++) out[k] = $integers[word](xd[k * p], yd[k * q]);
    return new NdArray($whole(out, word), shape, kind);
  }
  if (!$loops[word]) throw TypeError(`no operator ${word} of arrays`);
  $loops[kind === "b" && word === "add" ? "or" : word](n, xd, p, yd, q, out);
  if (kind === "i" && word !== "max" && word !== "min") $whole(out, word);
  return new NdArray(out, shape, kind);
}

function $elementwise(x, fn, kind = "f") {
  if (typeof x === "number" || typeof x === "boolean") {
    const y = fn(Number(x));
    return kind === "b" ? Boolean(y) : y;
  }
  const a = $as(x),
    [d, im] = a.flat(),
    out = $store(kind, d.length);
  if (im) throw TypeError("this function of complex numbers is not here");
  for (let n = 0; n < d.length; n++) out[n] = fn(d[n]);
  return $wrap(new NdArray(out, a.shape, kind));
}

// The complex array of a real and an imaginary part.
const $joint = (re, im) =>
  $wrap(new NdArray($as(re).flat()[0], $as(re).shape, "c", $as(im).flat()[0]));
// A real function of both parts of a complex array, or of a real array.
function $parts(x, fn) {
  const a = $as(x);
  return a.im ? $joint($elementwise(a.real, fn), $elementwise(a.imag, fn)) : $elementwise(x, fn);
}

const $arrays = {
  compare: (word, a, b) => $wrap($binary(word, a, b)),
  binary: (word, a, b) => $wrap($binary(word, a, b)),
  complexScalar: (word, a, b) => $binary(word, a, b).item(),
  unary(word, x) {
    if (word === "invert" && (x.kind === "b" || x.kind === "i"))
      return $elementwise(
        x,
        x.kind === "b" ? (v) => (v ? 0 : 1) : (v) => $exact(-v - 1, word),
        x.kind,
      );
    if (word === "invert" || (word === "neg" && x.kind === "b"))
      throw TypeError(`no operator ${word} of arrays of ${x.kind}`);
    if (word === "neg") {
      if (!x.im) return $elementwise(x, x.kind === "i" ? (v) => 0 - v : (v) => -v, x.kind);
      const [d, im] = x.flat();
      return new NdArray(
        d.map((v) => -v),
        x.shape,
        "c",
        im.map((v) => -v),
      );
    }
    if (x.im) {
      const [d, im] = x.flat();
      return new NdArray(
        d.map((v, n) => $hypot(v, im[n])),
        x.shape,
        "f",
      );
    }
    return $elementwise(x, Math.abs, x.kind);
  },
  matmul(a, b) {
    if (a && a.__matmul__) return a.__matmul__(b);
    return $np.matmul(a, b);
  },
};

// ---- indices ----------------------------------------------------------------------------------

const $isIndexArray = (x) => x instanceof NdArray || (Array.isArray(x) && x.constructor === Array);

// Return a view for numbers, slices, None and …; otherwise positions in the data, and their shape.
function $resolve(x, index) {
  if (index instanceof Slice) index = $tuple([index]);
  if (
    Array.isArray(index) &&
    index.$t &&
    index.every((p) => typeof p === "number" || p instanceof Slice)
  ) {
    // the most common kind, with a fast path
    const shape = [],
      strides = [];
    let offset = x.offset,
      n = 0;
    for (const p of index) {
      const size = x.shape[n],
        by = x.strides[n++];
      if (size === undefined) throw IndexError("too many indices for an array");
      if (typeof p === "number") {
        const at = p < 0 ? p + size : p;
        if (!(at >= 0 && at < size)) throw IndexError(`index ${p} out of range of ${size}`);
        offset += at * by;
      } else {
        const [first, count, step] = $span(p, size);
        offset += first * by;
        shape.push(count);
        strides.push(step * by);
      }
    }
    for (; n < x.ndim; n++) {
      shape.push(x.shape[n]);
      strides.push(x.strides[n]);
    }
    return { view: new NdArray(x.data, shape, x.kind, x.im, strides, offset) };
  }
  let parts = Array.isArray(index) && index.$t ? [...index] : [index];
  parts = parts.map((p) =>
    $isIndexArray(p)
      ? Array.isArray(p) && p.length === 0
        ? $as(p, "i")
        : $as(p)
      : typeof p === "boolean"
        ? $as([p])
        : p,
  );
  const taken = parts.reduce(
    (sum_, p) =>
      sum_ +
      (p === null || p === $ellipsis ? 0 : p instanceof NdArray && p.kind === "b" ? p.ndim : 1),
    0,
  );
  const dots = parts.indexOf($ellipsis),
    fill = Array.from({ length: x.ndim - taken }, () => new Slice(null, null, null));
  if (x.ndim < taken) throw IndexError("too many indices for an array");
  if (dots >= 0) parts.splice(dots, 1, ...fill);
  else parts.push(...fill);
  const advanced = parts.some((p) => p instanceof NdArray);
  const shape = [],
    strides = [],
    dims = []; // dims: axes of an advanced result, in order
  let offset = x.offset,
    axis = 0;
  for (const p of parts) {
    if (p === null) {
      shape.push(1);
      strides.push(0);
      dims.push({ size: 1, step: 0 });
      continue;
    }
    if (p instanceof Slice) {
      const [first, count, step] = $span(p, x.shape[axis]);
      offset += first * x.strides[axis];
      shape.push(count);
      strides.push(step * x.strides[axis]);
      dims.push({ size: count, step: step * x.strides[axis] });
      axis++;
      continue;
    }
    if (p instanceof NdArray) {
      if (p.kind === "b") {
        const [mask] = p.flat();
        if (!$alike(p.shape, x.shape.slice(axis, axis + p.ndim)))
          throw IndexError(`a mask of shape ${repr(p.shape)} does not fit ${repr(x.shape)}`);
        let count = 0;
        for (let n = 0; n < mask.length; n++) count += mask[n];
        const own = new Float64Array(count),
          steps = x.strides.slice(axis, axis + p.ndim),
          sizes = p.shape;
        if (p.ndim === 1) {
          for (let n = 0, k = 0; n < mask.length; n++) if (mask[n]) own[k++] = n * steps[0];
        } else
          for (let n = 0, k = 0; n < mask.length; n++)
            if (mask[n]) {
              let rest = n,
                at = 0;
              for (let m = sizes.length - 1; m >= 0; m--) {
                at += (rest % sizes[m]) * steps[m];
                rest = Math.floor(rest / sizes[m]);
              }
              own[k++] = at;
            }
        dims.push({ positions: new NdArray(own, [count], "i") });
        axis += p.ndim;
        continue;
      }
      const [d] = p.flat(),
        size = x.shape[axis],
        step = x.strides[axis],
        own = new Float64Array(d.length);
      for (let n = 0; n < d.length; n++) {
        const at = d[n] < 0 ? d[n] + size : d[n];
        if (!(at >= 0 && at < size)) throw IndexError("index out of range");
        own[n] = at * step;
      }
      dims.push({ positions: new NdArray(own, p.shape, "i") });
      axis++;
      continue;
    }
    const size = x.shape[axis],
      n = Number(p),
      at = n < 0 ? n + size : n;
    if (!(at >= 0 && at < size) || typeof p === "string")
      throw IndexError(`index ${repr(p)} out of range of ${size}`);
    if (advanced)
      dims.push({ positions: new NdArray(new Float64Array([at * x.strides[axis]]), [], "i") });
    else offset += at * x.strides[axis];
    axis++;
  }
  if (!advanced) return { view: new NdArray(x.data, shape, x.kind, x.im, strides, offset) };
  const own = dims.filter((d) => d.positions),
    together = $shared(...own.map((d) => d.positions.shape));
  let sum_ = new NdArray(new Float64Array($product(together)), together, "i");
  for (const d of own) sum_ = $binary("add", sum_, $expanded(d.positions, together));
  const at = dims.findIndex((d) => d.positions),
    last = dims.length - 1 - [...dims].reverse().findIndex((d) => d.positions);
  const adjacent = dims.slice(at, last + 1).every((d) => d.positions);
  const before = (adjacent ? dims.slice(0, at) : []).filter((d) => !d.positions);
  const after = (adjacent ? dims.slice(at) : dims).filter((d) => !d.positions);
  const head = $offsets(
    before.map((d) => d.size),
    before.map((d) => d.step),
    offset,
  );
  const tail = $offsets(
    after.map((d) => d.size),
    after.map((d) => d.step),
    0,
  );
  const [middle] = sum_.flat(),
    positions = new Int32Array(head.length * middle.length * tail.length);
  let k = 0;
  for (const h of head)
    for (let n = 0; n < middle.length; n++)
      for (let m = 0; m < tail.length; m++) positions[k++] = h + middle[n] + tail[m];
  return {
    positions,
    shape: [...before.map((d) => d.size), ...together, ...after.map((d) => d.size)],
  };
}

function $select(x, index) {
  if (typeof index === "number" && x.ndim === 1) {
    const n = index < 0 ? index + x.shape[0] : index;
    if (!(n >= 0 && n < x.shape[0]))
      throw IndexError(`index ${index} out of range of ${x.shape[0]}`);
    const at = x.offset + n * x.strides[0];
    return x.kind === "b"
      ? Boolean(x.data[at])
      : x.im
        ? new Complex(x.data[at], x.im[at])
        : x.data[at];
  }
  if (x.ndim === 1 && index instanceof NdArray && index.ndim === 1 && x.strides[0] === 1 && !x.im) {
    const [at] = index.flat(),
      {
        data,
        offset,
        shape: [size],
      } = x;
    if (index.kind === "b" && at.length === size) {
      let count = 0;
      for (let n = 0; n < size; n++) count += at[n];
      if (count === size) return new NdArray(data.slice(offset, offset + size), [size], x.kind);
      const out = new data.constructor(count);
      for (let n = 0, k = 0; n < size; n++) if (at[n]) out[k++] = data[offset + n];
      return new NdArray(out, [count], x.kind);
    }
  }
  if (
    x.ndim === 2 &&
    !x.im &&
    index instanceof NdArray &&
    index.ndim === 1 &&
    index.kind !== "b" &&
    x.contiguous
  ) {
    // row numbers select rows
    const [at] = index.flat(),
      [d] = x.flat(),
      [rows, cols] = x.shape,
      out = new d.constructor(at.length * cols);
    for (let n = 0, to = 0; n < at.length; n++) {
      const row = at[n] < 0 ? at[n] + rows : at[n];
      if (!(row >= 0 && row < rows)) throw IndexError("index out of range");
      for (let k = 0, from = row * cols; k < cols; k++) out[to++] = d[from++];
    }
    return new NdArray(out, [at.length, cols], x.kind);
  }
  const { view, positions, shape } = $resolve(x, index);
  if (view) return $wrap(view);
  const out = new x.data.constructor(positions.length),
    im = x.im ? new Float64Array(positions.length) : null;
  for (let n = 0; n < out.length; n++) out[n] = x.data[positions[n]];
  if (im) for (let n = 0; n < out.length; n++) im[n] = x.im[positions[n]];
  return $wrap(new NdArray(out, shape, x.kind, im));
}

function $scatter(x, positions, shape, value) {
  let v = $as(value, x.kind === "i" || x.kind === "b" ? x.kind : null);
  if (v.data === x.data) v = v.copy(); // source and target may overlap
  if (v.size === 1) {
    const [d, im] = v.flat();
    for (let n = 0; n < positions.length; n++) {
      x.data[positions[n]] = d[0];
      if (x.im) x.im[positions[n]] = im ? im[0] : 0;
    }
    return;
  }
  const [d, im] = $expanded(v, shape).flat();
  for (let n = 0; n < positions.length; n++) {
    x.data[positions[n]] = d[n];
    if (x.im) x.im[positions[n]] = im ? im[n] : 0;
  }
}
function $put(x, index, value) {
  if (
    x.ndim === 2 &&
    !x.im &&
    index instanceof NdArray &&
    index.kind === "b" &&
    index.ndim === 1 &&
    x.contiguous &&
    value instanceof NdArray &&
    value.ndim === 2 &&
    value.shape[1] === x.shape[1]
  ) {
    // a mask selects rows
    const [mask] = index.flat(),
      [d] = value.flat(),
      cols = x.shape[1];
    if (mask.length === x.shape[0] && mask.reduce((a, b) => a + b, 0) === value.shape[0]) {
      for (let n = 0, from = 0; n < mask.length; n++)
        if (mask[n])
          for (let k = 0, to = x.offset + n * cols; k < cols; k++) x.data[to++] = d[from++];
      return;
    }
  }
  const { view, positions, shape } = $resolve(x, index);
  if (view) $scatter(x, $offsets(view.shape, view.strides, view.offset), view.shape, value);
  else $scatter(x, positions, shape, value);
}

// ---- along an axis ------------------------------------------------------------------------------

// Sum in NumPy's order: eight sums of blocks of 128, pairwise.
function $pairwise(d, from, n) {
  if (n < 8) {
    let s = 0;
    for (let k = 0; k < n; k++) s += d[from + k];
    return n ? s : 0;
  }
  if (n <= 128) {
    let a = d[from],
      b = d[from + 1],
      c = d[from + 2],
      e = d[from + 3],
      f = d[from + 4],
      g = d[from + 5],
      h = d[from + 6],
      i = d[from + 7],
      k = 8;
    for (; k < n - (n % 8); k += 8) {
      const m = from + k;
      a += d[m];
      b += d[m + 1];
      c += d[m + 2];
      e += d[m + 3];
      f += d[m + 4];
      g += d[m + 5];
      h += d[m + 6];
      i += d[m + 7];
    }
    let s = a + b + (c + e) + (f + g + (h + i));
    for (; k < n; k++) s += d[from + k];
    return s;
  }
  let half = Math.floor(n / 2);
  half -= half % 8;
  return $pairwise(d, from, half) + $pairwise(d, from + half, n - half);
}

// Find the k-th smallest number by Hoare's selection. It is then at position k, with no larger
// number before it and no smaller number after it.
function $nth(s, k) {
  for (let low = 0, high = s.length - 1; low < high;) {
    const a = s[low],
      b = s[(low + high) >> 1],
      c = s[high],
      pivot = a < b ? (b < c ? b : a < c ? c : a) : a < c ? a : b < c ? c : b;
    let i = low,
      j = high;
    while (i <= j) {
      while (s[i] < pivot) i++;
      while (s[j] > pivot) j--;
      if (i <= j) {
        const v = s[i];
        s[i++] = s[j];
        s[j--] = v;
      }
    }
    if (k <= j) high = j;
    else if (k >= i) low = i;
    else break;
  }
  return s[k];
}
const $least = (s, from) => {
  let v = s[from];
  for (let k = from + 1; k < s.length; k++) if (s[k] < v) v = s[k];
  return v;
};

const $reducers = {
  sum: (d, from, n) => $pairwise(d, from, n),
  prod: (d, from, n) => {
    let s = 1;
    for (let k = 0; k < n; k++) s *= d[from + k];
    return s;
  },
  max: (d, from, n) => {
    let s = d[from];
    for (let k = 1; k < n; k++) {
      const v = d[from + k];
      if (v > s || v !== v) s = v;
      if (s !== s) return s;
    }
    return s;
  },
  min: (d, from, n) => {
    let s = d[from];
    for (let k = 1; k < n; k++) {
      const v = d[from + k];
      if (v < s || v !== v) s = v;
      if (s !== s) return s;
    }
    return s;
  },
  any: (d, from, n) => {
    for (let k = 0; k < n; k++) if (d[from + k] !== 0) return 1;
    return 0;
  },
  all: (d, from, n) => {
    for (let k = 0; k < n; k++) if (d[from + k] === 0) return 0;
    return 1;
  },
  argmax: (d, from, n) => {
    let at = 0;
    for (let k = 0; k < n; k++) {
      if (d[from + k] !== d[from + k]) return k;
      if (d[from + k] > d[from + at]) at = k;
    }
    return at;
  },
  argmin: (d, from, n) => {
    let at = 0;
    for (let k = 0; k < n; k++) {
      if (d[from + k] !== d[from + k]) return k;
      if (d[from + k] < d[from + at]) at = k;
    }
    return at;
  },
  median: (d, from, n) => {
    if (!n) return NaN;
    const s = d.slice(from, from + n);
    for (let k = 0; k < n; k++) if (s[k] !== s[k]) return NaN;
    const low = (n - 1) >> 1,
      v = $nth(s, low);
    return n % 2 ? v : (v + $least(s, low + 1)) / 2;
  },
};

// The axes moved to the end; returns [data, groups, length, remaining shape].
function $grouped(x, axis) {
  const axes =
    axis == null
      ? x.shape.map((_, n) => n)
      : (Array.isArray(axis) ? axis : [axis]).map((n) => (n < 0 ? n + x.ndim : n));
  const kept = x.shape.map((_, n) => n).filter((n) => !axes.includes(n)),
    order = [...kept, ...axes];
  const moved = new NdArray(
    x.data,
    order.map((n) => x.shape[n]),
    x.kind,
    x.im,
    order.map((n) => x.strides[n]),
    x.offset,
  );
  const length = $product(axes.map((n) => x.shape[n])),
    shape = kept.map((n) => x.shape[n]);
  return { flat: moved.flat(), groups: $product(shape), length, shape, axes };
}

function $reduce(word, given, axis = null, keepdims = false, { initial } = {}) {
  const x = $as(given);
  if (x.im && word !== "sum" && word !== "mean") throw TypeError(`${word} of complex numbers`);
  if (x.im) {
    const [re, im] = [x.real, x.imag].map((part) => $reduce("sum", part, axis, keepdims)),
      out = $joint(re, im);
    return word === "sum" ? out : $div(out, x.size / $as(re).size);
  }
  const {
    flat: [d],
    groups,
    length,
    shape,
    axes,
  } = $grouped(x, axis);
  if (!length && initial === undefined && ["max", "min", "argmax", "argmin"].includes(word))
    throw ValueError(`${word} of nothing`);
  const kind =
    word === "any" || word === "all"
      ? "b"
      : word.startsWith("arg") || (x.kind !== "f" && ["sum", "prod"].includes(word))
        ? "i"
        : x.kind === "b" && (word === "max" || word === "min")
          ? "b"
          : x.kind === "i" && word !== "median" && word !== "mean"
            ? "i"
            : "f";
  const out = $store(kind, groups);
  // Along any axis except the last, NumPy adds row by row.
  const rowwise = word === "sum" && axis !== null && x.ndim > 1 && !axes.includes(x.ndim - 1);
  for (let n = 0; n < groups; n++) {
    let v;
    if (word === "mean") v = $pairwise(d, n * length, length) / length;
    else if (rowwise) {
      v = 0;
      for (let k = 0; k < length; k++) v += d[n * length + k];
    } else if (!length && initial !== undefined) v = initial;
    else v = $reducers[word](d, n * length, length);
    out[n] =
      initial !== undefined && length
        ? word === "max"
          ? Math.max(v, initial)
          : word === "min"
            ? Math.min(v, initial)
            : v
        : v;
  }
  if (kind === "i" && (word === "sum" || word === "prod")) {
    $whole(out, word);
    // intermediate sums must be exact, too
    if (word === "sum" && x.kind === "i") $exact($pairwise(d.map(Math.abs), 0, d.length), word);
  }
  const whole = keepdims ? x.shape.map((size, n) => (axes.includes(n) ? 1 : size)) : shape;
  return $wrap(new NdArray(out, whole, kind));
}

for (const word of ["sum", "prod", "any", "all", "argmax", "argmin"])
  NdArray.prototype[word] = $fn("axis keepdims", function (axis = null, keepdims = false) {
    return $reduce(word, this, axis, keepdims);
  });
for (const word of ["max", "min"])
  NdArray.prototype[word] = $fn(
    "axis keepdims initial",
    function (axis = null, keepdims = false, initial = undefined) {
      return $reduce(word, this, axis, keepdims, { initial });
    },
  );
NdArray.prototype.mean = $fn("axis keepdims", function (axis = null, keepdims = false) {
  return $reduce("mean", this, axis, keepdims);
});
NdArray.prototype.std = $fn("axis", function (axis = null) {
  const off = $sub(this, $reduce("mean", this, axis, true));
  const size = $np.abs(off);
  return $np.sqrt($reduce("mean", $mul(size, size), axis));
});
NdArray.prototype.reshape = function (...shape) {
  const wanted = [...(shape.length === 1 && Array.isArray(shape[0]) ? shape[0] : shape)],
    at = wanted.indexOf(-1);
  if (at >= 0) wanted[at] = this.size / wanted.reduce((a, b) => a * (b === -1 ? 1 : b), 1);
  if ($product(wanted) !== this.size)
    throw ValueError(`an array of ${this.size} cannot have the shape ${repr($tuple(wanted))}`);
  if (this.contiguous) return new NdArray(this.data, wanted, this.kind, this.im, null, this.offset);
  const [d, im] = this.flat();
  return new NdArray(d, wanted, this.kind, im);
};
NdArray.prototype.astype = function (dtype) {
  const out = $as(this, $kind(dtype));
  return out === this ? this.copy() : out;
};
NdArray.prototype.transpose = function (...axes) {
  const o = axes.length ? axes : this.shape.map((_, n) => this.ndim - 1 - n);
  return new NdArray(
    this.data,
    o.map((n) => this.shape[n]),
    this.kind,
    this.im,
    o.map((n) => this.strides[n]),
    this.offset,
  );
};
NdArray.prototype.round = function (digits = 0) {
  return $np.round(this, digits);
};

// ---- the functions of NumPy -----------------------------------------------------------------

const $np = {};
const $one = (fn, kind) => (x) => $elementwise(x, fn, kind);
Object.assign($np, {
  ndarray: NdArray,
  float64: float,
  int64: new Type("int64", [], (x) => int.$test(x)),
  bool_: new Type("bool", [], (x) => typeof x === "boolean"),
  complex128: complex,
  intp: null,
  uint8: new Type("uint8"),
  floating: float,
  pi: Math.PI,
  inf: Infinity,
  nan: NaN,
  newaxis: null,
  sqrt: $one(Math.sqrt),
  floor: $one(Math.floor),
  ceil: $one(Math.ceil),
  log: $one(Math.log),
  log10: $one(Math.log10),
  log2: $one(Math.log2),
  sin: $one(Math.sin),
  cos: $one(Math.cos),
  tan: $one(Math.tan),
  arctan: $one(Math.atan),
  tanh: $one(Math.tanh),
  expm1: $one(Math.expm1),
  degrees: $one((x) => x * (180 / Math.PI)),
  radians: $one((x) => x * (Math.PI / 180)),
  square: (x) => $mul(x, x),
  sign: (x) => $elementwise(x, (v) => (v > 0 ? 1 : v < 0 ? -1 : v + 0), x.kind === "i" ? "i" : "f"),
  exp(x) {
    if (!(x instanceof Complex) && !(x instanceof NdArray && x.im))
      return $elementwise(x, Math.exp);
    const a = $as(x),
      [d, im] = a.flat(),
      re = new Float64Array(d.length),
      out = new Float64Array(d.length);
    for (let n = 0; n < d.length; n++) {
      const s = Math.exp(d[n]);
      re[n] = s * Math.cos(im[n]);
      out[n] = im[n] === 0 ? im[n] : s * Math.sin(im[n]);
    }
    return $wrap(new NdArray(re, a.shape, "c", out));
  },
  abs: (x) =>
    typeof x === "number"
      ? Math.abs(x)
      : x instanceof Complex
        ? abs(x)
        : $wrap($arrays.unary("abs", $as(x))),
  isfinite(x) {
    const a = $as(x),
      [d, im] = a.flat(),
      out = new Uint8Array(d.length);
    for (let n = 0; n < d.length; n++)
      out[n] = d[n] - d[n] === 0 && (!im || im[n] - im[n] === 0) ? 1 : 0;
    return $wrap(new NdArray(out, a.shape, "b"));
  },
  isnan(x) {
    const a = $as(x),
      [d, im] = a.flat(),
      out = new Uint8Array(d.length);
    for (let n = 0; n < d.length; n++) out[n] = d[n] !== d[n] || (im && im[n] !== im[n]) ? 1 : 0;
    return $wrap(new NdArray(out, a.shape, "b"));
  },
  round: (x, digits = 0) =>
    x.kind === "i"
      ? x.copy()
      : $elementwise(x, digits ? (v) => $rint(v * 10 ** digits) / 10 ** digits : $rint),
  angle: (x) => {
    const a = $as(x, "c"),
      [d, im] = a.flat(),
      out = new Float64Array(d.length);
    for (let n = 0; n < d.length; n++) out[n] = Math.atan2(im[n], d[n]);
    return $wrap(new NdArray(out, a.shape, "f"));
  },
  maximum: (a, b) => $wrap($binary("max", a, b)),
  minimum: (a, b) => $wrap($binary("min", a, b)),
  hypot: (a, b) => $wrap($binary("hypot", a, b)),
  arctan2: (a, b) => $wrap($binary("atan2", a, b)),
  mod: (a, b) => $wrap($binary("mod", a, b)),
  remainder: (a, b) => $wrap($binary("mod", a, b)),
  clip: (x, low, high) => $np.minimum($np.maximum(x, low), high),
  nan_to_num: $fn("x nan", (x, nan = 0) =>
    $parts(x, (v) =>
      v !== v ? nan : v === Infinity ? Number.MAX_VALUE : v === -Infinity ? -Number.MAX_VALUE : v,
    ),
  ),
  isclose: $fn("a b rtol atol", (a, b, rtol = 1e-5, atol = 1e-8) => {
    const near = $le($np.abs($sub(a, b)), $add(atol, $mul(rtol, $np.abs(b))));
    return $or_($and_(near, $np.isfinite(b)), $eq(a, b));
  }),
  array_equal: (a, b) => {
    const x = $as(a),
      y = $as(b);
    return $alike(x.shape, y.shape) && $reduce("all", $binary("eq", x, y));
  },
  iscomplexobj: (x) => x instanceof Complex || (x instanceof NdArray && x.kind === "c"),

  array: $fn("x dtype", (x, dtype = null) => $as(x, $kind(dtype)).copy()),
  frombuffer: (bytes_) => {
    const view = new DataView(bytes_.buffer, bytes_.byteOffset, bytes_.length);
    const out = Float64Array.from({ length: bytes_.length / 4 }, (_, n) =>
      view.getFloat32(4 * n, true),
    );
    return new NdArray(out, [out.length], "f");
  },
  asarray: $fn("x dtype", (x, dtype = null) => $as(x, $kind(dtype))),
  ascontiguousarray: $fn("x dtype", (x, dtype = null) => {
    const a = $as(x, $kind(dtype)),
      [d, im] = a.flat();
    return new NdArray(d, a.ndim ? a.shape : [1], a.kind, im);
  }),
  atleast_1d: (x) => {
    const a = $as(x);
    return a.ndim ? a : a.reshape(1);
  },
  full: $fn("shape value dtype", (shape, value, dtype = null) => {
    const of = Array.isArray(shape) ? shape : [shape],
      kind =
        $kind(dtype) ?? (value instanceof Complex ? "c" : typeof value === "boolean" ? "b" : "f"),
      n = $product(of);
    const re = value instanceof Complex ? value.real : Number(value);
    return new NdArray(
      $store(kind, n).fill(re),
      of,
      kind,
      kind === "c" ? new Float64Array(n).fill(value instanceof Complex ? value.imag : 0) : null,
    );
  }),
  zeros: $fn("shape dtype", (shape, dtype = null) => $np.full(shape, 0, dtype ?? float)),
  ones: $fn("shape dtype", (shape, dtype = null) => $np.full(shape, 1, dtype ?? float)),
  empty: $fn("shape dtype", (shape, dtype = null) => $np.full(shape, 0, dtype ?? float)),
  zeros_like: (x) => $np.full($as(x).shape, 0, $as(x).dtype),
  ones_like: (x) => $np.full($as(x).shape, 1, $as(x).dtype),
  full_like: (x, v) => $np.full($as(x).shape, v, $as(x).dtype),
  eye: $fn("n dtype", (n, dtype = null) => $as($np.diag($np.ones(n)), $kind(dtype))),
  diag: (x) => {
    const a = $as(x);
    if (a.ndim === 1) {
      const n = a.size,
        out = $np.zeros([n, n], a.dtype),
        [d, im] = a.flat();
      for (let k = 0; k < n; k++) {
        out.data[k * (n + 1)] = d[k];
        if (im) out.im[k * (n + 1)] = im[k];
      }
      return out;
    }
    if (a.ndim !== 2) throw ValueError(`diag: an array of ${a.ndim} axes`);
    const n = Math.min(...a.shape);
    return new NdArray(a.data, [n], a.kind, a.im, [a.strides[0] + a.strides[1]], a.offset);
  },
  arange: $fn("a b step dtype", (a, b = null, step = 1, dtype = null) => {
    const [from, to] = b === null ? [0, a] : [a, b],
      n = Math.max(0, Math.ceil((to - from) / step)),
      by = from + step - from, // like NumPy, which uses the first two values
      out = new Float64Array(n);
    for (let k = 0; k < n; k++) out[k] = k ? from + k * by : from;
    return new NdArray(
      out,
      [n],
      $kind(dtype) ?? (Number.isInteger(from) && Number.isInteger(step) ? "i" : "f"),
    );
  }),
  linspace: (a, b, n = 50) => {
    const out = new Float64Array(n),
      step = (b - a) / Math.max(1, n - 1);
    for (let k = 0; k < n; k++) out[k] = k * step + a;
    if (n > 1) out[n - 1] = b;
    return new NdArray(out, [n], "f");
  },
  logspace: (a, b, n = 50) => $elementwise($np.linspace(a, b, n), (x) => 10 ** x),
  shape: (x) => $as(x).shape,
  size: (x) => $as(x).size,
  ndim: (x) => $as(x).ndim,
  broadcast_to: (x, shape) => $expanded($as(x), Array.isArray(shape) ? shape : [shape]),

  sum: $fn("x axis dtype keepdims", (x, axis = null, _ = null, keep = false) =>
    $reduce("sum", x, axis, keep),
  ),
  prod: $fn("x axis dtype", (x, axis = null) => $reduce("prod", x, axis)),
  mean: $fn("x axis keepdims", (x, axis = null, keep = false) => $reduce("mean", x, axis, keep)),
  max: $fn("x axis keepdims initial", (x, axis = null, keep = false, initial = undefined) =>
    $reduce("max", x, axis, keep, { initial }),
  ),
  min: $fn("x axis keepdims", (x, axis = null, keep = false) => $reduce("min", x, axis, keep)),
  all: $fn("x axis", (x, axis = null) => $reduce("all", x, axis)),
  any: $fn("x axis", (x, axis = null) => $reduce("any", x, axis)),
  median: $fn("x axis keepdims", (x, axis = null, keep = false) =>
    $reduce("median", x, axis, keep),
  ),
  std: $fn("x axis", (x, axis = null) => $as(x).std(axis)),
  argmax: $fn("x axis", (x, axis = null) => $reduce("argmax", x, axis)),
  argmin: $fn("x axis", (x, axis = null) => $reduce("argmin", x, axis)),
  ptp: $fn("x axis", (x, axis = null) => {
    const [high, low] = ["max", "min"].map((word) => $as($reduce(word, x, axis), $as(x).kind));
    return $wrap($binary("sub", high, low));
  }),
  percentile: $fn("x q axis", (x, q, axis = null) => $np.quantile(x, $div(q, 100), axis)),
  quantile: $fn("x q axis", (x, q, axis = null) => {
    const a = $as(x),
      qs = $as(q);
    if (axis !== null && a.ndim > 1) throw NotImplementedError("quantile: no axis here");
    const s = a.flat()[0].slice(),
      n = s.length,
      missing = s.some((v) => v !== v);
    if (!n) throw IndexError("quantile of nothing");
    return $elementwise(qs.ndim ? qs : qs.item(), (one) => {
      if (!(one >= 0 && one <= 1)) throw ValueError("a quantile is between 0 and 1");
      if (missing) return NaN;
      const at = one * (n - 1),
        low = Math.floor(at),
        t = at - low,
        p = $nth(s, low),
        r = low + 1 < n ? $least(s, low + 1) : p;
      return t >= 0.5 ? r - (r - p) * (1 - t) : p + (r - p) * t;
    });
  }),
  nanmean: (x) => {
    const k = $known(x);
    return $reduce("mean", k);
  },
  nansum: (x) => $reduce("sum", $known(x)),
  nanstd: (x) => $known(x).std(),
  nanmax: (x) => $knownMost("max", x),
  nanmin: (x) => $knownMost("min", x),
  nanmedian: (x) => $reduce("median", $known(x)),

  flatnonzero: (x) => {
    const [d] = $as(x, "b").flat(),
      out = [];
    for (let n = 0; n < d.length; n++) if (d[n]) out.push(n);
    return new NdArray(Float64Array.from(out), [out.length], "i");
  },
  where: (mask, a, b) => {
    const m = $as(mask),
      x = $as(a),
      y = $as(b),
      shape = $shared(m.shape, x.shape, y.shape),
      n = $product(shape);
    const [md] = $expanded(m, shape).flat(),
      [xd, xi] = $expanded(x, shape).flat(),
      [yd, yi] = $expanded(y, shape).flat();
    const kind =
      xi || yi ? "c" : x.kind === y.kind ? x.kind : x.kind === "f" || y.kind === "f" ? "f" : "i";
    const out = $store(kind, n),
      im = kind === "c" ? new Float64Array(n) : null;
    for (let k = 0; k < n; k++) out[k] = md[k] ? xd[k] : yd[k];
    if (im) for (let k = 0; k < n; k++) im[k] = md[k] ? (xi ? xi[k] : 0) : yi ? yi[k] : 0;
    return $wrap(new NdArray(out, shape, kind, im));
  },
  concatenate: $fn("parts axis", (given, axis = 0) => {
    const parts = [...$iter(given)].map((p) => $as(p)),
      along = axis < 0 ? axis + parts[0].ndim : axis,
      first = parts[0];
    const kind = parts.some((p) => p.kind === "c")
      ? "c"
      : parts.every((p) => p.kind === first.kind)
        ? first.kind
        : parts.every((p) => p.kind !== "f")
          ? "i"
          : "f";
    const shape = [...first.shape];
    shape[along] = parts.reduce((s, p) => s + p.shape[along], 0);
    for (const p of parts)
      if (
        p.ndim !== first.ndim ||
        p.shape.some((size, n) => n !== along && size !== first.shape[n])
      )
        throw ValueError("arrays that are joined differ in shape");
    const total = $product(shape),
      out = $store(kind, total),
      im = kind === "c" ? new Float64Array(total) : null;
    const outer = $product(shape.slice(0, along)),
      inner = $product(shape.slice(along + 1)),
      whole = shape[along] * inner;
    let at = 0;
    for (const p of parts) {
      const [d, pi] = p.flat(),
        own = p.shape[along] * inner;
      if (own < 8) {
        // copy short parts element by element
        for (let n = 0, from = 0; n < outer; n++)
          for (let k = 0, to = n * whole + at; k < own; k++, from++, to++) {
            out[to] = d[from];
            if (im && pi) im[to] = pi[from];
          }
        at += own;
        continue;
      }
      for (let n = 0; n < outer; n++) {
        out.set(d.subarray(n * own, (n + 1) * own), n * whole + at);
        if (im && pi) im.set(pi.subarray(n * own, (n + 1) * own), n * whole + at);
      }
      at += own;
    }
    return new NdArray(out, shape, kind, im);
  }),
  stack: $fn("parts axis", (given, axis = 0) => {
    const parts = [...$iter(given)].map((p) => $as(p)),
      at = axis < 0 ? axis + parts[0].ndim + 1 : axis;
    return $np.concatenate(
      parts.map((p) => {
        const shape = [...p.shape];
        shape.splice(at, 0, 1);
        const [d, im] = p.flat();
        return new NdArray(d, shape, p.kind, im);
      }),
      at,
    );
  }),
  vstack: (parts) =>
    $np.concatenate(
      [...$iter(parts)].map((p) => ($as(p).ndim === 1 ? $as(p).reshape(1, -1) : p)),
      0,
    ),
  hstack: (parts) => {
    const all_ = [...$iter(parts)].map((p) => $as(p));
    return $np.concatenate(all_, all_[0].ndim === 1 ? 0 : 1);
  },
  block: (rows) =>
    $np.concatenate(
      rows.map((row) => $np.concatenate(row, 1)),
      0,
    ),
  append: (x, more) => $np.concatenate([$as(x).ravel(), $as(more).ravel()]),
  r_: { __getitem__: (parts) => $np.concatenate(parts.map((p) => $np.atleast_1d(p))) },
  delete: (x, at) => {
    const a = $as(x).ravel(),
      kept = $np.full(a.size, true);
    kept.put($as(at, "i"), false);
    return a.at(kept);
  },
  repeat: $fn("x n axis", (x, n, axis = null) => {
    const a = axis === null ? $as(x).ravel() : $as(x),
      along = axis === null ? 0 : axis < 0 ? axis + a.ndim : axis,
      at = [];
    for (let k = 0; k < a.shape[along]; k++) for (let m = 0; m < n; m++) at.push(k);
    return a.at(
      $tuple([...Array.from({ length: along }, () => new Slice(null, null, null)), $as(at, "i")]),
    );
  }),
  tile: (x, reps) => {
    const a = $as(x).ravel(),
      [rows, cols] = Array.isArray(reps) ? reps : [1, reps],
      line = a.at($np.mod($np.arange(cols * a.size), a.size));
    return Array.isArray(reps) ? $np.repeat(line.reshape(1, -1), rows, 0) : line;
  },
  moveaxis: (x, from, to) => {
    const a = $as(x),
      order = a.shape.map((_, n) => n),
      [one] = order.splice(from < 0 ? from + a.ndim : from, 1);
    order.splice(to < 0 ? to + a.ndim : to, 0, one);
    return a.transpose(...order);
  },
  array_split: (x, parts) => {
    const n = len(x),
      out = [];
    if (!(parts > 0)) throw ValueError("array_split: there must be one part at least");
    let at = 0;
    for (let k = 0; k < parts; k++) {
      const size = Math.floor(n / parts) + (k < n % parts ? 1 : 0);
      out.push($get(x, new Slice(at, at + size, null)));
      at += size;
    }
    return out;
  },
  diff: $fn("x n axis prepend", (x, n = 1, axis = -1, prepend = undefined) => {
    let a = $as(x);
    const along = axis < 0 ? axis + a.ndim : axis;
    if (prepend !== undefined)
      a = $np.concatenate(
        [
          $as(prepend).ndim
            ? prepend
            : $np.full(
                a.shape.map((s, k) => (k === along ? 1 : s)),
                prepend,
              ),
          a,
        ],
        along,
      );
    const cut = (from, to) =>
      a.at(
        $tuple(
          a.shape.map((_, k) =>
            k === along ? new Slice(from, to, null) : new Slice(null, null, null),
          ),
        ),
      );
    for (let k = 0; k < n; k++) a = $as((a.kind === "b" ? $ne : $sub)(cut(1, null), cut(null, -1)));
    return a;
  }),
  cumsum: $fn("x axis", (x, axis = null) => {
    let a = $as(x);
    if (axis === null) a = a.ravel();
    const along = axis === null ? 0 : axis < 0 ? axis + a.ndim : axis,
      [d, im] = a.flat(),
      kind = a.kind === "b" ? "i" : a.kind;
    const out = Float64Array.from(d),
      oi = im ? Float64Array.from(im) : null,
      size = a.shape[along],
      inner = $product(a.shape.slice(along + 1)),
      outer = $product(a.shape.slice(0, along));
    for (let o = 0; o < outer; o++)
      for (let k = 1; k < size; k++)
        for (let i = 0; i < inner; i++) {
          const at = (o * size + k) * inner + i;
          out[at] += out[at - inner];
          if (oi) oi[at] += oi[at - inner];
        }
    if (kind === "i") $whole(out, "cumsum");
    return new NdArray(out, a.shape, kind, oi);
  }),
  unwrap: $fn("x axis", (x, axis = -1) => {
    const a = $as(x),
      [d] = a.flat(),
      out = new Float64Array(d.length),
      turn = 2 * Math.PI,
      size = a.shape[a.ndim - 1];
    if (axis !== -1 && axis !== a.ndim - 1)
      throw NotImplementedError("unwrap: the last axis alone here");
    let off = 0;
    for (let n = 0; n < d.length; n++) {
      if (n % size === 0) {
        off = 0;
        out[n] = d[n];
      } else {
        const step = d[n] - d[n - 1];
        let m = step + Math.PI - turn * Math.floor((step + Math.PI) / turn) - Math.PI;
        if (m === -Math.PI && step > 0) m = Math.PI;
        if (!(Math.abs(step) < Math.PI)) off += m - step;
        out[n] = d[n] + off;
      }
    }
    return new NdArray(out, a.shape, "f");
  }),
  interp: (x, xs, ys) => {
    if ($as(ys).im)
      return $joint(
        $np.interp(x, xs, $as(ys).real),
        $np.where($and_($np.isnan(x), $as(xs).size > 1), 0, $np.interp(x, xs, $as(ys).imag)),
      );
    const [at] = $as(xs).flat(),
      [of] = $as(ys).flat(),
      n = at.length;
    let k = 0;
    return $elementwise(x, (v) => {
      if (n === 1) return of[0];
      if (v !== v) return NaN;
      if (v <= at[0]) return of[0];
      if (v >= at[n - 1]) return of[n - 1];
      if (!(at[k] <= v)) k = 0;
      if (!(v < at[Math.min(k + 64, n - 1)])) {
        let low = k,
          high = n - 1;
        while (high - low > 1) {
          const m = (low + high) >> 1;
          if (at[m] <= v) low = m;
          else high = m;
        }
        k = low;
      }
      while (at[k + 1] <= v) k++;
      if (at[k] === v) return of[k];
      const slope = (of[k + 1] - of[k]) / (at[k + 1] - at[k]);
      return slope * (v - at[k]) + of[k];
    });
  },
  searchsorted: $fn("a v side", (a, v, side = "left") => {
    const [d] = $as(a).flat(),
      right = side === "right";
    return $elementwise(
      v,
      (x) => {
        let low = 0,
          high = d.length;
        while (low < high) {
          const m = (low + high) >> 1;
          if (right ? !$less(x, d[m]) : $less(d[m], x)) low = m + 1;
          else high = m;
        }
        return low;
      },
      "i",
    );
  }),
  argsort: $fn("x kind", (x) => {
    const [d] = $as(x).flat();
    return $as(
      Array.from(d, (_, n) => n).sort((p, q) =>
        $less(d[p], d[q]) ? -1 : $less(d[q], d[p]) ? 1 : p - q,
      ),
      "i",
    );
  }),
  unique: $fn("x return_inverse return_counts", (x, inverse = false, counts = false) => {
    const a = $as(x),
      [d] = a.flat(),
      s = new Float64Array([...new Set(d)]).sort(),
      out = new NdArray(s, [s.length], a.kind);
    if (!inverse && !counts) return out;
    const at = $np.searchsorted(out, a.ravel());
    return $tuple([
      out,
      ...(inverse ? [at] : []),
      ...(counts ? [$np.bincount(at, null, s.length)] : []),
    ]);
  }),
  bincount: $fn("x weights minlength", (x, weights = null, minlength = 0) => {
    const [d] = $as(x).flat(),
      [w] = weights === null ? [null] : $as(weights).flat();
    let most = minlength;
    for (let n = 0; n < d.length; n++) {
      if (!(d[n] >= 0)) throw ValueError(`bincount: ${d[n]} is negative`);
      most = Math.max(most, d[n] + 1);
    }
    const out = new Float64Array(most);
    for (let n = 0; n < d.length; n++) out[d[n]] += w ? w[n] : 1;
    return new NdArray(out, [most], w && d.length ? "f" : "i");
  }),
  add: Object.assign((a, b) => $add(a, b), {
    at(target, index, value) {
      const { positions, shape } = $resolve(target, $as(index)),
        [d] = $expanded($as(value), shape).flat();
      positions.forEach((at, n) => {
        target.data[at] += d[n];
      });
    },
  }),
  ix_: (...lists) =>
    $tuple(
      lists.map((one, n) =>
        $as(one, len(one) ? null : "i").reshape(...lists.map((_, m) => (m === n ? -1 : 1))),
      ),
    ),
  kron: (a, b) => {
    const x = $as(a),
      y = $as(b),
      [n, m] = x.shape,
      [p, q] = y.shape;
    return $as($mul(x.reshape(n, 1, m, 1), y.reshape(1, p, 1, q))).reshape(n * p, m * q);
  },
  tensordot: $fn("a b axes", (a, b) => {
    const x = $as(a),
      y = $as(b),
      k = y.shape[0];
    return $as($np.matmul(x.reshape(-1, k), y.reshape(k, -1))).reshape(
      ...x.shape.slice(0, -1),
      ...y.shape.slice(1),
    );
  }),
  convolve: $fn("a b mode", (a, b) => {
    if ($as(a).im) return $joint($np.convolve($as(a).real, b), $np.convolve($as(a).imag, b));
    const [x] = $as(a).flat(),
      [y] = $as(b).flat(),
      n = Math.max(x.length, y.length),
      skip = Math.floor((Math.min(x.length, y.length) - 1) / 2),
      out = new Float64Array(n);
    for (let k = 0; k < n; k++) {
      let s = 0;
      for (let j = Math.max(0, k + skip - x.length + 1); j < y.length && j <= k + skip; j++)
        s += y[j] * x[k + skip - j];
      out[k] = s;
    }
    return new NdArray(out, [n], "f");
  }),
  outer: (a, b) => $mul($as(a).reshape(-1, 1), $as(b).reshape(1, -1)),
  vdot: (a, b) => $reduce("sum", $mul($as(a).ravel().conj(), $as(b).ravel())),
  trace: (x) => $reduce("sum", $np.diag(x)),
  result_type: (...x) =>
    x.some((one) => $kind(one) === "c" || $kindOf(one) === "c") ? complex : float,
  dtype: (x) => ({ names: null, kind: $kind(x) }),
  finfo: () => ({ eps: Number.EPSILON, max: Number.MAX_VALUE, tiny: 2 ** -1022 }),
  errstate: () => ({}),
  matmul(a, b) {
    let x = $as(a),
      y = $as(b);
    const front = x.ndim === 1,
      back = y.ndim === 1;
    if (front) x = x.reshape(1, -1);
    if (back) y = y.reshape(-1, 1);
    const [n, k] = x.shape.slice(-2),
      [k2, m] = y.shape.slice(-2);
    if (k !== k2) throw ValueError(`matrices do not fit: ${repr(x.shape)} and ${repr(y.shape)}`);
    const many = $shared(x.shape.slice(0, -2), y.shape.slice(0, -2)),
      count = $product(many);
    const [xd, xi] = $expanded(x, [...many, n, k]).flat(),
      [yd, yi] = $expanded(y, [...many, k, m]).flat();
    const out = new Float64Array(count * n * m),
      im = xi || yi ? new Float64Array(out.length) : null,
      kind = x.kind === "f" || y.kind === "f" ? "f" : "i",
      shape = [...many, ...(front ? [] : [n]), ...(back ? [] : [m])];
    if (!im && n * m <= 256 && k > 4) {
      // compute small results as dot products
      for (let c = 0; c < count; c++)
        for (let i = 0; i < n; i++)
          for (let l = 0; l < m; l++) {
            let sum_ = 0;
            for (let j = 0, a = (c * n + i) * k, b = c * k * m + l; j < k; j++, a++, b += m)
              sum_ += xd[a] * yd[b];
            out[(c * n + i) * m + l] = sum_;
          }
      if (kind === "i") $whole(out, "matmul");
      return $wrap(new NdArray(out, shape, kind));
    }
    for (let c = 0; c < count; c++)
      for (let i = 0; i < n; i++)
        for (let j = 0; j < k; j++) {
          const at = (c * n + i) * k + j,
            v = xd[at],
            w = xi ? xi[at] : 0,
            to = (c * n + i) * m,
            from = (c * k + j) * m;
          if (!im) {
            for (let l = 0; l < m; l++) out[to + l] += v * yd[from + l];
          } else
            for (let l = 0; l < m; l++) {
              const r = yd[from + l],
                s = yi ? yi[from + l] : 0;
              out[to + l] += v * r - w * s;
              im[to + l] += v * s + w * r;
            }
        }
    if (!im && kind === "i") $whole(out, "matmul");
    return $wrap(new NdArray(out, shape, im ? "c" : kind, im));
  },
  einsum(spec, ...given) {
    let [left, right] = spec.replaceAll(" ", "").split("->");
    const ops = given.map((x) => $as(x)),
      words = left.split(",");
    const dots = Math.max(
      0,
      ...words.map((w, n) => (w.includes("...") ? ops[n].ndim - (w.length - 3) : 0)),
    );
    const named = (w, own) => w.replace("...", "ABCDEFGH".slice(dots - own, dots));
    const letters = words.map((w, n) => [...named(w, ops[n].ndim - (w.length - 3))]);
    if (right === undefined) {
      const all_ = letters.flat(),
        once = [...new Set(all_)]
          .filter((c) => c > "Z" && all_.filter((o) => o === c).length === 1)
          .sort();
      right = (dots ? "..." : "") + once.join("");
    }
    const out = [...named(right, dots)],
      every = [...out, ...new Set(letters.flat().filter((c) => !out.includes(c)))];
    const size = {};
    letters.forEach((own, n) =>
      own.forEach((c, k) => {
        if (!(size[c] > 1)) size[c] = ops[n].shape[k];
      }),
    );
    const plain = letters.every((own) => new Set(own).size === own.length);
    if (ops.length === 2 && plain) {
      // a product of two matrices
      const [p, q] = letters,
        both = p.filter((c) => q.includes(c)),
        many = both.filter((c) => out.includes(c)),
        gone = both.filter((c) => !out.includes(c));
      const [left_, right_] = [
          p.filter((c) => !both.includes(c)),
          q.filter((c) => !both.includes(c)),
        ],
        of = (list) => $product(list.map((c) => size[c]));
      if ([...left_, ...right_].every((c) => out.includes(c))) {
        const turned = (x, own, order) => x.transpose(...order.map((c) => own.indexOf(c)));
        const x = turned(
          $expanded(
            ops[0],
            p.map((c) => size[c]),
          ),
          p,
          [...many, ...left_, ...gone],
        ).reshape(of(many), of(left_), of(gone));
        const y = turned(
          $expanded(
            ops[1],
            q.map((c) => size[c]),
          ),
          q,
          [...many, ...gone, ...right_],
        ).reshape(of(many), of(gone), of(right_));
        const order = [...many, ...left_, ...right_],
          made = $as($np.matmul(x, y)).reshape(...order.map((c) => size[c]));
        return $wrap(order.length ? turned(made, order, out) : made.reshape([]));
      }
    }
    let product = null;
    letters.forEach((own, n) => {
      const shape = every.map((c) => (own.includes(c) ? size[c] : 1)),
        strides = every.map((c) =>
          own.reduce((s, o, k) => s + (o === c && ops[n].shape[k] > 1 ? ops[n].strides[k] : 0), 0),
        );
      const view = new NdArray(ops[n].data, shape, ops[n].kind, ops[n].im, strides, ops[n].offset);
      product = product === null ? view : $binary("mul", product, view);
    });
    const axes = every.map((_, n) => n).slice(out.length);
    product = $expanded(
      product,
      every.map((c) => size[c]),
    );
    return axes.length ? $reduce("sum", product, $tuple(axes)) : $wrap(product);
  },
});
$np.intp = $np.int64;
// The order of numbers, with NaN last.
const $less = (a, b) => a < b || (b !== b && a === a);
const $known = (x) => {
  const a = $as(x).ravel();
  return a.at($invert($np.isnan(a)));
};
const $knownMost = (word, x) => {
  const known = $known(x);
  return known.size || !$as(x).size ? $reduce(word, known) : NaN;
};

// ---- linear algebra -------------------------------------------------------------------------

const $rows = (x) => {
  const a = $as(x),
    [n, m] = a.shape,
    [d] = a.flat();
  return Array.from({ length: n }, (_, k) => Float64Array.from(d.subarray(k * m, (k + 1) * m)));
};
const $fromRows = (rows, m) => {
  const out = new Float64Array(rows.length * m);
  rows.forEach((r, n) => out.set(r, n * m));
  return new NdArray(out, [rows.length, m], "f");
};
const LinAlgError = $exception("LinAlgError", ValueError);

// Solve A x = b for one matrix; the rows of b are right-hand sides.
function $solved(A, B) {
  const n = A.length,
    low = A.every((row, i) => row.every((v, j) => j <= i || v === 0)),
    up = !low && A.every((row, i) => row.every((v, j) => j >= i || v === 0));
  if ((low || up) && A.every((row, i) => row[i] !== 0)) {
    // triangular matrices need no elimination
    for (let step = 0; step < n; step++) {
      const k = low ? step : n - 1 - step,
        own = B[k];
      for (let j = 0; j < own.length; j++) own[j] /= A[k][k];
      for (let i = low ? k + 1 : 0; i < (low ? n : k); i++) {
        const f = A[i][k],
          row = B[i];
        if (f !== 0) for (let j = 0; j < row.length; j++) row[j] -= f * own[j];
      }
    }
    return B;
  }
  for (let k = 0; k < n; k++) {
    let at = k;
    for (let i = k + 1; i < n; i++) if (Math.abs(A[i][k]) > Math.abs(A[at][k])) at = i;
    if (A[at][k] === 0) throw LinAlgError("Singular matrix");
    [A[k], A[at]] = [A[at], A[k]];
    [B[k], B[at]] = [B[at], B[k]];
    for (let i = k + 1; i < n; i++) {
      const f = A[i][k] / A[k][k];
      if (f === 0) continue;
      for (let j = k; j < n; j++) A[i][j] -= f * A[k][j];
      for (let j = 0; j < B[i].length; j++) B[i][j] -= f * B[k][j];
    }
  }
  for (let k = n - 1; k >= 0; k--)
    for (let j = 0; j < B[k].length; j++) {
      let s = B[k][j];
      for (let i = k + 1; i < n; i++) s -= A[k][i] * B[i][j];
      B[k][j] = s / A[k][k];
    }
  return B;
}

// Return (U, singular values, V) of a matrix with at least as many rows as columns, by one-sided
// Jacobi rotations.
function $jacobi(x) {
  const U = $rows($as(x).T),
    m = U.length,
    V = $rows($np.eye(m)); // rows hold the columns of V
  const n = m ? U[0].length : 0;
  for (let sweep = 0; sweep < 60; sweep++) {
    let off = 0;
    for (let p = 0; p < m; p++)
      for (let q = p + 1; q < m; q++) {
        let a = 0,
          b = 0,
          c = 0;
        for (let k = 0; k < n; k++) {
          a += U[p][k] * U[p][k];
          b += U[q][k] * U[q][k];
          c += U[p][k] * U[q][k];
        }
        if (Math.abs(c) <= 4e-16 * Math.sqrt(a * b) || c === 0) continue;
        off = Math.max(off, Math.abs(c) / Math.sqrt(a * b));
        const z = (b - a) / (2 * c),
          t = Math.sign(z || 1) / (Math.abs(z) + Math.sqrt(1 + z * z)),
          cs = 1 / Math.sqrt(1 + t * t),
          sn = cs * t;
        for (const W of [U, V])
          for (let k = 0; k < W[p].length; k++) {
            const v = W[p][k],
              w = W[q][k];
            W[p][k] = cs * v - sn * w;
            W[q][k] = sn * v + cs * w;
          }
      }
    if (off < 1e-15) break;
  }
  const size = U.map((u) => Math.sqrt(u.reduce((s, v) => s + v * v, 0))),
    order = size.map((_, k) => k).sort((a, b) => size[b] - size[a]);
  return [
    order.map((k) => (size[k] > 0 ? U[k].map((v) => v / size[k]) : U[k])),
    order.map((k) => size[k]),
    order.map((k) => V[k]),
  ];
}

// Householder's reduction of a symmetric matrix to diagonals d, e; V becomes its rotation.
function $tridiagonal(V, d, e) {
  const n = V.length;
  for (let j = 0; j < n; j++) d[j] = V[n - 1][j];
  for (let i = n - 1; i > 0; i--) {
    let scale = 0,
      h = 0;
    for (let k = 0; k < i; k++) scale += Math.abs(d[k]);
    if (scale === 0) {
      e[i] = d[i - 1];
      for (let j = 0; j < i; j++) {
        d[j] = V[i - 1][j];
        V[i][j] = 0;
        V[j][i] = 0;
      }
    } else {
      for (let k = 0; k < i; k++) {
        d[k] /= scale;
        h += d[k] * d[k];
      }
      let f = d[i - 1],
        g = f > 0 ? -Math.sqrt(h) : Math.sqrt(h);
      e[i] = scale * g;
      h -= f * g;
      d[i - 1] = f - g;
      for (let j = 0; j < i; j++) e[j] = 0;
      for (let j = 0; j < i; j++) {
        f = d[j];
        V[j][i] = f;
        g = e[j] + V[j][j] * f;
        for (let k = j + 1; k < i; k++) {
          g += V[k][j] * d[k];
          e[k] += V[k][j] * f;
        }
        e[j] = g;
      }
      f = 0;
      for (let j = 0; j < i; j++) {
        e[j] /= h;
        f += e[j] * d[j];
      }
      const hh = f / (h + h);
      for (let j = 0; j < i; j++) e[j] -= hh * d[j];
      for (let j = 0; j < i; j++) {
        f = d[j];
        g = e[j];
        for (let k = j; k < i; k++) V[k][j] -= f * e[k] + g * d[k];
        d[j] = V[i - 1][j];
        V[i][j] = 0;
      }
    }
    d[i] = h;
  }
  for (let i = 0; i < n - 1; i++) {
    V[n - 1][i] = V[i][i];
    V[i][i] = 1;
    const h = d[i + 1];
    if (h !== 0) {
      for (let k = 0; k <= i; k++) d[k] = V[k][i + 1] / h;
      const g = new Float64Array(i + 1);
      for (let k = 0; k <= i; k++) {
        const row = V[k],
          w = row[i + 1];
        for (let j = 0; j <= i; j++) g[j] += w * row[j];
      }
      for (let k = 0; k <= i; k++) {
        const row = V[k],
          w = d[k];
        for (let j = 0; j <= i; j++) row[j] -= g[j] * w;
      }
    }
    for (let k = 0; k <= i; k++) V[k][i + 1] = 0;
  }
  for (let j = 0; j < n; j++) {
    d[j] = V[n - 1][j];
    V[n - 1][j] = 0;
  }
  if (n) V[n - 1][n - 1] = 1;
  e[0] = 0;
}

// Eigenvalues d, and eigenvectors in the columns of V, from diagonals d, e, by the QL algorithm.
function $ql(V, d, e) {
  const n = V.length;
  // the rotations combine columns, which are rows of the transpose
  const W = Array.from({ length: n }, (_, j) => Float64Array.from(V, (row) => row[j]));
  for (let i = 1; i < n; i++) e[i - 1] = e[i];
  if (n) e[n - 1] = 0;
  let f = 0,
    most = 0;
  for (let l = 0; l < n; l++) {
    most = Math.max(most, Math.abs(d[l]) + Math.abs(e[l]));
    let m = l;
    while (m < n - 1 && Math.abs(e[m]) > Number.EPSILON * most) m++;
    if (m > l) {
      do {
        let g = d[l],
          p = (d[l + 1] - g) / (2 * e[l]),
          r = Math.hypot(p, 1);
        if (p < 0) r = -r;
        d[l] = e[l] / (p + r);
        d[l + 1] = e[l] * (p + r);
        const dl1 = d[l + 1],
          h = g - d[l],
          el1 = e[l + 1];
        for (let i = l + 2; i < n; i++) d[i] -= h;
        f += h;
        p = d[m];
        let c = 1,
          c2 = 1,
          c3 = 1,
          s = 0,
          s2 = 0;
        for (let i = m - 1; i >= l; i--) {
          c3 = c2;
          c2 = c;
          s2 = s;
          g = c * e[i];
          const k = c * p;
          r = Math.hypot(p, e[i]);
          e[i + 1] = s * r;
          s = e[i] / r;
          c = p / r;
          p = c * d[i] - s * g;
          d[i + 1] = k + s * (c * g + s * d[i]);
          const a = W[i],
            b = W[i + 1];
          for (let q = 0; q < n; q++) {
            const v = b[q];
            b[q] = s * a[q] + c * v;
            a[q] = c * a[q] - s * v;
          }
        }
        p = (-s * s2 * c3 * el1 * e[l]) / dl1;
        e[l] = s * p;
        d[l] = c * p;
      } while (Math.abs(e[l]) > Number.EPSILON * most);
    }
    d[l] += f;
    e[l] = 0;
  }
  V.forEach((row, k) => {
    for (let j = 0; j < n; j++) row[j] = W[j][k];
  });
}

function $batched(x, fn) {
  const a = $as(x);
  if (a.ndim <= 2) return fn(a, null);
  const count = a.shape.slice(0, -2),
    n = $product(count),
    flat = a.reshape(n, ...a.shape.slice(-2));
  const parts = Array.from({ length: n }, (_, k) => fn(flat.at(k), k)),
    first = parts[0];
  return $np.stack(parts).reshape(...count, ...first.shape);
}

$np.linalg = {
  LinAlgError,
  norm: $fn("x axis keepdims", (x, axis = null, keep = false) =>
    $np.sqrt($reduce("sum", $mul($np.abs(x), $np.abs(x)), axis, keep)),
  ),
  solve(A, b) {
    const y = $as(b);
    const single = y.ndim === 1 && $as(A).ndim === 2;
    const batches = $as(A).ndim > 2 ? y.reshape(-1, ...y.shape.slice(-2)) : null;
    return $batched(A, (one, k) => {
      const of = k === null ? y : batches.at(k),
        rows = single ? Array.from(of.flat()[0], (v) => Float64Array.of(v)) : $rows(of);
      const found = $solved($rows(one), rows);
      return single
        ? $as(
            found.map((r) => r[0]),
            "f",
          )
        : $fromRows(found, of.shape[of.ndim - 1]);
    });
  },
  inv: (A) =>
    $batched(A, (one) =>
      $fromRows($solved($rows(one), $rows($np.eye(one.shape[0]))), one.shape[0]),
    ),
  cholesky: (A) => {
    const L = $rows(A),
      n = L.length;
    for (let j = 0; j < n; j++)
      for (let i = j; i < n; i++) {
        let s = L[i][j];
        for (let k = 0; k < j; k++) s -= L[i][k] * L[j][k];
        if (i === j) {
          if (!(s > 0)) throw LinAlgError("Matrix is not positive definite");
          L[j][j] = Math.sqrt(s);
        } else {
          L[i][j] = s / L[j][j];
          L[j][i] = 0;
        }
      }
    return $fromRows(L, n);
  },
  svd(x) {
    const a = $as(x);
    if (a.shape[0] < a.shape[1]) {
      const [u, s, v] = $jacobi($np.vstack([a, $np.zeros([a.shape[1] - a.shape[0], a.shape[1]])]));
      return $tuple([null, $as(s.slice(0, a.shape[0]), "f"), $fromRows(v, a.shape[1]), u]);
    }
    const [u, s, v] = $jacobi(a);
    return $tuple([$fromRows(u, a.shape[0]).T, $as(s, "f"), $fromRows(v, a.shape[1])]);
  },
  pinv: $fn("x rcond", (x, rcond = 1e-15) =>
    $batched(x, (one) => {
      if (one.shape[0] < one.shape[1]) return $np.linalg.pinv(one.T, rcond).T;
      const [u, s, v] = $jacobi(one),
        least = rcond * (s[0] ?? 0),
        scaled = v.map((row, k) => row.map((w) => (s[k] > least ? w / s[k] : 0)));
      return $np.matmul($fromRows(scaled, one.shape[1]).T, $fromRows(u, one.shape[0]));
    }),
  ),
  lstsq: $fn("A b rcond", (A, b, rcond = null) => {
    const [u, s, v] = $jacobi(A),
      a = $as(A),
      least = (rcond ?? Number.EPSILON * Math.max(...a.shape)) * (s[0] ?? 0);
    const scaled = v.map((row, k) => row.map((w) => (s[k] > least ? w / s[k] : 0)));
    const found = $np.matmul(
      $fromRows(scaled, a.shape[1]).T,
      $np.matmul($fromRows(u, a.shape[0]), b),
    );
    return $tuple([found, null, s.filter((x) => x > least).length, $as(s, "f")]);
  }),
  eigh(A) {
    const V = $rows(A),
      n = V.length,
      d = new Float64Array(n),
      e = new Float64Array(n);
    $tridiagonal(V, d, e);
    $ql(V, d, e);
    const order = Array.from(d, (_, k) => k).sort((p, q) => d[p] - d[q]);
    return $tuple([
      $as(
        order.map((k) => d[k]),
        "f",
      ),
      $fromRows(
        V.map((row) => order.map((k) => row[k])),
        n,
      ),
    ]);
  },
  qr: $fn("A mode", (A, mode) => {
    if (mode !== "r") throw NotImplementedError('qr: gives "r" alone here');
    const M = $rows(A),
      n = M.length,
      m = n ? M[0].length : 0;
    for (let k = 0; k < Math.min(n, m); k++) {
      let size = 0;
      for (let i = k; i < n; i++) size += M[i][k] ** 2;
      size = Math.sqrt(size);
      if (size === 0) continue;
      const alpha = M[k][k] > 0 ? -size : size,
        v = new Float64Array(n);
      for (let i = k; i < n; i++) v[i] = M[i][k];
      v[k] -= alpha;
      let vv = 0;
      for (let i = k; i < n; i++) vv += v[i] ** 2;
      for (let j = k; j < m; j++) {
        let s = 0;
        for (let i = k; i < n; i++) s += v[i] * M[i][j];
        s = (2 * s) / vv;
        for (let i = k; i < n; i++) M[i][j] -= s * v[i];
      }
      for (let i = k + 1; i < n; i++) M[i][k] = 0;
    }
    return $fromRows(M.slice(0, Math.min(n, m)), m);
  }),
};
// Fourier transform in place, for a size that is a power of two.
function $fft(re, im, sign) {
  const n = re.length;
  if (n & (n - 1)) throw NotImplementedError("fft: the size must be a power of two here");
  for (let i = 1, j = 0; i < n; i++) {
    let bit = n >> 1;
    for (; j & bit; bit >>= 1) j ^= bit;
    j ^= bit;
    if (i < j) {
      [re[i], re[j]] = [re[j], re[i]];
      [im[i], im[j]] = [im[j], im[i]];
    }
  }
  for (let size = 2; size <= n; size *= 2)
    for (let k = 0; k < size / 2; k++) {
      const turn = (sign * 2 * Math.PI * k) / size,
        c = Math.cos(turn),
        s = Math.sin(turn);
      for (let i = k; i < n; i += size) {
        const j = i + size / 2,
          a = re[j] * c - im[j] * s,
          b = re[j] * s + im[j] * c;
        re[j] = re[i] - a;
        im[j] = im[i] - b;
        re[i] += a;
        im[i] += b;
      }
    }
}
$np.fft = {
  // Along the last axis.
  fft: $fn("x axis", (x, axis = -1) => {
    const array = $as(x, "c"),
      n = array.shape[array.shape.length - 1];
    if (axis !== -1 && axis !== array.shape.length - 1)
      throw NotImplementedError("fft: the last axis alone here");
    const [re, im] = array.flat().map((part) => Float64Array.from(part));
    for (let k = 0; k < re.length; k += n) $fft(re.subarray(k, k + n), im.subarray(k, k + n), -1);
    return new NdArray(re, array.shape, "c", im);
  }),
  rfft(x, size) {
    const [d] = $as(x).flat(),
      re = new Float64Array(size),
      im = new Float64Array(size),
      half = size / 2 + 1;
    re.set(d.subarray(0, size));
    $fft(re, im, -1);
    return new NdArray(re.slice(0, half), [half], "c", im.slice(0, half));
  },
  irfft(x, size) {
    const [d, i] = $as(x, "c").flat(),
      re = new Float64Array(size),
      im = new Float64Array(size);
    for (let k = 0; k <= size / 2; k++) {
      re[k] = d[k];
      im[k] = i[k];
      if (k && k < size / 2) {
        re[size - k] = d[k];
        im[size - k] = -i[k];
      }
    }
    $fft(re, im, 1);
    return new NdArray(
      re.map((v) => v / size),
      [size],
      "f",
    );
  },
  fftfreq: (n, d) =>
    new NdArray(
      Float64Array.from({ length: n }, (_, k) => (2 * k < n ? k : k - n) * (1 / (n * d))),
      [n],
      "f",
    ),
};
$module("numpy", ($m) => Object.assign($m, $np));
$module("numpy.typing", ($m) =>
  Object.assign($m, { NDArray: new Type("NDArray"), ArrayLike: new Type("ArrayLike") }),
);
