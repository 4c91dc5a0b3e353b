// Python's semantics for the JavaScript that translate.py writes.
// Names with $ belong to the translator; the other names are Python's own.

const $modules = new Map(),
  $loaders = new Map();

function $module(name, load) {
  $loaders.set(name, load);
}

function $import(name) {
  if (!$modules.has(name)) {
    const load = $loaders.get(name);
    if (!load) throw new Error(`no module ${name}`);
    const made = {};
    $modules.set(name, made);
    load(made);
  }
  return $modules.get(name);
}

// ---- functions and classes -----------------------------------------------------------------

class Kw {
  constructor(of) {
    this.of = of;
  }
}
const $kw = (of) => new Kw(of);
const $named = (d) => (d instanceof Dict ? Object.fromEntries($items(d)) : d);

// Add keyword arguments to a function: "a b *args =keyword_only **kwargs"; without `words`, no
// caller uses keywords.
function $def(fn, words) {
  if (words === undefined) {
    fn.$def = true;
    return fn;
  }
  const names = words ? words.split(" ") : [],
    p = names.filter((n) => /^\w/.test(n)),
    k = names.filter((n) => n[0] === "=").map((n) => n.slice(1));
  const v = names.some((n) => /^\*\w/.test(n)),
    w = names.some((n) => n.startsWith("**")),
    name = fn.name || "a function";
  const simple = !v && !k.length && !w;
  const out = function (...args) {
    const kw = args.length && args[args.length - 1] instanceof Kw ? args.pop().of : null;
    if (simple && !kw) {
      if (args.length > p.length) throw TypeError(`${name}() takes ${p.length} arguments`);
      return fn.apply(this, args);
    }
    const full = args.slice(0, p.length),
      rest = args.slice(p.length);
    while (full.length < p.length) full.push(undefined);
    if (v) full.push(rest);
    else if (rest.length) throw TypeError(`${name}() takes ${p.length} arguments`);
    const at = full.length,
      more = w ? $dict([]) : null;
    for (let n = 0; n < k.length; n++) full.push(undefined);
    if (w) full.push(more);
    for (const key in kw ?? {}) {
      const n = p.indexOf(key),
        m = k.indexOf(key);
      if (n >= 0) full[n] = kw[key];
      else if (m >= 0) full[at + m] = kw[key];
      else if (w) more.set(key, kw[key]);
      else throw TypeError(`${name}() has no argument ${key}`);
    }
    return fn.apply(this, full);
  };
  out.$def = true;
  return out;
}

// Give a function of the runtime keyword arguments; `names` are in order.
const $fn = (names, fn) => $def(fn, names);

class Property {
  constructor(fn, cached) {
    this.fn = fn;
    this.cached = cached;
  }
}
class ClassMethod {
  constructor(fn) {
    this.fn = fn;
  }
}
class StaticMethod {
  constructor(fn) {
    this.fn = fn;
  }
}
const property = (fn) => new Property(fn, false);
const classmethod = (fn) => new ClassMethod(fn);
const staticmethod = (fn) => new StaticMethod(fn);

function $member(cls, name, value) {
  const put = (on, v) =>
    Object.defineProperty(on, name, {
      value: v,
      writable: true,
      configurable: true,
      enumerable: false,
    });
  if (value instanceof Property) {
    const { fn, cached } = value;
    Object.defineProperty(cls.prototype, name, {
      configurable: true,
      get() {
        const found = fn.call(this);
        if (cached)
          Object.defineProperty(this, name, { value: found, writable: true, configurable: true });
        return found;
      },
      set(v) {
        Object.defineProperty(this, name, {
          value: v,
          writable: true,
          configurable: true,
          enumerable: true,
        });
      },
    });
    delete cls[name];
  } else if (value instanceof ClassMethod) {
    put(cls, function (...args) {
      return value.fn.apply(this, args);
    });
    put(cls.prototype, function (...args) {
      return value.fn.apply(this.constructor, args);
    });
  } else if (value instanceof StaticMethod) {
    put(cls, value.fn);
    put(cls.prototype, value.fn);
  } else if (typeof value === "function" && value.$def) {
    put(cls.prototype, value);
  } else {
    put(cls, value);
    put(cls.prototype, value);
  }
}

function $class(name, bases, body, notes) {
  const parent =
    bases.map((b) => b.origin ?? b).find((b) => typeof b === "function" && b.$isClass) ?? object;
  const cls = function (...args) {
    return cls.$new(cls, args);
  };
  Object.setPrototypeOf(cls, parent);
  Object.defineProperty(cls, "name", { value: name, writable: true, configurable: true });
  cls.prototype = Object.create(parent.prototype, {
    constructor: { value: cls, writable: true, configurable: true },
  });
  cls.$isClass = true;
  cls.$title = name;
  cls.$notes =
    typeof notes === "string"
      ? Object.fromEntries(
          notes
            .split(" ")
            .filter(Boolean)
            .map((n) => [n, null]),
        )
      : (notes ?? {});
  cls.$own = {};
  body(cls.$own);
  for (const [key, value] of Object.entries(cls.$own)) $member(cls, key, value);
  if (parent.$made) parent.$made(cls);
  return cls;
}

function object() {
  return Object.create(object.prototype);
}
object.$isClass = true;
object.$title = "object";
object.$new = (cls, args) => {
  // A callable object is a function here.
  const self = cls.prototype.__call__
    ? Object.setPrototypeOf((...given) => self.__call__(...given), cls.prototype)
    : Object.create(cls.prototype);
  if (self.__init__) self.__init__(...args);
  return self;
};
object.__setattr__ = (self, name, value) => {
  self[name] = value;
};

function $super(cls, self, name) {
  const above = Object.getPrototypeOf(cls.prototype);
  const found = Reflect.get(above, name, self);
  if (found === undefined && name === "__init__") return () => null;
  return typeof found === "function" ? found.bind(self) : found;
}

const type = (x) =>
  x == null
    ? NoneType
    : typeof x === "string"
      ? str
      : typeof x === "boolean"
        ? bool
        : typeof x === "number"
          ? Number.isInteger(x)
            ? int
            : float
          : Array.isArray(x) && x.constructor === Array
            ? x.$t
              ? tuple
              : list
            : x.constructor;
function NoneType() {
  return null;
}
const $name = (x) => (typeof x === "string" ? x : (x.$title ?? x.name ?? "object"));

// ---- types in annotations and isinstance ----------------------------------------------------

class Type {
  constructor(title, args = [], test = null) {
    this.$title = title;
    this.args = args;
    this.test = test;
  }
  of(args) {
    return new Type(this.$title, Array.isArray(args) ? args : [args], this.test);
  }
}
const $isType = (x) =>
  x === null || x instanceof Type || (typeof x === "function" && (x.$isClass || x.$test));

function isinstance(x, kind) {
  if (kind === null) return x == null;
  if (Array.isArray(kind)) return kind.some((one) => isinstance(x, one));
  if (kind instanceof Type) {
    if (kind.$title === "union") return kind.args.some((one) => isinstance(x, one));
    return kind.test ? kind.test(x) : false;
  }
  if (kind.$test) return kind.$test(x);
  return x != null && (typeof x === "object" || typeof x === "function") && x instanceof kind;
}
const issubclass = (a, b) => a === b || a.prototype instanceof b;
const callable = (x) => typeof x === "function";

