// The parts of Python's library and of pydantic that the package uses.

const $types = (...names) => Object.fromEntries(names.map((name) => [name, new Type(name)]));

// ---- typing, abc, numbers -----------------------------------------------------------------------

const $sequence = new Type("Sequence", [], (x) => Array.isArray(x) || typeof x === "string");
const $mapping = new Type("Mapping", [], (x) => x instanceof Dict);
const Literal = new Type("Literal");
const Annotated = new Type("Annotated");
const NamedTuple = $class("NamedTuple", [], () => {}, {});
Object.setPrototypeOf(NamedTuple.prototype, Array.prototype);
NamedTuple.$made = (cls) => {
  const names = Object.keys(cls.$notes);
  const make = $def(function (...values) {
    const out = $tuple(
      names.map((name, n) => (values[n] === undefined ? cls.$own[name] : values[n])),
    );
    Object.setPrototypeOf(out, cls.prototype);
    return out;
  }, names.join(" "));
  cls.$new = (_, args) => make(...args);
  names.forEach((name, n) =>
    Object.defineProperty(cls.prototype, name, {
      get() {
        return this[n];
      },
      configurable: true,
    }),
  );
  cls.prototype._replace = $def(function (changes) {
    return make(...names.map((name, n) => (changes.has(name) ? changes.get(name) : this[n])));
  }, "**changes");
  cls.prototype._asdict = function () {
    return $dict(names.map((name, n) => [name, this[n]]));
  };
};
$module("typing", ($m) =>
  Object.assign(
    $m,
    $types(
      "Any",
      "ClassVar",
      "Generic",
      "Protocol",
      "Self",
      "IO",
      "Callable",
      "Iterator",
      "TypeAlias",
    ),
    {
      Literal,
      Annotated,
      NamedTuple,
      TYPE_CHECKING: false,
      Generic: new Type("Generic"),
      Protocol: new Type("Protocol"),
      get_args: (t) => $tuple([...t.args]),
      cast: (_, x) => x,
      TypeVar: (name) => new Type(name),
      overload: (f) => f,
      runtime_checkable: (c) => c,
    },
  ),
);
const $abstract = $types("Callable", "Iterable", "Iterator", "Generator", "Hashable");
$module("collections.abc", ($m) =>
  Object.assign($m, $abstract, {
    Sequence: $sequence,
    Mapping: $mapping,
    Collection: $sequence,
    Callable: new Type("Callable", [], (x) => typeof x === "function"),
  }),
);
$module("abc", ($m) => Object.assign($m, { ABC: new Type("ABC"), abstractmethod: (f) => f }));
$module("numbers", ($m) =>
  Object.assign($m, { Real: new Type("Real", [], (x) => typeof x === "number") }),
);

// ---- mathematics, tools ---------------------------------------------------------------------------

