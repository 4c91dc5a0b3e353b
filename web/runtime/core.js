// The observers in WebAssembly, with the Python interface of binding/core.cpp.

let $wasm = null; // exports of the module
const [
  CONFIG,
  ADAPTIVE_CONFIG,
  MAP,
  LEARNT,
  PLAIN,
  ADAPTIVE,
  STATE,
  ADAPTIVE_STATE,
  PLAIN_COLUMNS,
  ALL_COLUMNS,
  SIZES_BYTES,
] = Array(11).keys();
const PLAIN_OUTPUTS = 4,
  ADAPTIVE_OUTPUTS = 5,
  THRESHOLDS = 6,
  SIZES = 7,
  USUAL = 8; // lists of fields after the first four

const $load = (binary) => {
  $wasm = new WebAssembly.Instance(new WebAssembly.Module(binary), {}).exports;
};
const $numbers = (at, count) => new Float64Array($wasm.memory.buffer, at, count);
const $octets = (at, count) => new Uint8Array($wasm.memory.buffer, at, count);

// Return [{name, offset, count}] for a list
function $fieldsOf(list) {
  const view = new DataView($wasm.memory.buffer),
    out = [];
  for (let at = $wasm.fields(list); view.getUint32(at, true); at += 12) {
    const text = view.getUint32(at, true),
      bytes_ = $octets(text, 64);
    out.push({
      name: new TextDecoder().decode(bytes_.slice(0, bytes_.indexOf(0))),
      offset: view.getUint32(at + 4, true),
      count: view.getUint32(at + 8, true),
    });
  }
  return out;
}

function $take(given, list, size = list) {
  const at = $wasm.allocate($wasm.size_of(size));
  for (const { name, offset, count } of $fieldsOf(list)) {
    const values = $as($get(given, name), "f").flat()[0];
    if (values.length !== count)
      throw ValueError(`${name} has ${values.length} numbers, not ${count}`);
    $numbers(at + offset, count).set(values);
  }
  return at;
}

// Read the fields of a list from memory
const $read = (at, list) =>
  $dict(
    $fieldsOf(list).map(({ name, offset, count }) => {
      const v = [...$numbers(at + offset, count)];
      return [name, count === 1 ? v[0] : v];
    }),
  );

const $errors = [
  "",
  "sample_time must be positive, memory ten to a million samples",
  "bases, noises, limits and priors must be positive",
  "every parameter must be finite",
  "sizes do not fit each other: check the units",
];
const $checked = (error) => {
  if (error) throw ValueError($errors[error]);
};

class States {
  constructor(bytes_) {
    this.bytes = bytes_;
    this.shape = $tuple([1, bytes_.length]);
  }
  setflags() {
    return null;
  }
}

class Compiled {
  constructor(adaptive) {
    this.adaptive = adaptive;
    this.word = adaptive ? "adaptive" : "plain";
    this.columns = $wasm.size_of(adaptive ? ALL_COLUMNS : PLAIN_COLUMNS);
    this.bytes = $wasm.size_of(adaptive ? ADAPTIVE_STATE : STATE);
    this.observer = $wasm.allocate($wasm.size_of(adaptive ? ADAPTIVE : PLAIN));
    if (!Compiled.gone)
      Compiled.gone = new FinalizationRegistry((held) => held.forEach((at) => $wasm.release(at)));
    this.held = [this.observer];
    Compiled.gone.register(this, this.held);
  }
  with(state, work) {
    const at = $wasm.allocate(this.bytes);
    if (state) $octets(at, this.bytes).set(state.bytes);
    try {
      const out = work(at);
      return out === undefined ? new States($octets(at, this.bytes).slice()) : out;
    } finally {
      $wasm.release(at);
    }
  }
  reset() {
    return this.with(null, (at) => {
      $wasm[`reset_${this.word}`](this.observer, at);
    });
  }
  run(states, source, current, voltSeconds) {
    const rows = current.shape[1],
      u = $wasm.allocate(16 * rows),
      i = $wasm.allocate(16 * rows),
      out = $wasm.allocate(8 * rows * this.columns),
      valid = $wasm.allocate(rows);
    $numbers(u, 2 * rows).set(source.flat()[0]);
    $numbers(i, 2 * rows).set(current.flat()[0]);
    const next_ = this.with(states, (at) => {
      $wasm[`run_${this.word}`](this.observer, at, u, i, rows, voltSeconds ? 1 : 0, out, valid);
    });
    const columns = $numbers(out, rows * this.columns).slice(),
      known = $octets(valid, rows).slice();
    [u, i, out, valid].forEach((at) => $wasm.release(at));
    return $tuple([
      next_,
      new NdArray(columns, [this.columns, 1, rows], "f"),
      new NdArray(known, [1, rows], "b"),
    ]);
  }
  counters(states) {
    return this.with(states, (at) => {
      const to = $wasm.allocate(24);
      $wasm.counters(at, this.adaptive ? 1 : 0, to);
      const out = $tuple([...new Uint32Array($wasm.memory.buffer, to, 6)]);
      $wasm.release(to);
      return out;
    });
  }
}