// ---- exceptions -------------------------------------------------------------------------------

const BaseException = $class(
  "BaseException",
  [],
  ($c) => {
    $c.__str__ = $def(function () {
      return this.args.length ? str(this.args[0]) : "";
    }, "");
  },
  {},
);
Object.setPrototypeOf(BaseException.prototype, Error.prototype);
BaseException.$new = (cls, args) => {
  const self = Object.create(cls.prototype);
  self.args = args;
  if (self.__init__) self.__init__(...args);
  self.message = str(self);
  if (Error.captureStackTrace) Error.captureStackTrace(self, cls);
  return self;
};
const $exception = (name, base) => $class(name, [base], () => {}, {});
const Exception = $exception("Exception", BaseException);
const [
  ArithmeticError,
  IndexError,
  KeyError,
  NotImplementedError,
  OSError,
  StopIteration,
  TypeError,
  ValueError,
] = [
  "ArithmeticError",
  "IndexError",
  "KeyError",
  "NotImplementedError",
  "OSError",
  "StopIteration",
  "TypeError",
  "ValueError",
].map((name) => $exception(name, Exception));
const KeyboardInterrupt = $exception("KeyboardInterrupt", BaseException);
const ZeroDivisionError = $exception("ZeroDivisionError", ArithmeticError);
const OverflowError = $exception("OverflowError", ArithmeticError);
const FileNotFoundError = $exception("FileNotFoundError", OSError);
const UnicodeDecodeError = $exception("UnicodeDecodeError", ValueError);
const $raised = (x) => (typeof x === "function" ? x() : x);
const $caught = (e, kind) => isinstance(e, kind);
function $assert(ok) {
  if (!ok) throw new Error("an assertion failed");
}

function $enter(context) {
  if (context && context.__enter__)
    return { value: context.__enter__(), exit: () => context.__exit__() };
  return {
    value: context,
    exit: () => {
      if (context && context.close) context.close();
    },
  };
}

// ---- truth, equality, order -------------------------------------------------------------------

function $t(x) {
  switch (typeof x) {
    case "boolean":
      return x;
    case "number":
      return x !== 0;
    case "string":
      return x.length > 0;
    case "undefined":
      return false;
    case "function":
      return true;
  }
  if (x === null) return false;
  if (Array.isArray(x) || x instanceof Uint8Array) return x.length > 0;
  if (x.__bool__) return x.__bool__();
  if (x.__len__) return x.__len__() > 0;
  return true;
}
const $and = (a, b) => ($t(a) ? b() : a);
const $or = (a, b) => ($t(a) ? a : b());

const $isArray = (x) => x instanceof NdArray;
const $special = (x) => x !== null && typeof x === "object" && !Array.isArray(x);

function $same(a, b) {
  if (a === b) return true;
  if (a == null || b == null) return a == b;
  if (a.__eq__ && typeof a !== "number") return $t(a.__eq__(b));
  if (b instanceof Complex) return b.__eq__(a);
  if (typeof a !== "object" || typeof b !== "object")
    return typeof a === "boolean" || typeof b === "boolean"
      ? Number(a) === Number(b) && typeof a !== "string" && typeof b !== "string"
      : false;
  if (Array.isArray(a))
    return Array.isArray(b) && a.length === b.length && a.every((x, n) => $same(x, b[n]));
  if (a instanceof Uint8Array)
    return b instanceof Uint8Array && a.length === b.length && a.every((x, n) => x === b[n]);
  return false;
}
function $eq(a, b) {
  if ($isArray(a) || $isArray(b)) return $arrays.compare("eq", a, b);
  return $same(a, b);
}
const $ne = (a, b) => ($isArray(a) || $isArray(b) ? $arrays.compare("ne", a, b) : !$same(a, b));

// Return <0, 0 or >0; NaN if a and b are not ordered
function $order(a, b) {
  if (Array.isArray(a) && Array.isArray(b)) {
    for (let n = 0; n < Math.min(a.length, b.length); n++)
      if (!$same(a[n], b[n])) return $order(a[n], b[n]);
    return a.length - b.length;
  }
  if (typeof a === "string" && typeof b === "string") return a < b ? -1 : a > b ? 1 : 0;
  if (a == null || b == null || typeof a === "string" || typeof b === "string")
    throw TypeError("these cannot be ordered");
  return a < b ? -1 : a > b ? 1 : a == b ? 0 : NaN;
}
const $compared = (word, test) => (a, b) => {
  if (typeof a === "number" && typeof b === "number")
    return test(a < b ? -1 : a > b ? 1 : a === b ? 0 : NaN);
  if ($isArray(a) || $isArray(b)) return $arrays.compare(word, a, b);
  if (a instanceof PySet)
    return word === "le" ? [...a].every((x) => b.has(x)) : [...b].every((x) => a.has(x));
  return test($order(a, b));
};
const $lt = $compared("lt", (o) => o < 0),
  $le = $compared("le", (o) => o <= 0);
const $gt = $compared("gt", (o) => o > 0),
  $ge = $compared("ge", (o) => o >= 0);

function $in_(x, of) {
  if (typeof of === "string") return of.includes(x);
  if (of instanceof Uint8Array)
    return x.length === 2 && of.length > 4096 ? $hasPair(of, x) : $bytesFind(of, x) >= 0;
  if (of instanceof Dict || of instanceof PySet) return of.has(x);
  if (of != null && of.__contains__) return of.__contains__(x);
  for (const one of $iter(of)) if ($same(one, x)) return true;
  return false;
}
const $notin = (x, of) => !$in_(x, of);

// ---- operators ----------------------------------------------------------------------------------