$module("math", ($m) =>
  Object.assign($m, {
    pi: Math.PI,
    tau: 2 * Math.PI,
    inf: Infinity,
    nan: NaN,
    e: Math.E,
    isfinite: (x) => Number.isFinite(Number(x)),
    isnan: (x) => x !== x,
    sqrt: (x) => {
      if (x < 0) throw ValueError("math domain error");
      return Math.sqrt(x);
    },
    exp: Math.exp,
    expm1: Math.expm1,
    log: Math.log,
    log10: Math.log10,
    floor: Math.floor,
    ceil: Math.ceil,
    hypot: Math.hypot,
    sin: Math.sin,
    cos: Math.cos,
    atan2: Math.atan2,
    degrees: (x) => x * (180 / Math.PI),
    radians: (x) => x * (Math.PI / 180),
  }),
);
$module("itertools", ($m) =>
  Object.assign($m, {
    *pairwise(x) {
      let before,
        first = true;
      for (const one of $iter(x)) {
        if (!first) yield $tuple([before, one]);
        before = one;
        first = false;
      }
    },
    *combinations(x, n) {
      const l = [...$iter(x)];
      if (n !== 2) throw NotImplementedError("combinations: pairs alone here");
      for (let a = 0; a < l.length; a++)
        for (let b = a + 1; b < l.length; b++) yield $tuple([l[a], l[b]]);
    },
    chain: Object.assign(
      function* (...lists) {
        for (const l of lists) yield* $iter(l);
      },
      {
        *from_iterable(lists) {
          for (const l of $iter(lists)) yield* $iter(l);
        },
      },
    ),
    *islice(x, n) {
      if (n <= 0) return;
      let k = 0;
      const it = $iter(x)[Symbol.iterator]();
      for (;;) {
        const { done, value } = it.next();
        if (done) return;
        yield value;
        if (++k >= n) return;
      }
    },
    *product(...lists) {
      if (!lists.length) {
        yield $tuple([]);
        return;
      }
      const [first, ...rest] = lists;
      const tail = [...$m.product(...rest)];
      for (const x of $iter(first)) for (const t of tail) yield $tuple([x, ...t]);
    },
    *permutations(x) {
      const l = [...$iter(x)];
      if (l.length < 2) {
        yield $tuple(l);
        return;
      }
      for (let n = 0; n < l.length; n++)
        for (const rest of $m.permutations([...l.slice(0, n), ...l.slice(n + 1)]))
          yield $tuple([l[n], ...rest]);
    },
    *count(n = 0) {
      for (;;) yield n++;
    },
    *takewhile(f, x) {
      for (const one of $iter(x)) {
        if (!$t(f(one))) return;
        yield one;
      }
    },
  }),
);
const $cached = (fn) => {
  const seen = [];
  const out = function (...args) {
    const had = seen.find(
      (one) => one.args.length === args.length && one.args.every((x, n) => $same(x, args[n])),
    );
    if (had) return had.value;
    const value = fn.apply(this, args);
    seen.push({ args, value });
    if (seen.length > 64) seen.shift();
    return value;
  };
  out.$def = true;
  return out;
};
$module("functools", ($m) =>
  Object.assign($m, {
    cache: $cached,
    lru_cache: () => $cached,
    cached_property: (fn) => new Property(fn, true),
    wraps: () => (f) => f,
    partial:
      (f, ...a) =>
      (...b) =>
        f(...a, ...b),
  }),
);
class Counter extends Dict {
  constructor(x = []) {
    super();
    for (const one of $iter(x)) this.set(one, this.get(one, 0) + 1);
  }
  most_common(n = Infinity) {
    return this.items()
      .sort((a, b) => b[1] - a[1])
      .slice(0, n);
  }
}
$module("collections", ($m) =>
  Object.assign($m, {
    Counter: (x) => new Counter(x),
    defaultdict: (make) => {
      const d = new Dict(),
        get = d.get.bind(d);
      d.has = () => true;
      d.get = (k) => {
        if (!d.of.has($keyOf(k))) d.set(k, make());
        return get(k);
      };
      return d;
    },
  }),
);
$module("bisect", ($m) =>
  Object.assign($m, {
    bisect_right: (l, x) => {
      let low = 0,
        high = l.length;
      while (low < high) {
        const m = (low + high) >> 1;
        if (x < l[m]) high = m;
        else low = m + 1;
      }
      return low;
    },
  }),
);
$module("shlex", ($m) =>
  Object.assign($m, {
    quote: (s) => (/^[\w@%+=:,./-]+$/.test(s) ? s : `'${s.replaceAll("'", "'\"'\"'")}'`),
  }),
);
$module("os", ($m) => Object.assign($m, { cpu_count: () => 1 }));
$module("weakref", ($m) => Object.assign($m, { finalize: () => null }));
$module("csv", ($m) =>
  Object.assign($m, {
    Error: $exception("csv.Error", Exception),
    reader: $fn(
      "lines delimiter skipinitialspace",
      function* (lines, delimiter = ",", skip = false) {
        const more = $iter(lines)[Symbol.iterator]();
        for (let got = more.next(); !got.done; got = more.next()) {
          const out = [];
          let line = got.value,
            at = 0;
          const ended = () => at >= line.length || line[at] === "\n" || line[at] === "\r";
          while (!ended() || out.length) {
            if (skip) while (line[at] === " ") at++;
            let cell = "";
            if (line[at] === '"') {
              at++;
              for (;;) {
                if (at === line.length) {
                  const { done, value } = more.next();
                  if (done) break;
                  line += value; // a cell with several lines
                } else {
                  if (line[at] === '"' && line[++at] !== '"') break;
                  cell += line[at++];
                }
              }
            }
            while (!ended() && line[at] !== delimiter) cell += line[at++];
            out.push(cell);
            if (ended()) break;
            at++;
          }
          yield out;
        }
      },
    ),
    DictReader: $fn("lines skipinitialspace", function* (lines, skip = false) {
      let names = null;
      for (const row of $import("csv").reader(lines, ",", skip)) {
        if (names === null) names = row;
        else if (row.length) {
          const out = $dict(names.map((name, n) => [name, row[n] ?? null]));
          if (row.length > names.length) out.set(null, row.slice(names.length));
          yield out;
        }
      }
    }),
  }),
);