class PlainCore extends Compiled {
  constructor(config, map) {
    super(false);
    this.config = $take(config, CONFIG);
    this.map = 0;
    this.held.push(this.config);
    if (map.__len__()) {
      this.map = $take(map, MAP);
      const table = $as(map.get("coefficients"), "f"),
        at = $wasm.allocate(8 * Math.max(1, table.size));
      $numbers(at, table.size).set(table.flat()[0]);
      $wasm.shape_map(
        this.map,
        map.get("kind"),
        map.get("magnets") ? 1 : 0,
        table.shape[0],
        table.shape[1],
        at,
      );
      this.held.push(this.map, at);
    }
    $checked($wasm.make_plain(this.observer, this.config, this.map));
  }
}

class AdaptiveCore extends Compiled {
  constructor(core, config) {
    super(true);
    this.core = core; // keeps configuration and map in memory
    const given = $take(config, ADAPTIVE_CONFIG);
    this.held.push(given);
    $checked(
      $wasm.make_adaptive(this.observer, core.config, given, config.get("projection"), core.map),
    );
  }
  learnt(states) {
    return this.with(states, (at) => {
      const to = $wasm.allocate($wasm.size_of(LEARNT));
      $wasm.learnt(this.observer, at, to);
      const out = $read(to, LEARNT);
      $wasm.release(to);
      return out;
    });
  }
  restart(states, frozen) {
    return this.with(states, (at) => {
      $wasm.restart(this.observer, at, frozen ? 1 : 0);
    });
  }
  restarts(states) {
    return this.with(states, (at) => $wasm.restarts(at));
  }
}
// map_for and frozen are keyword arguments in Python
AdaptiveCore.prototype.restart = $fn("states frozen", AdaptiveCore.prototype.restart);

const $outputNames = (list) => $fieldsOf(list).map(({ name, count }) => $tuple([name, count]));
const $listed = (list) => {
  const names = $fieldsOf(list),
    values = $numbers($wasm.values(list === USUAL), names.length);
  return $dict(names.map(({ name }, n) => [name, values[n]]));
};
const $choose = (sizes, ...given) => {
  const of = $take(sizes, SIZES, SIZES_BYTES),
    at = $wasm.allocate($wasm.size_of(CONFIG));
  $wasm.choose(at, of, ...given);
  const out = $read(at, CONFIG);
  [of, at].forEach((one) => $wasm.release(one));
  return out;
};
const $kinkWeights = (share) => {
  const at = $wasm.allocate(16);
  $wasm.kink_weights(share, at);
  const out = $tuple([...$numbers(at, 2)]);
  $wasm.release(at);
  return out;
};
const $coreModule = ($m) => {
  $m.choose = $choose;
  $m.kink_weights = $kinkWeights;
  Object.defineProperty($m, "usual", { get: () => $listed(USUAL) });
  $m.Core = (config, map) => new PlainCore(config, map);
  $m.Adaptive = (core, config) => new AdaptiveCore(core, config);
  Object.defineProperty($m, "outputs", { get: () => $outputNames(PLAIN_OUTPUTS) });
  Object.defineProperty($m, "thresholds", { get: () => $listed(THRESHOLDS) });
  Object.defineProperty($m, "adaptive_outputs", { get: () => $outputNames(ADAPTIVE_OUTPUTS) });
};
$module("fluxobs._core", $coreModule);
$module("fluxobs._core_single", ($m) => {
  $m.Core = $m.Adaptive = () => {
    throw ValueError("the page computes in double precision only");
  };
});