function $operator(word, number, other) {
  return (a, b) => {
    if (typeof a === "number" && typeof b === "number") return number(a, b);
    if ($isArray(a) || $isArray(b)) return $arrays.binary(word, a, b);
    const done = other ? other(a, b) : undefined;
    if (done !== undefined) return done;
    if (a instanceof Complex || b instanceof Complex) return $arrays.complexScalar(word, a, b);
    if ([a, b].every((x) => typeof x === "number" || typeof x === "boolean"))
      return number(Number(a), Number(b));
    throw TypeError(`unsupported operands for ${word}: ${$name(type(a))} and ${$name(type(b))}`);
  };
}
const $add = $operator(
  "add",
  (a, b) => a + b,
  (a, b) => {
    if (typeof a === "string" && typeof b === "string") return a + b;
    if (Array.isArray(a) && Array.isArray(b)) return a.$t ? $tuple([...a, ...b]) : [...a, ...b];
    if (a instanceof Uint8Array && b instanceof Uint8Array) {
      const out = new Uint8Array(a.length + b.length);
      out.set(a);
      out.set(b, a.length);
      return out;
    }
  },
);
const $sub = $operator(
  "sub",
  (a, b) => a - b,
  (a, b) => {
    if (a instanceof PySet) return set([...a].filter((x) => !b.has(x)));
    if (a && a.__sub__) return a.__sub__(b);
  },
);
const $mul = $operator(
  "mul",
  (a, b) => a * b,
  (a, b) => {
    if (typeof a === "string") return a.repeat(Math.max(0, Number(b)));
    if (typeof b === "string") return b.repeat(Math.max(0, Number(a)));
    if (a instanceof Uint8Array) return $joined($bytes([]), new Array(Math.max(0, b)).fill(a));
    if (Array.isArray(b) && !Array.isArray(a)) [a, b] = [b, a];
    if (Array.isArray(a)) {
      const out = [];
      for (let n = 0; n < b; n++) out.push(...a);
      return out;
    }
  },
);
const $div = $operator(
  "div",
  (a, b) => a / b,
  (a, b) => (a && a.__truediv__ ? a.__truediv__(b) : undefined),
);
// Remainder and quotient of a division that is rounded down, as in NumPy.
function $left(a, b) {
  const left = a % b;
  if (left === 0) return b < 0 ? -0 : 0;
  return b < 0 !== left < 0 ? left + b : left;
}
function $down(a, b) {
  if (b === 0) return a / b;
  const left = a % b,
    quotient = (a - left) / b - (left !== 0 && b < 0 !== left < 0 ? 1 : 0),
    down = Math.floor(quotient);
  if (quotient === 0) return Math.sign(a) * Math.sign(b) * 0;
  return quotient - down > 0.5 ? down + 1 : down;
}
const $floordiv = $operator("floordiv", $down);
const $mod = $operator("mod", $left);
// As in C, powers of 1 exist for any exponent, and powers of -1 for infinite exponents.
const $powered = (a, b) => (a === 1 || (a === -1 && Math.abs(b) === Infinity) ? 1 : a ** b);
const $pow = $operator("pow", $powered);
const $matmul = (a, b) => $arrays.matmul(a, b);
const $bits = (word, number) =>
  $operator(word, number, (a, b) => {
    if (typeof a === "boolean" && typeof b === "boolean") return Boolean(number(a, b));
    if (a instanceof PySet || b instanceof PySet) return a[word](b);
    if (word === "or" && a instanceof Dict) return $dict([...$items(a), ...$items(b)]);
    if (word === "or" && $isType(a) && $isType(b)) return new Type("union", [a, b]);
  });
// Bit operators for whole numbers of any size; the engine's operators have 32 bits.
const $wide = (short, long) => (a, b) =>
  (a | 0) === a && (b | 0) === b ? short(a, b) : Number(long(BigInt(a), BigInt(b)));
const $bitwise = {
  and: $wide(
    (a, b) => a & b,
    (a, b) => a & b,
  ),
  or: $wide(
    (a, b) => a | b,
    (a, b) => a | b,
  ),
  xor: $wide(
    (a, b) => a ^ b,
    (a, b) => a ^ b,
  ),
};
const $and_ = $bits("and", $bitwise.and),
  $or_ = $bits("or", $bitwise.or),
  $xor = $bits("xor", $bitwise.xor);
const $lshift = (a, b) => a * 2 ** b,
  $rshift = (a, b) => Math.floor(a / 2 ** b);
const $neg = (x) =>
  typeof x === "number"
    ? -x
    : $isArray(x)
      ? $arrays.unary("neg", x)
      : x instanceof Complex
        ? new Complex(-x.real, -x.imag)
        : -Number(x);
const $pos = (x) => x;
const $invert = (x) =>
  $isArray(x) ? $arrays.unary("invert", x) : typeof x === "boolean" ? !x : -x - 1;

// In-place operators: an object stays the same object.
const $inplace = (operate) => (a, b) => {
  if ($isArray(a)) {
    const out = operate(a, b);
    if ($isArray(out) && $rank[out.kind] > $rank[a.kind])
      throw TypeError(`an array of ${a.kind} cannot become one of ${out.kind} in place`);
    a.assign(out);
    return a;
  }
  return operate(a, b);
};
const $iadd = (a, b) => {
  if (Array.isArray(a) && !a.$t) {
    a.push(...$iter(b));
    return a;
  }
  return $inplace($add)(a, b);
};
const $ior = (a, b) => {
  if (a instanceof Dict) {
    for (const [k, v] of $pairs(b)) a.set(k, v);
    return a;
  }
  if (a instanceof PySet) {
    for (const x of b) a.add(x);
    return a;
  }
  return $inplace($or_)(a, b);
};
const $isub = $inplace($sub),
  $imul = $inplace($mul),
  $idiv = $inplace($div),
  $iand = $inplace($and_);
const $ipow = $inplace($pow),
  $ifloordiv = $inplace($floordiv),
  $imod = $inplace($mod);

// ---- containers -----------------------------------------------------------------------------------

const $tuple = (items) => {
  items.$t = 1;
  return items;
};
const $ellipsis = { toString: () => "..." };

class Slice {
  constructor(start, stop, step) {
    this.start = start;
    this.stop = stop;
    this.step = step;
  }
}
const slice = (a, b, c = null) => (b === undefined ? new Slice(null, a, null) : new Slice(a, b, c));
slice.$test = (x) => x instanceof Slice;

// Return [first, count, step] of a slice of `size` items
function $span(s, size) {
  const step = s.step ?? 1;
  const clip = (x, low, high) => Math.min(Math.max(x < 0 ? x + size : x, low), high);
  const first =
    s.start == null
      ? step > 0
        ? 0
        : size - 1
      : clip(s.start, step > 0 ? 0 : -1, step > 0 ? size : size - 1);
  const last =
    s.stop == null
      ? step > 0
        ? size
        : -1
      : clip(s.stop, step > 0 ? 0 : -1, step > 0 ? size : size - 1);
  return [first, Math.max(0, Math.ceil((last - first) / step)), step];
}

// Keys are equal by content if Python compares them by content: tuples, data classes, numbers.
const $ids = new WeakMap();
let $lastId = 0;
function $keyOf(key) {
  switch (typeof key) {
    case "string":
    case "number":
      return key;
    case "boolean":
      return Number(key);
    case "undefined":
      return null;
  }
  if (key === null) return null;
  if (Array.isArray(key)) return `\u0000(${key.map($inKey).join("\u0001")})`;
  if (key instanceof Complex) return key.imag === 0 ? key.real : `\u0000${key.real}+${key.imag}j`;
  if (key.constructor.$byFields)
    return `\u0000${key.constructor.$title}(${key.constructor.$fields.map((f) => $inKey(key[f.name])).join("\u0001")})`;
  if (key instanceof Path) return `\u0000Path(${key.path})`;
  return key;
}
function $inKey(part) {
  const at = $keyOf(part);
  if (at === null || (typeof at !== "object" && typeof at !== "function"))
    return `${typeof at}:${at}`;
  if (!$ids.has(at)) $ids.set(at, ++$lastId);
  return `object:${$ids.get(at)}`;
}