// The algorithm of Ratcliff and Obershelp, as in Python's difflib.
$module("difflib", ($m) => {
  function matches(a, b, a0, a1, b0, b1) {
    let [bi, bj, size] = [a0, b0, 0],
      lengths = new Map();
    for (let i = a0; i < a1; i++) {
      const fresh = new Map();
      for (let j = b0; j < b1; j++)
        if (a[i] === b[j]) {
          const k = (lengths.get(j - 1) ?? 0) + 1;
          fresh.set(j, k);
          if (k > size) [bi, bj, size] = [i - k + 1, j - k + 1, k];
        }
      lengths = fresh;
    }
    if (!size) return 0;
    return size + matches(a, b, a0, bi, b0, bj) + matches(a, b, bi + size, a1, bj + size, b1);
  }
  $m.get_close_matches = $fn("word of n cutoff", (word, of, n = 3, cutoff = 0.6) =>
    [...$iter(of)]
      .map((x) => [
        x.length + word.length
          ? (2 * matches(x, word, 0, x.length, 0, word.length)) / (x.length + word.length)
          : 1,
        x,
      ])
      .filter(([ratio]) => ratio >= cutoff)
      .sort((a, b) => b[0] - a[0] || $order(b[1], a[1]))
      .slice(0, n)
      .map((one) => one[1]),
  );
});

// ---- regular expressions ------------------------------------------------------------------------------