// The estimate of a whole log, with the Python interface of binding/smoother.cpp.
const $smoothingNames = (of) => {
  const at = $wasm.smoothing_names(of),
    bytes_ = $octets(at, 1024);
  return new TextDecoder().decode(bytes_.slice(0, bytes_.indexOf(0)));
};
const ASSUMPTIONS = 0,
  MODEL_FIELDS = 1,
  MAP_FIELDS = 2,
  OUTPUTS = 3;
const $estimateLog = (
  numbers,
  std,
  kind,
  map,
  coefficients,
  voltage,
  current,
  flags,
  angle,
  angleStd,
  start,
  covariance,
  filterScale,
  learning,
) => {
  const held = [],
    room = (bytes_) => {
      const at = $wasm.allocate(Math.max(8, bytes_));
      if (!at) throw ValueError("the log is too long for the page");
      held.push(at);
      return at;
    },
    put = (array) => {
      const values = $as(array, "f").flat()[0],
        at = room(8 * values.length);
      $numbers(at, values.length).set(values);
      return at;
    };
  const rows = voltage.shape[0],
    active = covariance.shape[0],
    [assumptions, about, outputs, shares, quantities] = [0, 1, 2, 3, 4].map((n) =>
      $wasm.smoothing_size(n),
    ),
    fields = $smoothingNames(MODEL_FIELDS).trim().split(" "),
    field = (name) => numbers.flat()[0][fields.indexOf(name)],
    blocks = Math.floor(rows / $wasm.block_rows(field("sample_time"), field("speed")));
  try {
    const states = room(rows),
      p = put(start),
      posterior = put(covariance),
      told = room(8 * about),
      columns = room(8 * outputs * rows),
      known = room(rows),
      budget = room(8 * blocks * quantities * shares);
    $octets(states, rows).set($as(flags).flat()[0]);
    $numbers(told, about)[3] = filterScale;
    const good = $wasm.estimate_log(
      put(numbers),
      put(std),
      kind,
      put(map),
      put(coefficients),
      coefficients.shape[0],
      coefficients.shape[1],
      rows,
      put(voltage),
      put(current),
      states,
      put(angle),
      put(angleStd),
      learning ? 1 : 0,
      p,
      posterior,
      told,
      columns,
      known,
      budget,
    );
    if (!good) throw ValueError("the log is too long for the page");
    const array = (at, ...shape) =>
      new NdArray(
        $numbers(
          at,
          shape.reduce((a, b) => a * b, 1),
        ).slice(),
        shape,
        "f",
      );
    return $tuple([
      array(p, assumptions),
      array(posterior, active, active),
      array(told, about),
      array(columns, outputs, rows),
      new NdArray(Float64Array.from($octets(known, rows)), [rows], "i"),
      array(budget, blocks, quantities, shares),
    ]);
  } finally {
    held.forEach((at) => $wasm.release(at));
  }
};
$module("fluxobs._smoother", ($m) => {
  for (const [name, of] of [
    ["assumptions", ASSUMPTIONS],
    ["model_fields", MODEL_FIELDS],
    ["map_fields", MAP_FIELDS],
    ["outputs", OUTPUTS],
  ])
    Object.defineProperty($m, name, { get: () => $smoothingNames(of) });
  $m.rows_per_block = (sampleTime, speed) => $wasm.block_rows(sampleTime, speed);
  $m.estimate = $estimateLog;
});