class Dict {
  constructor(pairs = []) {
    this.of = new Map();
    for (const [k, v] of pairs) this.set(k, v);
  }
  set(key, value) {
    const at = $keyOf(key),
      had = this.of.get(at);
    if (had) had[1] = value;
    else this.of.set(at, [key, value]);
    return this;
  }
  has(key) {
    return this.of.has($keyOf(key));
  }
  get(key, otherwise = null) {
    const had = this.of.get($keyOf(key));
    return had ? had[1] : otherwise;
  }
  delete(key) {
    return this.of.delete($keyOf(key));
  }
  *[Symbol.iterator]() {
    for (const [key] of this.of.values()) yield key;
  }
  __len__() {
    return this.of.size;
  }
  __eq__(other) {
    return (
      other instanceof Dict &&
      other.of.size === this.of.size &&
      [...this.of.values()].every(([k, v]) => other.has(k) && $same(v, other.get(k)))
    );
  }
  keys() {
    return [...this];
  }
  values() {
    return [...this.of.values()].map((one) => one[1]);
  }
  items() {
    return [...this.of.values()].map(([k, v]) => $tuple([k, v]));
  }
  setdefault(key, value = null) {
    if (!this.has(key)) this.set(key, value);
    return this.get(key);
  }
  pop(key, otherwise) {
    if (!this.has(key)) {
      if (otherwise === undefined) throw KeyError(key);
      return otherwise;
    }
    const value = this.get(key);
    this.delete(key);
    return value;
  }
  update(...args) {
    for (const [k, v] of $pairs(dict(...args))) this.set(k, v);
    return null;
  }
  copy() {
    return new Dict(this.of.values());
  }
}
const $dict = (pairs) => new Dict(pairs);
const $items = (d) => (d instanceof Dict ? d.of.values() : $pairs(d));
function $pairs(x) {
  if (x instanceof Dict) return [...x.of.values()];
  if (x && x.items) return x.items();
  return [...x];
}
function dict(...args) {
  const kw = args.length && args[args.length - 1] instanceof Kw ? args.pop().of : {};
  return new Dict([...(args.length ? $pairs(args[0]) : []), ...Object.entries(kw)]);
}
dict.$test = (x) => x instanceof Dict;
dict.fromkeys = (keys, value = null) => new Dict([...$iter(keys)].map((k) => [k, value]));

class PySet {
  constructor(items = []) {
    this.of = new Map();
    for (const x of items) this.add(x);
  }
  add(x) {
    const k = $keyOf(x);
    if (!this.of.has(k)) this.of.set(k, x);
    return null;
  }
  has(x) {
    return this.of.has($keyOf(x));
  }
  discard(x) {
    this.of.delete($keyOf(x));
    return null;
  }
  pop() {
    if (!this.of.size) throw KeyError("pop from an empty set");
    const [k, x] = this.of.entries().next().value;
    this.of.delete(k);
    return x;
  }
  [Symbol.iterator]() {
    return this.of.values();
  }
  __len__() {
    return this.of.size;
  }
  __eq__(other) {
    return (
      other instanceof PySet &&
      other.of.size === this.of.size &&
      [...this].every((x) => other.has(x))
    );
  }
  and(other) {
    return new PySet([...this].filter((x) => other.has(x)));
  }
  or(other) {
    return new PySet([...this, ...other]);
  }
  update(items) {
    for (const x of items) this.add(x);
    return null;
  }
  issubset(other) {
    return [...this].every((x) => $in_(x, other));
  }
}
const set = (items = []) => new PySet($iter(items));
set.$test = (x) => x instanceof PySet;
const frozenset = set;

function $iter(x) {
  if (x == null || typeof x[Symbol.iterator] !== "function") {
    if (x && x.__iter__) return x.__iter__();
    throw TypeError(`${$name(type(x))} is not iterable`);
  }
  return x;
}

function $unpack(x, most) {
  const out = Array.isArray(x) ? x : [...$iter(x)];
  if (most !== Infinity && out.length !== most)
    throw ValueError(`expected ${most} values, got ${out.length}`);
  return out;
}

function $get(x, at) {
  if (x instanceof NdArray) return x.at(at);
  if (x instanceof Dict) {
    if (!x.has(at)) throw KeyError(at);
    return x.get(at);
  }
  if (typeof x === "string" || Array.isArray(x) || x instanceof Uint8Array) {
    if (at instanceof Slice) {
      const [first, count, step] = $span(at, x.length);
      if (step === 1) {
        const out = x.slice(first, first + count);
        if (x.$t) out.$t = 1;
        return Array.isArray(x) && x.constructor !== Array ? $tuple(Array.from(out)) : out;
      }
      const out = Array.from({ length: count }, (_, n) => x[first + n * step]);
      if (typeof x === "string") return out.join("");
      return x instanceof Uint8Array ? $bytes(out) : x.$t ? $tuple(out) : out;
    }
    const n = at < 0 ? at + x.length : Number(at);
    if (!(n >= 0 && n < x.length)) throw IndexError("index out of range");
    return x[n];
  }
  if (x instanceof Type) return x.of(at);
  if (typeof x === "number" || typeof x === "boolean" || x instanceof Complex) return $as(x).at(at); // an array without axes
  if (x && x.__getitem__) return x.__getitem__(at);
  if (typeof x === "function" && $isType(x))
    return Object.assign(new Type($name(x), Array.isArray(at) ? at : [at], x.$test), { origin: x });
  throw TypeError(`${$name(type(x))} cannot be indexed`);
}

function $set(x, at, value) {
  if (x instanceof NdArray) x.put(at, value);
  else if (x instanceof Dict) x.set(at, value);
  else if (Array.isArray(x)) {
    if (at instanceof Slice) {
      const [first, count] = $span(at, x.length);
      x.splice(first, count, ...$iter(value));
      return;
    }
    const n = at < 0 ? at + x.length : at;
    if (!(n >= 0 && n < x.length)) throw IndexError("index out of range");
    x[n] = value;
  } else if (x && x.__setitem__) x.__setitem__(at, value);
  else throw TypeError(`${$name(type(x))} cannot be assigned to`);
}
function $del(x, at) {
  if (x instanceof Dict) {
    if (!x.delete(at)) throw KeyError(at);
  } else if (at instanceof Slice) {
    const [first, count] = $span(at, x.length);
    x.splice(first, count);
  } else x.splice(at < 0 ? at + x.length : at, 1);
}

// ---- builtin functions --------------------------------------------------------------------------

