// Appended to the runtime and the translation of arithmetic.py; it answers calls line by line.
// A double is sent as the sixteen hexadecimal digits of its bits, so that NaN and -0 are preserved.

const $hexed = (x) => {
  const bits = Buffer.alloc(8);
  bits.writeDoubleBE(x);
  return bits.toString("hex");
};
const $unhexed = (text) => Buffer.from(text, "hex").readDoubleBE();
const $sent = {
  d: $unhexed,
  c: ([real, imag]) => new Complex($unhexed(real), $unhexed(imag)),
  a: ({ kind, shape, strides, offset, data, im }) =>
    new NdArray(
      (kind === "b" ? Uint8Array : Float64Array).from(data, $unhexed),
      shape,
      kind,
      im ? Float64Array.from(im, $unhexed) : null,
      strides,
      offset,
    ),
  l: (items) => items.map($received),
  t: (items) => $tuple(items.map($received)),
  o: (hex) => Uint8Array.from(Buffer.from(hex, "hex")),
  slice: (parts) => new Slice(...parts.map($received)),
  dots: () => $ellipsis,
  type: (name) => ({ float, int, bool, complex })[name],
};
function $received(x) {
  if (x === null || typeof x !== "object") return x;
  const [[key, value]] = Object.entries(x);
  return $sent[key](value);
}
function $answer(x) {
  if (typeof x === "number") return { d: $hexed(x) };
  if (x == null || typeof x !== "object") return x ?? null;
  if (x instanceof Complex) return { c: [$hexed(x.real), $hexed(x.imag)] };
  if (x instanceof NdArray) {
    const [data, im] = x.flat();
    return {
      a: {
        kind: x.kind,
        shape: [...x.shape],
        data: Array.from(data, $hexed),
        im: im && Array.from(im, $hexed),
      },
    };
  }
  if (Array.isArray(x)) return { [x.$t ? "t" : "l"]: Array.from(x, $answer) };
  if (x instanceof Uint8Array) return { o: Buffer.from(x).toString("hex") };
  if (x instanceof Dict)
    return { m: x.items().map((pair) => pair.map($answer)) };
  if (x instanceof PySet) return { s: [...x].map($answer) };
  throw new Error(`no way to answer ${repr(x)}`);
}

const { createInterface } = await import("node:readline");
for await (const line of createInterface({ input: process.stdin })) {
  const { name, args } = JSON.parse(line);
  let out;
  try {
    out = {
      value: $answer($import("arithmetic")[name](...args.map($received))),
    };
  } catch (e) {
    const kinds = [];
    for (let c = e.constructor; c && c.$title; c = Object.getPrototypeOf(c))
      kinds.push(c.$title);
    out = {
      error: [...kinds, "Error"],
      text: kinds.length ? e.message : String(e.stack),
    };
  }
  process.stdout.write(`${JSON.stringify(out)}\n`);
}