class Match {
  constructor(found) {
    this.found = found;
  }
  group(...n) {
    return n.length > 1
      ? $tuple(n.map((one) => this.group(one)))
      : ((n[0] === undefined
          ? this.found[0]
          : typeof n[0] === "string"
            ? this.found.groups[n[0]]
            : this.found[n[0]]) ?? null);
  }
  groups() {
    return $tuple([...this.found].slice(1).map((x) => x ?? null));
  }
  start() {
    return this.found.index;
  }
  end() {
    return this.found.index + this.found[0].length;
  }
  __getitem__(n) {
    return this.group(n);
  }
}
// Translate Python's regular expressions to JavaScript's: contents of classes, ends of lines and
// texts.
function $translated(source, bytes, lines) {
  const sets = {
    d: bytes ? "0-9" : "\\p{Nd}",
    s: bytes ? " \\t-\\r" : $space.slice(1, -1),
    w: bytes ? "a-zA-Z0-9_" : "\\p{L}\\p{N}_",
  };
  let inside = false;
  return source.replace(/\\(.)|\(\?P<|[.^$[\]]/gsu, (token, letter, at) => {
    if (letter !== undefined) {
      const set = sets[letter.toLowerCase()],
        not = letter !== letter.toLowerCase();
      if (set && inside && not) throw NotImplementedError(`re: no ${token} in a class here`);
      if (set) return inside ? set : `[${not ? "^" : ""}${set}]`;
      if (letter === "Z") return "(?![\\s\\S])";
      return /[\^$\\.*+?()[\]{}|/bBnrtfv0-9x]/.test(letter) || (inside && letter === "-")
        ? token
        : `\\u{${letter.codePointAt(0).toString(16)}}`;
    }
    if (token === "(?P<") return "(?<";
    if (inside) {
      if (token === "]" && !/\[\^?$/.test(source.slice(0, at))) inside = false;
      return token === "[" || (token === "]" && inside) ? `\\${token}` : token;
    }
    if (token === "[") inside = true;
    if (token === "]") return "\\]";
    if (token === "^") return lines ? "(?<![^\\n])" : token;
    if (token === ".") return "[^\\n]";
    if (token === "$") return lines ? "(?=\\n|(?![\\s\\S]))" : "(?=\\n?(?![\\s\\S]))";
    return token;
  });
}
class Pattern {
  constructor(source, flags = "") {
    this.bytes = typeof source !== "string";
    this.source = this.bytes ? $decoded(source, "latin-1") : source;
    const text = $translated(this.source, this.bytes, flags.includes("m"));
    const own = `${flags.replace("m", "")}u`;
    this.anywhere = new RegExp(text, own);
    this.head = new RegExp(text, `${own}y`);
    this.every = new RegExp(text, `${own}g`);
  }
  text(s) {
    return typeof s === "string" ? s : $decoded(s, "latin-1");
  }
  match(s) {
    this.head.lastIndex = 0;
    const found = this.head.exec(this.text(s));
    return found ? new Match(found) : null;
  }
  search(s) {
    const found = this.anywhere.exec(this.text(s));
    return found ? new Match(found) : null;
  }
  fullmatch(s) {
    const found = new RegExp(`(?:${this.head.source})(?![\\s\\S])`, this.head.flags).exec(
      this.text(s),
    );
    return found ? new Match(found) : null;
  }
  sub(by, s) {
    return s.replace(
      this.every,
      typeof by === "string" ? () => by : (...found) => by(new Match(found)),
    );
  }
  split(s) {
    const out = [];
    let at = 0;
    for (const match of s.matchAll(this.every)) {
      out.push(s.slice(at, match.index), ...match.slice(1).map((x) => x ?? null));
      at = match.index + match[0].length;
    }
    return [...out, s.slice(at)];
  }
  findall(s) {
    return [...s.matchAll(this.every)].map((f) =>
      f.length > 2 ? $tuple(f.slice(1)) : f[f.length - 1],
    );
  }
}
$module("re", ($m) => {
  const compile = (source, flags = "") =>
    source instanceof Pattern ? source : new Pattern(source, flags);
  Object.assign($m, { compile, IGNORECASE: "i", MULTILINE: "m", Pattern, Match });
  for (const name of ["match", "search", "fullmatch", "split", "findall"])
    $m[name] = (p, s) => compile(p)[name](s);
  $m.sub = (p, by, s) => compile(p).sub(by, s);
});
Pattern.$isClass = Match.$isClass = true;

// ---- data classes -------------------------------------------------------------------------------------

const $missing = Symbol("missing");
class Field {
  constructor(of) {
    this.default = $missing;
    this.default_factory = $missing;
    this.init = true;
    this.metadata = $dict([]);
    this.compare = true;
    Object.assign(this, of);
  }
}

function $dataclass(cls, { eq = true, order = false } = {}) {
  const inherited = Object.getPrototypeOf(cls).$fields ?? [];
  const own = Object.keys(cls.$notes).map((name) => {
    const given = name in cls.$own ? cls.$own[name] : $missing;
    const field = given instanceof Field ? given : new Field({ default: given });
    if (given instanceof Field) {
      delete cls[name];
      delete cls.prototype[name];
    }
    return Object.assign(field, { name });
  });
  // A field of a parent class keeps its position.
  cls.$fields = [
    ...inherited.map((f) => own.find((o) => o.name === f.name) ?? f),
    ...own.filter((o) => !inherited.some((f) => f.name === o.name)),
  ];
  const taken = cls.$fields.filter((f) => f.init);
  if (!("__init__" in cls.$own))
    cls.prototype.__init__ = $def(
      function (...values) {
        taken.forEach((f, n) => {
          let value = values[n];
          if (value === undefined) {
            if (f.default_factory !== $missing) value = f.default_factory();
            else if (f.default !== $missing) value = f.default;
            else throw TypeError(`${cls.$title} needs ${f.name}`);
          }
          $define(this, f.name, value);
        });
        for (const f of cls.$fields)
          if (!f.init && f.default_factory !== $missing) $define(this, f.name, f.default_factory());
        if (this.__post_init__) this.__post_init__();
        return null;
      },
      taken.map((f) => f.name).join(" "),
    );
  if (eq && !("__eq__" in cls.$own))
    cls.prototype.__eq__ = function (other) {
      return (
        other != null &&
        other.constructor === this.constructor &&
        cls.$fields.every((f) => !f.compare || $t($eq(this[f.name], other[f.name])))
      );
    };
  Object.defineProperty(cls, "$byFields", { value: eq, configurable: true });
  if (order)
    cls.prototype.valueOf = function () {
      throw TypeError("order of data classes");
    };
  if (!cls.prototype.__repr__)
    cls.prototype.__repr__ = function () {
      return `${cls.$title}(${cls.$fields.map((f) => `${f.name}=${repr(this[f.name])}`).join(", ")})`;
    };
  return cls;
}
const $define = (self, name, value) =>
  Object.defineProperty(self, name, {
    value,
    writable: true,
    configurable: true,
    enumerable: true,
  });
object.__setattr__ = $define;
$module("dataclasses", ($m) =>
  Object.assign($m, {
    dataclass: (x) => (x instanceof Kw ? (cls) => $dataclass(cls, x.of) : $dataclass(x)),
    field: (x) => new Field(x instanceof Kw ? x.of : {}),
    fields: (x) => $tuple([...(x.$fields ?? x.constructor.$fields)]),
    replace: $def((of, changes) => {
      const values = Object.fromEntries(
        of.constructor.$fields
          .filter((f) => f.init)
          .map((f) => [f.name, changes.has(f.name) ? changes.get(f.name) : of[f.name]]),
      );
      return of.constructor($kw(values));
    }, "of **changes"),
    asdict: (x) => $dict(x.constructor.$fields.map((f) => [f.name, x[f.name]])),
    is_dataclass: (x) => Boolean(x && x.$fields),
  }),
);

// ---- pydantic -----------------------------------------------------------------------------------------

const ValidationError = $class(
  "ValidationError",
  [ValueError],
  ($c) => {
    $c.errors = $def(function () {
      return this.args[0];
    }, "");
  },
  {},
);
class Validator {
  constructor(mode, fn) {
    this.mode = mode;
    this.fn = fn;
  }
}
class Constraint {
  constructor(of) {
    Object.assign(this, of);
  }
}
class PlainValidator {
  constructor(fn) {
    this.fn = fn;
  }
}

// Convert a value to the type of its field; throws [type, message].
function $validated(kind, value, strict) {
  if (kind instanceof Type && kind.$title === "Annotated") {
    const [base, ...notes] = kind.args,
      plain = notes.find((one) => one instanceof PlainValidator);
    if (plain) return plain.fn(value);
    const out = $validated(base, value, strict);
    for (const c of notes) {
      if (c.allow_inf_nan === false && !Number.isFinite(out))
        throw ["finite_number", "Input should be a finite number"];
      if (c.gt !== undefined && !(out > c.gt))
        throw ["greater_than", `Input should be greater than ${c.gt}`];
      if (c.ge !== undefined && !(out >= c.ge))
        throw ["greater_than_equal", `Input should be greater than or equal to ${c.ge}`];
      if (c.le !== undefined && !(out <= c.le))
        throw ["less_than_equal", `Input should be less than or equal to ${c.le}`];
    }
    return out;
  }
  if (kind instanceof Type && kind.$title === "union") {
    if (value === null && kind.args.includes(null)) return null;
    const real = kind.args.filter((one) => one !== null);
    if (real.length === 1) return $validated(real[0], value, strict);
    for (const one of real) if (isinstance(value, one)) return value;
    throw ["union", "Input is of none of its types"];
  }
  if (kind instanceof Type && kind.$title === "Literal") {
    if (kind.args.includes(value)) return value;
    const words = kind.args.map(repr);
    throw [
      "literal_error",
      `Input should be ${words.length > 1 ? `${words.slice(0, -1).join(", ")} or ${words[words.length - 1]}` : words[0]}`,
    ];
  }
  if (kind === float) {
    if (typeof value !== "number") throw ["float_type", "Input should be a valid number"];
    return value;
  }
  if (kind === int) {
    if (typeof value !== "number" || !Number.isInteger(value))
      throw ["int_type", "Input should be a valid integer"];
    return value;
  }
  if (kind === str) {
    if (typeof value !== "string") throw ["string_type", "Input should be a valid string"];
    return value;
  }
  if (kind === bool) {
    if (typeof value !== "boolean") throw ["bool_type", "Input should be a valid boolean"];
    return value;
  }
  if (kind instanceof Type && kind.$title === "dict") {
    if (!(value instanceof Dict)) throw ["dict_type", "Input should be a valid dictionary"];
    return $dict(
      [...$items(value)].map(([k, v]) => {
        try {
          return [$validated(kind.args[0], k, strict), $validated(kind.args[1], v, strict)];
        } catch (e) {
          if (Array.isArray(e)) throw [...e, k, v];
          throw e;
        }
      }),
    );
  }
  if (kind instanceof Type && kind.$title === "list") {
    if (!Array.isArray(value)) throw ["list_type", "Input should be a valid list"];
    return value.map((v) => $validated(kind.args[0], v, strict));
  }
  if (typeof kind === "function" && kind.$isClass && !isinstance(value, kind))
    throw ["is_instance_of", `Input should be an instance of ${$name(kind)}`];
  return value;
}

const BaseModel = $class(
  "BaseModel",
  [],
  ($c) => {
    $c.__init__ = $def(function (given) {
      const cls = this.constructor,
        errors = [];
      const fail = (kind, loc, msg, input) =>
        errors.push(
          $dict([
            ["type", kind],
            ["loc", $tuple(loc)],
            ["msg", msg],
            ["input", input],
          ]),
        );
      const validators = cls.$validators;
      let data = given;
      try {
        for (const v of validators.filter((one) => one.mode === "before"))
          data = v.fn.fn.call(cls, data);
      } catch (e) {
        if (!isinstance(e, ValueError)) throw e;
        fail("value_error", [], `Value error, ${str(e)}`, data);
        throw ValidationError(errors);
      }
      for (const [name, info] of cls.model_fields.items()) {
        const key = info.alias ?? name;
        if (!data.has(key)) {
          if (info.default === $missing) fail("missing", [key], "Field required", data);
          else
            $define(
              this,
              name,
              info.default instanceof Dict
                ? info.default.copy()
                : Array.isArray(info.default)
                  ? [...info.default]
                  : info.default,
            );
          continue;
        }
        try {
          $define(this, name, $validated(info.annotation, data.get(key), true));
        } catch (e) {
          if (Array.isArray(e))
            fail(e[0], [key, ...e.slice(2, 3)], e[1], e.length > 3 ? e[3] : data.get(key));
          else if (isinstance(e, ValueError))
            fail("value_error", [key], `Value error, ${str(e)}`, data.get(key));
          else throw e;
        }
      }
      const given_ = cls.model_fields
        .items()
        .filter(([name, info]) => data.has(info.alias ?? name));
      $define(this, "model_fields_set", set(given_.map(([name]) => name)));
      const known = cls.model_fields.items().map(([name, info]) => info.alias ?? name);
      for (const [key, value] of $items(data))
        if (!known.includes(key))
          fail("extra_forbidden", [key], "Extra inputs are not permitted", value);
      if (errors.length) throw ValidationError(errors);
      try {
        for (const v of validators.filter((one) => one.mode === "after")) v.fn.call(this);
      } catch (e) {
        if (!isinstance(e, ValueError)) throw e;
        fail("value_error", [], `Value error, ${str(e)}`, data);
        throw ValidationError(errors);
      }
      return null;
    }, "**given");
    $c.model_dump = $def(function (exclude_defaults = false, exclude = null) {
      return $dict(
        this.constructor.model_fields
          .items()
          .filter(
            ([name, info]) =>
              !(exclude && exclude.has(name)) &&
              !(exclude_defaults && info.default !== $missing && $same(info.default, this[name])),
          )
          .map(([name]) => [name, this[name]]),
      );
    }, "exclude_defaults exclude");
    $c.model_copy = $def(function (update = null) {
      const out = Object.create(this.constructor.prototype);
      for (const name of this.constructor.model_fields)
        $define(out, name, update && update.has(name) ? update.get(name) : this[name]);
      const changed = update ? [...update] : [];
      $define(out, "model_fields_set", set([...this.model_fields_set, ...changed]));
      return out;
    }, "update");
    $c.__eq__ = $def(function (other) {
      return (
        other != null &&
        other.constructor === this.constructor &&
        [...this.constructor.model_fields].every((name) => $same(this[name], other[name]))
      );
    }, "other");
  },
  {},
);
BaseModel.$made = (cls) => {
  const parent = Object.getPrototypeOf(cls);
  const own = Object.entries(cls.$own)
    .filter(([, v]) => v instanceof Validator)
    .map(([name, v]) => Object.assign(v, { name }));
  cls.$validators = [
    ...(parent.$validators ?? []).filter((v) => !own.some((o) => o.name === v.name)),
    ...own,
  ];
  let fields = null;
  Object.defineProperty(cls, "model_fields", {
    configurable: true,
    get() {
      if (fields) return fields;
      fields = parent.model_fields ? parent.model_fields.copy() : $dict([]);
      for (const [name, note] of Object.entries(cls.$notes)) {
        const given = name in cls.$own ? cls.$own[name] : $missing;
        fields.set(name, {
          alias: given instanceof Constraint ? (given.alias ?? null) : null,
          default: given instanceof Constraint ? (given.default ?? $missing) : given,
          annotation: note(),
        });
      }
      return fields;
    },
  });
  for (const name of Object.keys(cls.$notes)) {
    delete cls[name];
    delete cls.prototype[name];
  }
};
$module("pydantic", ($m) =>
  Object.assign($m, {
    BaseModel,
    ValidationError,
    ConfigDict: () => null,
    Field: (x) => new Constraint(x instanceof Kw ? x.of : {}),
    PlainValidator: (fn) => new PlainValidator(fn),
    model_validator: (kw) => (fn) => new Validator(kw.of.mode, fn),
  }),
);

// ---- files: a few in memory ------------------------------------------------------------------------------

const $files = new Map(); // path → bytes

class MemoryFile {
  constructor(bytes_) {
    this.bytes = bytes_;
    this.at = 0;
  }
  read(n = -1) {
    const to = n < 0 ? this.bytes.length : Math.min(this.at + n, this.bytes.length),
      out = this.bytes.subarray(this.at, to);
    this.at = to;
    return out;
  }
  readline() {
    const end = this.bytes.indexOf(10, this.at),
      to = end < 0 ? this.bytes.length : end + 1,
      out = this.bytes.subarray(this.at, to);
    this.at = to;
    return out;
  }
  seek(to, from = 0) {
    this.at = from === 2 ? this.bytes.length + to : to;
    return this.at;
  }
  *[Symbol.iterator]() {
    while (this.at < this.bytes.length) yield this.readline();
  }
  close() {}
}
class WrittenFile {
  constructor(name) {
    this.name = name;
    this.parts = [];
  }
  write(text) {
    this.parts.push(text);
    return null;
  }
  close() {
    $files.set(this.name, $encoded(this.parts.join(""), "utf-8"));
    this.parts = [];
  }
}

const Path = $class(
  "Path",
  [],
  ($c) => {
    $c.__init__ = $def(function (of) {
      this.path = str(of);
      return null;
    }, "of");
    $c.__str__ = $def(function () {
      return this.path;
    }, "");
    $c.__repr__ = $def(function () {
      return `PosixPath(${repr(this.path)})`;
    }, "");
    $c.__eq__ = $def(function (other) {
      return other instanceof Path && other.path === this.path;
    }, "other");
    $c.__truediv__ = $def(function (more) {
      return Path(`${this.path}/${str(more)}`);
    }, "more");
    $c.name = property(function () {
      return this.path.split("/").pop();
    });
    $c.suffix = property(function () {
      const at = this.name.lastIndexOf(".");
      return at > 0 && at < this.name.length - 1 ? this.name.slice(at) : "";
    });
    $c.stem = property(function () {
      return $strings.removesuffix(this.name, this.suffix);
    });
    $c.parent = property(function () {
      return Path(this.path.split("/").slice(0, -1).join("/") || ".");
    });
    $c.exists = $def(function () {
      return $files.has(this.path);
    }, "");
    $c.is_dir = $def(function () {
      return false;
    }, "");
    $c.is_file = $c.exists;
    $c.open = $def(function () {
      return new MemoryFile(this.read_bytes());
    }, "mode");
    $c.read_bytes = $def(function () {
      if (!$files.has(this.path)) {
        const e = FileNotFoundError("no such file");
        e.strerror = "No such file or directory";
        throw e;
      }
      return $files.get(this.path);
    }, "");
    $c.write_bytes = $def(function (data) {
      $files.set(this.path, data);
    }, "data");
    $c.read_text = $def(function () {
      return $decoded(this.read_bytes(), "utf-8");
    }, "encoding");
    $c.stat = $def(function () {
      return { st_size: this.read_bytes().length };
    }, "");
    $c.iterdir = $def(function* () {
      for (const path of $files.keys()) if (path.startsWith(`${this.path}/`)) yield Path(path);
    }, "");
    $c.unlink = $def(function () {
      $files.delete(this.path);
      return null;
    }, "missing_ok");
    $c.with_name = $def(function (name) {
      return $div(this.parent, name);
    }, "name");
  },
  {},
);
$module("pathlib", ($m) => Object.assign($m, { Path }));
$module("importlib", ($m) =>
  Object.assign($m, {
    import_module: $import,
    resources: { files: (name) => Path(name.replaceAll(".", "/")) },
  }),
);
$module("importlib.resources", ($m) =>
  Object.assign($m, { files: (name) => Path(name.replaceAll(".", "/")) }),
);
$module("binascii", ($m) =>
  Object.assign($m, {
    crc_hqx(data, crc) {
      for (const byte of data) {
        crc ^= byte << 8;
        for (let n = 0; n < 8; n++) crc = crc & 0x8000 ? (crc << 1) ^ 0x1021 : crc << 1;
        crc &= 0xffff;
      }
      return crc;
    },
  }),
);
let $temporary = 0;
$module("tempfile", ($m) =>
  Object.assign($m, { NamedTemporaryFile: () => new WrittenFile(`/tmp/${$temporary++}.csv`) }),
);
// Compressed files are unpacked when they are opened.
$module("fluxobs.logs.formats.text.packed", ($m) =>
  Object.assign($m, {
    open_packed: (path) => path.open(),
    *whole(lines) {
      yield* lines;
    },
  }),
);
$module("io", ($m) =>
  Object.assign($m, {
    TextIOWrapper: $fn("file encoding errors", (file, encoding) =>
      $decoded(file.read(), encoding, "replace").split(/(?<=\n)/),
    ),
  }),
);
open = $fn("path newline encoding mode", (path) => {
  const text = $decoded(Path(path).read_bytes(), "utf-8");
  return Object.assign(text.replace(/^\ufeff/, "").split(/(?<=\n)/), {});
});

function $fromToml(x) {
  return Array.isArray(x)
    ? x.map($fromToml)
    : typeof x === "bigint"
      ? Number(x)
      : x && typeof x === "object"
        ? $dict(Object.entries(x).map(([k, v]) => [k, $fromToml(v)]))
        : x;
}
$module("tomllib", ($m) => {
  $m.TOMLDecodeError = $exception("TOMLDecodeError", ValueError);
  $m.loads = (text) => {
    try {
      return $fromToml($toml(text));
    } catch (e) {
      throw $m.TOMLDecodeError(String(e.message).split("\n")[0]);
    }
  };
});
$module("scipy.interpolate", ($m) => {
  // Splines with any coefficients over knots, by Cox and de Boor, as functions of x.
  const basis = (knots, degree, k, x) => {
    if (degree === 0) return knots[k] <= x && x < knots[k + 1] ? 1 : 0;
    const a = knots[k + degree] - knots[k],
      b = knots[k + degree + 1] - knots[k + 1];
    return (
      (a > 0 ? ((x - knots[k]) / a) * basis(knots, degree - 1, k, x) : 0) +
      (b > 0 ? ((knots[k + degree + 1] - x) / b) * basis(knots, degree - 1, k + 1, x) : 0)
    );
  };
  // The value at the end of the range is the left limit.
  const basisAtEnd = (knots, degree, k, x) => {
    if (degree === 0) return knots[k] < x && x <= knots[k + 1] ? 1 : 0;
    const a = knots[k + degree] - knots[k],
      b = knots[k + degree + 1] - knots[k + 1];
    return (
      (a > 0 ? ((x - knots[k]) / a) * basisAtEnd(knots, degree - 1, k, x) : 0) +
      (b > 0 ? ((knots[k + degree + 1] - x) / b) * basisAtEnd(knots, degree - 1, k + 1, x) : 0)
    );
  };
  $m.BSpline = (given, coefficients, degree) => {
    const knots = [...$as(given).flat()[0]],
      count = knots.length - degree - 1;
    const at = (order) => (x) => {
      const [xs] = $as(x).flat(),
        out = new Float64Array(xs.length * count);
      const end = knots[count];
      const edge = (p, k, v, o) => {
        if (o > 0) {
          const a = knots[k + p] - knots[k],
            b = knots[k + p + 1] - knots[k + 1];
          return (
            p *
            ((a > 0 ? edge(p - 1, k, v, o - 1) / a : 0) -
              (b > 0 ? edge(p - 1, k + 1, v, o - 1) / b : 0))
          );
        }
        return v >= end ? basisAtEnd(knots, p, k, end) : basis(knots, p, k, v);
      };
      const step = (end - knots[degree]) / (count - degree);
      xs.forEach((v, n) => {
        const near = Math.min(
          Math.max(Math.floor((v - knots[degree]) / step), 0),
          count - degree - 1,
        );
        for (let k = Math.max(0, near - 1); k < Math.min(count, near + degree + 2); k++)
          out[n * count + k] = edge(degree, k, v, order);
      });
      return new NdArray(out, [xs.length, count], "f");
    };
    return Object.assign(at(0), { derivative: (order) => at(order) });
  };
});