function len(x) {
  if (typeof x === "string" || Array.isArray(x) || x instanceof Uint8Array) return x.length;
  if (x instanceof NdArray) {
    if (!x.shape.length) throw TypeError("an array without axes has no length");
    return x.shape[0];
  }
  if (x && x.__len__) return x.__len__();
  throw TypeError(`${$name(type(x))} has no length`);
}
function range(a, b, step = 1) {
  const [first, last] = b === undefined ? [0, a] : [a, b],
    out = [];
  for (let n = first; step > 0 ? n < last : n > last; n += step) out.push(n);
  return out;
}
function* enumerate(x, from = 0) {
  if (from instanceof Kw) from = from.of.start;
  let n = from;
  for (const one of $iter(x)) yield $tuple([n++, one]);
}
function* zip(...args) {
  const strict = args.length && args[args.length - 1] instanceof Kw ? args.pop().of.strict : false;
  const its = args.map((x) => $iter(x)[Symbol.iterator]());
  if (!its.length) return;
  for (;;) {
    const got = its.map((it) => it.next());
    if (strict && got.some((g) => g.done) && !got.every((g) => g.done))
      throw ValueError("zip() arguments differ in length");
    if (got.some((g) => g.done)) return;
    yield $tuple(got.map((g) => g.value));
  }
}
function* map(fn, ...lists) {
  for (const args of zip(...lists)) yield fn(...args);
}
function* filter(fn, x) {
  for (const one of $iter(x)) if (fn === null ? $t(one) : $t(fn(one))) yield one;
}
function any(x) {
  if ($isArray(x)) return x.any();
  for (const one of $iter(x)) if ($t(one)) return true;
  return false;
}
function all(x) {
  if ($isArray(x)) return x.all();
  for (const one of $iter(x)) if (!$t(one)) return false;
  return true;
}
const iter = (x) => $iter(x)[Symbol.iterator]();
function next(x, otherwise) {
  const { done, value } = x.next();
  if (!done) return value;
  if (otherwise === undefined) throw StopIteration();
  return otherwise;
}
const sum = $fn("of start", (of, start = 0) => {
  let out = start;
  for (const x of $iter(of)) out = $add(out, x);
  return out;
});
const sorted = $fn("of key reverse", (of, key = null, reverse = false) => {
  const out = [...$iter(of)].map((x) => [key ? key(x) : x, x]);
  out.sort((a, b) => (reverse ? $order(b[0], a[0]) : $order(a[0], b[0])));
  return out.map((one) => one[1]);
});
const $best =
  (sign) =>
  (...args) => {
    const kw = args.length && args[args.length - 1] instanceof Kw ? args.pop().of : {};
    let best,
      chosen,
      none = true;
    for (const x of args.length === 1 ? $iter(args[0]) : args) {
      const value = kw.key ? kw.key(x) : x;
      if (none || sign * $order(value, best) > 0) {
        best = value;
        chosen = x;
      }
      none = false;
    }
    if (none) {
      if ("default" in kw) return kw.default;
      throw ValueError("min() or max() of nothing");
    }
    return chosen;
  };
const min = $best(-1),
  max = $best(1);
const abs = (x) =>
  typeof x === "number"
    ? Math.abs(x)
    : $isArray(x)
      ? $arrays.unary("abs", x)
      : x instanceof Complex
        ? Math.hypot(x.real, x.imag)
        : Math.abs(Number(x));
// Round to the nearest whole number, ties to even.
function $rint(x) {
  const down = Math.floor(x),
    left = x - down;
  if (!(left > 0)) return x; // x is whole or not finite
  return left > 0.5 || (left === 0.5 && down % 2 !== 0) ? (down === -1 ? -0 : down + 1) : down;
}
function round(x, digits = null) {
  x = Number(x);
  if (digits !== null) return Number.isFinite(x) ? Number(format(x, `.${digits}f`)) : x;
  return int($rint(x));
}
const list = (x = []) => [...$iter(x)];
list.$test = (x) => Array.isArray(x) && !x.$t;
const tuple = (x = []) => $tuple([...$iter(x)]);
tuple.$test = (x) => Array.isArray(x) && Boolean(x.$t);
tuple.$made = undefined;
const bool = (x = false) => $t(x);
bool.$test = (x) => typeof x === "boolean";
// Strip the text of a number; in ASCII, Python accepts fewer white-space characters around numbers.
const $bare = (text) =>
  /[^\0-\x7f]/.test(text) ? $strings.strip(text) : text.replace(/^[\t-\r ]+|[\t-\r ]+$/g, "");
const $number = (given) => {
  const text = $bare(given);
  return /^[-+]?(\d(_?\d)*\.?(\d(_?\d)*)?|\.\d(_?\d)*)([eE][-+]?\d(_?\d)*)?$/.test(text)
    ? Number(text.replaceAll("_", ""))
    : /^[-+]?inf(inity)?$/i.test(text)
      ? text[0] === "-"
        ? -Infinity
        : Infinity
      : /^[-+]?nan$/i.test(text)
        ? NaN
        : null;
};
function float(x = 0) {
  if (typeof x === "number") return x;
  if (typeof x === "boolean") return Number(x);
  if (typeof x === "string") {
    const found = $number(x);
    if (found === null) throw ValueError(`could not convert string to float: ${repr(x)}`);
    return found;
  }
  if ($isArray(x) && x.size === 1) return x.item();
  throw TypeError(`${$name(type(x))} is no number`);
}
float.$test = (x) => typeof x === "number";
function int(x = 0, base = 10) {
  if (typeof x === "string") {
    const head = { 2: "(?:0b_?)?", 8: "(?:0o_?)?", 16: "(?:0x_?)?" }[base] ?? "",
      match = new RegExp(`^([-+]?)${head}([0-9a-z]+(?:_[0-9a-z]+)*)$`, "i").exec($bare(x)),
      digits = match?.[2].replaceAll("_", "");
    if (!match || [...digits].some((c) => !(parseInt(c, 36) < base)))
      throw ValueError(`invalid literal for int(): ${repr(x)}`);
    return $exact(match[1] === "-" ? -parseInt(digits, base) : parseInt(digits, base), "int()") + 0;
  }
  const value = float(x);
  if (Number.isNaN(value)) throw ValueError("cannot convert NaN to an integer");
  if (!Number.isFinite(value)) throw OverflowError("cannot convert infinity to an integer");
  return Math.trunc(value) + 0;
}
// Integers are doubles: an integer of 2**53 or more may represent its neighbour.
function $exact(x, name) {
  if (x >= 2 ** 53 || x <= -(2 ** 53))
    throw OverflowError(`${name}: integers of 2**53 and more are not exact here`);
  return x;
}
int.$test = (x) => (typeof x === "number" && Number.isInteger(x)) || typeof x === "boolean";
class Complex {
  constructor(real, imag) {
    this.real = real;
    this.imag = imag;
  }
  conjugate() {
    return new Complex(this.real, -this.imag);
  }
  conj() {
    return this.conjugate();
  }
  __eq__(other) {
    return other instanceof Complex
      ? this.real === other.real && this.imag === other.imag
      : this.imag === 0 && this.real === other;
  }
  __bool__() {
    return this.real !== 0 || this.imag !== 0;
  }
}
const $complex = (real, imag) => new Complex(real, imag);
const complex = (real = 0, imag = 0) =>
  real instanceof Complex ? real : new Complex(Number(real), Number(imag));
complex.$test = (x) => x instanceof Complex;
const getattr = (x, name, otherwise) => {
  const found = x == null ? undefined : x[name];
  if (found !== undefined)
    return typeof found === "function" && !found.$isClass && found.$def ? found.bind(x) : found;
  if (otherwise === undefined) throw TypeError(`no attribute ${name}`);
  return otherwise;
};
const $bound = (x, name) => {
  const found = x[name];
  return typeof found === "function" && found.$def ? found.bind(x) : found;
};
const setattr = (x, name, value) => {
  x[name] = value;
};
const hasattr = (x, name) => x != null && x[name] !== undefined;
const pow = (a, b) => $pow(a, b);
const ord = (c) => c.codePointAt(0),
  chr = (n) => String.fromCodePoint(n);
const reversed = (x) => [...$iter(x)].reverse();
const print = () => null;
let open; // library.js defines the files

// Attributes of numbers, as of NumPy's scalars.
for (const kind of [Number, Boolean])
  for (const [name, get] of Object.entries({
    real() {
      return Number(this);
    },
    imag() {
      return 0;
    },
    shape() {
      return $tuple([]);
    },
    ndim() {
      return 0;
    },
    size() {
      return 1;
    },
  }))
    Object.defineProperty(kind.prototype, name, { get, configurable: true });
for (const kind of [Number, Boolean])
  for (const [name, value] of Object.entries({
    any() {
      return $t(this.valueOf());
    },
    all() {
      return $t(this.valueOf());
    },
    item() {
      return this.valueOf();
    },
    sum() {
      return Number(this);
    },
    astype(to) {
      return $kind(to) === "i"
        ? Math.trunc(Number(this))
        : $kind(to) === "b"
          ? $t(this.valueOf())
          : Number(this);
    },
    conj() {
      return Number(this);
    },
    conjugate() {
      return Number(this);
    },
    tolist() {
      return this.valueOf();
    },
    max() {
      return Number(this);
    },
    min() {
      return Number(this);
    },
    mean() {
      return Number(this);
    },
    is_integer() {
      return Number.isInteger(Number(this));
    },
  }))
    Object.defineProperty(kind.prototype, name, { value, configurable: true, writable: true });

// ---- text -----------------------------------------------------------------------------------------

function $float(x) {
  if (Number.isNaN(x)) return "nan";
  if (!Number.isFinite(x)) return x < 0 ? "-inf" : "inf";
  const [digits, power] = x.toExponential().split("e"),
    at = Number(power);
  if (at >= -4 && at < 16) {
    const plain = String(x);
    return plain.includes("e")
      ? x.toFixed(Math.max(0, digits.replace(/[-.]/g, "").length - 1 - at))
      : plain;
  }
  return `${digits}e${at < 0 ? "-" : "+"}${String(Math.abs(at)).padStart(2, "0")}`;
}
function str(x = "") {
  if (typeof x === "string") return x;
  if (x != null && typeof x === "object" && x.__str__) return x.__str__();
  return repr(x);
}
str.$test = (x) => typeof x === "string";
str.maketrans = (d) => d;
function repr(x) {
  switch (typeof x) {
    case "string": {
      const mark = x.includes("'") && !x.includes('"') ? '"' : "'";
      const body = x
        .replaceAll("\\", "\\\\")
        .replaceAll("\n", "\\n")
        .replaceAll("\r", "\\r")
        .replaceAll("\t", "\\t")
        .replace($hidden, (c) => {
          const code = c.codePointAt(0).toString(16);
          return code.length < 3
            ? `\\x${code.padStart(2, "0")}`
            : code.length < 5
              ? `\\u${code.padStart(4, "0")}`
              : `\\U${code.padStart(8, "0")}`;
        });
      return mark + (mark === "'" ? body.replaceAll("'", "\\'") : body) + mark;
    }
    case "number":
      return $float(x);
    case "boolean":
      return x ? "True" : "False";
    case "undefined":
      return "None";
    case "function":
      return `<class '${$name(x)}'>`;
  }
  if (x === null) return "None";
  if (Array.isArray(x))
    return x.$t
      ? `(${x.map(repr).join(", ")}${x.length === 1 ? "," : ""})`
      : `[${x.map(repr).join(", ")}]`;
  if (x instanceof Dict)
    return `{${x
      .items()
      .map(([k, v]) => `${repr(k)}: ${repr(v)}`)
      .join(", ")}}`;
  if (x instanceof PySet) return `{${[...x].map(repr).join(", ")}}`;
  if (x instanceof Uint8Array) return `b'${$decoded(x, "latin-1")}'`;
  if (x.__repr__) return x.__repr__();
  if (x.__str__) return x.__str__();
  return `<${$name(type(x))}>`;
}

// Format x ≥ 0 like Python, ties to even. A hundred digits are enough to detect a tie.
const $halved = (long, keep) =>
  /^50*$/.test(long.slice(keep)) && /[02468]\.?$/.test(long.slice(0, keep));
function $fixed(x, digits) {
  if (x >= 1e21) return BigInt(x) + (digits ? `.${"0".repeat(digits)}` : "");
  const long = x.toFixed(100),
    keep = long.length - 100 + digits;
  return $halved(long, keep) ? long.slice(0, digits ? keep : keep - 1) : x.toFixed(digits);
}
// Return [digits, power of ten]
function $scientific(x, digits) {
  const [long, power] = x.toExponential(100).split("e");
  if ($halved(long, 2 + digits)) return [long.slice(0, digits ? 2 + digits : 1), Number(power)];
  const [short, at] = x.toExponential(digits).split("e");
  return [short, Number(at)];
}
const $power = ([digits, at]) =>
  `${digits}e${at < 0 ? "-" : "+"}${String(Math.abs(at)).padStart(2, "0")}`;
// `plain`: without a letter; a float then shows that it is a float.
function $general(x, digits, plain) {
  const p = digits || 1,
    [long, at] = $scientific(x, p - 1),
    trimmed = (t) => (t.includes(".") ? t.replace(/\.?0+$/, "") : t);
  if (at < -4 || at >= p - (plain ? 1 : 0)) return $power([trimmed(long), at]);
  const text = trimmed($fixed(x, p - 1 - at));
  return plain && !text.includes(".") ? `${text}.0` : text;
}
function $unsigned(x, kind, digits) {
  if (kind === "%") return `${$unsigned(x * 100, "f", digits)}%`;
  if (!Number.isFinite(x)) return Number.isNaN(x) ? "nan" : "inf";
  switch (kind?.toLowerCase()) {
    case "f":
      return $fixed(x, digits ?? 6);
    case "e":
      return $power($scientific(x, digits ?? 6));
    case "g":
      return $general(x, digits ?? 6, false);
    case undefined:
      return digits === null ? $float(x) : $general(x, digits, true);
  }
  if (!Number.isInteger(x)) throw ValueError(`the format ${kind} is for integers`);
  return BigInt(x).toString({ d: 10, b: 2, x: 16 }[kind.toLowerCase()]);
}
function format(x, spec = "") {
  const [all_, given, align, sign, zero, width, comma, precision, kind] =
    /^(?:(.)?([<>=^]))?([-+ ])?(0)?(\d+)?([,_])?(?:\.(\d+))?([bdeEfFgGsxX%])?$/su.exec(spec) ?? [];
  if (all_ === undefined) throw ValueError(`no format ${repr(spec)} here`);
  if ($isArray(x) && x.size === 1) x = x.item();
  const number = typeof x === "number" || (typeof x === "boolean" && spec !== ""),
    digits = precision === undefined ? null : Number(precision),
    fill = given ?? (zero ? "0" : " "),
    to = align ?? (number ? (zero && given === undefined ? "=" : ">") : "<"),
    room = Number(width ?? 0);
  let head = "",
    text;
  if (number) {
    x = Number(x);
    text = $unsigned(Math.abs(x), kind, digits);
    if (/[A-Z]/.test(kind ?? "")) text = text.toUpperCase();
    if (x < 0 || (Object.is(x, -0) && (kind ? !/[bdx]/i.test(kind) : digits !== null))) head = "-";
    else if (sign === "+" || sign === " ") head = sign;
    if (comma) {
      let [, whole, rest] = /^(\d*)(.*)$/.exec(text);
      const grouped = () => whole.replace(/\B(?=(\d{3})+$)/g, comma);
      if (whole && to === "=" && fill === "0")
        while ((head + grouped() + rest).length < room) whole = `0${whole}`;
      text = grouped() + rest;
    }
  } else {
    if (to === "=" || sign || comma || (kind && kind !== "s"))
      throw ValueError(`the format ${repr(spec)} is for numbers`);
    text = str(x);
    if (digits !== null) text = text.slice(0, digits);
  }
  if (to === "=") return head + text.padStart(room - head.length, fill);
  text = head + text;
  if (to === "<") return text.padEnd(room, fill);
  if (to === ">") return text.padStart(room, fill);
  return text
    .padStart(text.length + Math.floor(Math.max(0, room - text.length) / 2), fill)
    .padEnd(room, fill);
}
const $format = format;

// White space in Python, and characters that Python does not print.
const $space =
    "[\\t-\\r\\x1c-\\x20\\x85\\xa0\\u1680\\u2000-\\u200a\\u2028\\u2029\\u202f\\u205f\\u3000]",
  $hidden = /(?! )[\p{C}\p{Z}]/gu,
  $spaces = new RegExp(`${$space}+`),
  $before = new RegExp(`^${$space}+`),
  $behind = new RegExp(`${$space}+$`);
const $escaped = (chars) => chars.replace(/[\\\]^-]/g, "\\$&");
const $strings = {
  strip: (s, of) => $strings.lstrip($strings.rstrip(s, of), of),
  lstrip: (s, of) =>
    of == null ? s.replace($before, "") : s.replace(new RegExp(`^[${$escaped(of)}]+`, "u"), ""),
  rstrip: (s, of) =>
    of == null ? s.replace($behind, "") : s.replace(new RegExp(`[${$escaped(of)}]+$`, "u"), ""),
  split(s, mark = null, most = -1) {
    if (mark === null) {
      let rest = $strings.lstrip(s);
      if (!rest) return [];
      if (most < 0) return $strings.rstrip(rest).split($spaces);
      const out = [];
      while (rest && out.length < most) {
        const found = $spaces.exec(rest);
        if (!found) break;
        out.push(rest.slice(0, found.index));
        rest = rest.slice(found.index + found[0].length);
      }
      return rest ? [...out, rest] : out;
    }
    const parts = s.split(mark);
    return most < 0 || parts.length <= most + 1
      ? parts
      : [...parts.slice(0, most), parts.slice(most).join(mark)];
  },
  rsplit(s, mark, most = -1) {
    const parts = s.split(mark);
    return most < 0 || parts.length <= most + 1
      ? parts
      : [parts.slice(0, parts.length - most).join(mark), ...parts.slice(parts.length - most)];
  },
  splitlines: (s) => {
    const out = s.split(/\r\n|[\n\r\x0b\x0c\x1c-\x1e\x85\u2028\u2029]/);
    if (out[out.length - 1] === "") out.pop();
    return out;
  },
  partition: (s, mark) => {
    const n = s.indexOf(mark);
    return $tuple(n < 0 ? [s, "", ""] : [s.slice(0, n), mark, s.slice(n + mark.length)]);
  },
  rpartition: (s, mark) => {
    const n = s.lastIndexOf(mark);
    return $tuple(n < 0 ? ["", "", s] : [s.slice(0, n), mark, s.slice(n + mark.length)]);
  },
  startswith: (s, of) =>
    Array.isArray(of) ? of.some((one) => s.startsWith(one)) : s.startsWith(of),
  endswith: (s, of) => (Array.isArray(of) ? of.some((one) => s.endsWith(one)) : s.endsWith(of)),
  join: (s, parts) => [...$iter(parts)].join(s),
  lower: (s) => s.toLowerCase(),
  upper: (s) => s.toUpperCase(),
  title: (s) => s.replace(/\p{L}+/gu, (w) => w[0].toUpperCase() + w.slice(1).toLowerCase()),
  replace: (s, a, b, most = -1) => {
    if (most < 0) return s.replaceAll(a, () => b);
    const parts = $strings.split(s, a, most);
    return parts.join(b);
  },
  removeprefix: (s, of) => (s.startsWith(of) ? s.slice(of.length) : s),
  removesuffix: (s, of) => (of && s.endsWith(of) ? s.slice(0, -of.length) : s),
  count: (s, of) => s.split(of).length - 1,
  find: (s, of, from = 0) => s.indexOf(of, from),
  rfind: (s, of) => s.lastIndexOf(of),
  index: (s, of) => {
    const n = s.indexOf(of);
    if (n < 0) throw ValueError("substring not found");
    return n;
  },
  isdigit: (s) => /^\p{Nd}+$/u.test(s),
  isalpha: (s) => /^\p{L}+$/u.test(s),
  isprintable: (s) => s.search($hidden) < 0,
  isspace: (s) => s !== "" && !$strings.strip(s),
  encode: (s, encoding = "utf-8", errors) => $encoded(s, encoding, errors),
  translate: (s, d) => [...s].map((c) => (d.has(c) ? d.get(c) : c)).join(""),
  zfill: (s, n) => s.padStart(n, "0"),
  format(s, ...args) {
    const kw = args.length && args[args.length - 1] instanceof Kw ? args.pop().of : {};
    let at = 0;
    return s.replace(/\{\{|\}\}|\{([^{}:!]*)(!r)?(?::([^{}]*))?\}/g, (all_, name, quoted, spec) => {
      if (all_ === "{{" || all_ === "}}") return all_[0];
      const x = name === "" ? args[at++] : /^\d+$/.test(name) ? args[Number(name)] : kw[name];
      return format(quoted ? repr(x) : x, spec ?? "");
    });
  },
};
const $lists = {
  append: (l, x) => {
    l.push(x);
    return null;
  },
  extend: (l, x) => {
    l.push(...$iter(x));
    return null;
  },
  insert: (l, n, x) => {
    l.splice(n < 0 ? Math.max(0, n + l.length) : n, 0, x);
    return null;
  },
  pop: (l, n = -1) => {
    if (!(n >= -l.length && n < l.length)) throw IndexError("pop index out of range");
    return l.splice(n < 0 ? n + l.length : n, 1)[0];
  },
  remove: (l, x) => {
    const n = l.findIndex((one) => $same(one, x));
    if (n < 0) throw ValueError("not in the list");
    l.splice(n, 1);
    return null;
  },
  index: (l, x) => {
    const n = l.findIndex((one) => $same(one, x));
    if (n < 0) throw ValueError("not in the list");
    return n;
  },
  count: (l, x) => l.filter((one) => $same(one, x)).length,
  reverse: (l) => {
    l.reverse();
    return null;
  },
  sort: $fn("l key reverse", (l, key = null, reverse = false) => {
    const out = sorted(l, $kw({ key, reverse }));
    l.splice(0, l.length, ...out);
    return null;
  }),
  copy: (l) => [...l],
};

// ---- bytes ----------------------------------------------------------------------------------------

const $bytes = (values) => Uint8Array.from(values);
const bytes = (x = []) => Uint8Array.from($iter(x));
bytes.$test = (x) => x instanceof Uint8Array;
// The characters of cp1252 for the bytes 0x80 to 0x9f; if there is none, the engine keeps the byte.
const $euro = new TextDecoder("windows-1252").decode(
  Uint8Array.from({ length: 32 }, (_, n) => 128 + n),
);
function $encoded(s, encoding, errors = "strict") {
  const name = encoding.toLowerCase();
  if (name === "utf-16-le" || name === "utf-16-be") {
    const out = new Uint8Array(2 * s.length),
      view = new DataView(out.buffer);
    for (let n = 0; n < s.length; n++) view.setUint16(2 * n, s.charCodeAt(n), name === "utf-16-le");
    return out;
  }
  if (name === "utf-16") return $encoded(`\ufeff${s}`, "utf-16-le");
  if (name === "utf-8") return new TextEncoder().encode(s);
  if (!["ascii", "latin-1", "cp1252"].includes(name))
    throw NotImplementedError(`encode: no ${encoding} here`);
  return Uint8Array.from([...s], (c) => {
    const code = c.codePointAt(0),
      at = name === "cp1252" && !/[\x80-\x9f]/.test(c) ? $euro.indexOf(c) : -1;
    if (at >= 0) return 128 + at;
    if (code < 128 || (code < 256 && (name === "latin-1" || (name === "cp1252" && code > 159))))
      return code;
    if (errors === "strict") throw ValueError(`'${encoding}' has no ${repr(c)}`);
    return 63;
  });
}
const $bytewise = {
  ascii: (wide) => wide.replace(/[^\0-\x7f]/g, "\ufffd"),
  cp1252: (wide) => wide.replace(/[\x80-\x9f]/g, "\ufffd"),
  "latin-1": (wide) =>
    wide.replace(/[^\0-\xff]/g, (c) => String.fromCharCode(128 + $euro.indexOf(c))),
};
function $decoded(b, encoding = "utf-8", errors = "strict") {
  const name = encoding.toLowerCase().replace(/-sig$/, "");
  if ($bytewise[name]) {
    const out = $bytewise[name](new TextDecoder("windows-1252").decode(b));
    if (errors === "strict" && out.includes("\ufffd"))
      throw UnicodeDecodeError(`'${encoding}' cannot decode these bytes`);
    return out;
  }
  const label =
    {
      "utf-16": b[0] === 0xfe ? "utf-16be" : "utf-16le",
      "utf-16-le": "utf-16le",
      "utf-16-be": "utf-16be",
    }[name] ?? name;
  try {
    return new TextDecoder(label, {
      fatal: errors === "strict",
      ignoreBOM: !encoding.endsWith("-sig") && name !== "utf-16",
    }).decode(b);
  } catch {
    throw UnicodeDecodeError(`'${encoding}' cannot decode these bytes`);
  }
}
function $bytesFind(b, what, from = 0) {
  if (what.length === 1) return b.indexOf(what[0], from);
  // the engine searches for one byte; a byte that is rarer than the end of a line is faster
  const at = Math.max(
      0,
      what.findIndex((c) => c !== 10),
    ),
    fits = (n) => {
      for (let k = 0; k < what.length; k++) if (b[n + k] !== what[k]) return false;
      return true;
    };
  if (what[at] === 10) {
    for (let n = from, last = b.length - what.length; n <= last; n++)
      if (b[n] === 10 && b[n + 1] === what[1] && fits(n)) return n;
    return -1;
  }
  for (let n = b.indexOf(what[at], from + at); n >= 0; n = b.indexOf(what[at], n + 1))
    if (n - at + what.length <= b.length && fits(n - at)) return n - at;
  return -1;
}
const $blank = [9, 10, 11, 12, 13, 32];
function $joined(mark, parts) {
  const out = new Uint8Array(
    parts.reduce((sum, one) => sum + one.length, Math.max(0, parts.length - 1) * mark.length),
  );
  let at = 0;
  parts.forEach((one, n) => {
    if (n) out.set(mark, at);
    at += n ? mark.length : 0;
    out.set(one, at);
    at += one.length;
  });
  return out;
}
const $byteMethods = {
  decode: $fn("b encoding errors", $decoded),
  startswith: (b, of) =>
    (Array.isArray(of) ? of : [of]).some((one) => one.every((x, n) => b[n] === x)),
  endswith: (b, of) => of.every((x, n) => b[b.length - of.length + n] === x),
  count: (b, of) => {
    let out = 0;
    if (of.length === 1) return $countOf(b, of[0]);
    for (let n = $bytesFind(b, of); n >= 0; n = $bytesFind(b, of, n + of.length)) out++;
    return out;
  },
  find: (b, of, from = 0) => $bytesFind(b, of, from),
  rfind(b, of) {
    for (let n = b.length - of.length; n >= 0; n--)
      if (of.every((x, k) => b[n + k] === x)) return n;
    return -1;
  },
  join: (b, parts) => $joined(b, [...$iter(parts)]),
  isalpha: (b) => b.length > 0 && b.every((x) => (x | 32) >= 97 && (x | 32) <= 122),
  removeprefix: (b, of) => ($byteMethods.startswith(b, of) ? b.subarray(of.length) : b),
  rstrip: (b) => {
    let n = b.length;
    while (n && $blank.includes(b[n - 1])) n--;
    return b.subarray(0, n);
  },
  strip: (b) => {
    const out = $byteMethods.rstrip(b),
      first = out.findIndex((x) => !$blank.includes(x));
    return out.subarray(Math.max(0, first));
  },
  split(b, mark) {
    const out = [];
    let at = 0;
    for (let n = $bytesFind(b, mark); n >= 0; n = $bytesFind(b, mark, at)) {
      out.push(b.subarray(at, n));
      at = n + mark.length;
    }
    return [...out, b.subarray(at)];
  },
};

function $call(x, name, ...args) {
  const methods =
    typeof x === "string"
      ? $strings
      : Array.isArray(x)
        ? $lists
        : x instanceof Uint8Array
          ? $byteMethods
          : null;
  if (methods && methods[name]) {
    // Keyword arguments are last, as everywhere.
    if (
      args.length &&
      args[args.length - 1] instanceof Kw &&
      !methods[name].$def &&
      name !== "format"
    )
      throw TypeError(`${name}() takes no keywords here`);
    return methods[name](x, ...args);
  }
  if (x == null || x[name] === undefined)
    throw TypeError(`${$name(type(x))} has no method ${name}`);
  return x[name](...args);
}
$strings.split = $fn("s sep maxsplit", $strings.split);
$strings.encode = $fn("s encoding errors", $strings.encode);
