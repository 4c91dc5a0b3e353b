// The program behind the page, in a worker: it opens logs, estimates and checks. The translated
// package does the work; this file only defines the page's requests and the shape of the answers.

const $py = (name) => $import(`fluxobs.${name}`);
// Convert Python values to values that can be posted, and back.
const plain = (x) =>
  x == null
    ? null
    : x instanceof Dict
      ? Object.fromEntries(x.items().map(([k, v]) => [k, plain(v)]))
      : x instanceof NdArray
        ? plain(x.tolist())
        : Array.isArray(x)
          ? Array.from(x, plain)
          : x instanceof PySet
            ? [...x].map(plain)
            : typeof x === "object" || typeof x === "function"
              ? str(x)
              : x;
const python = (x) =>
  Array.isArray(x)
    ? x.map(python)
    : x && typeof x === "object"
      ? $dict(Object.entries(x).map(([k, v]) => [k, python(v)]))
      : x;

const opened = { paths: [], log: null, run: null, kept: null, watch: null, recorded: [] };

// Columns for drawing, in double precision as long as memory allows.
const DOUBLE_ROWS = 3_000_000;
function gather(total) {
  const out = new Map();
  let at = 0;
  return {
    add(rows) {
      const parts = [...rows.columns.items(), ...rows.more.items()];
      if (rows.innovation !== null) parts.push(["innovation", rows.innovation]);
      for (const [name, array] of parts) {
        const [d] = array.flat();
        if (!out.has(name))
          out.set(
            name,
            array.kind === "b"
              ? new Uint8Array(total)
              : name === "t" || total <= DOUBLE_ROWS
                ? new Float64Array(total)
                : new Float32Array(total),
          );
        out.get(name).set(d, at);
      }
      at += rows.valid.size;
    },
    columns: () => Object.fromEntries(out),
  };
}
const columnsOf = (rows) => {
  const kept = gather(rows.valid.size);
  kept.add(rows);
  return kept.columns();
};

// Add the currents and voltages of the rows, as the pictures show them.
function withSignals(columns, log, lag) {
  const angle = (name) =>
    name in columns ? new NdArray(Float64Array.from(columns[name]), [columns.t.length], "f") : null;
  const added = $py("presentation.plot_data").signals(
    log,
    opened.run.machine.ports,
    lag,
    angle("theta_e"),
    angle("speed_e"),
  );
  for (const [name, values] of added.items()) [columns[name]] = values.flat();
  return columns;
}

// Read a machine from the text of its file.
function machineFrom(text) {
  const { loads, TOMLDecodeError } = $import("tomllib");
  const { machine_from } = $py("machines");
  try {
    return machine_from(loads(text), "machine", Path("fluxobs/machines/examples"));
  } catch (e) {
    if (isinstance(e, TOMLDecodeError))
      throw $py("errors").MachineError(`machine: not TOML: ${str(e)}`);
    throw e;
  }
}

function layoutOf(options) {
  const layout = Object.fromEntries(
    Object.entries(options ?? {}).filter(
      ([, v]) =>
        v !== null &&
        v !== "" &&
        !(typeof v === "object" && !Array.isArray(v) && !Object.keys(v).length),
    ),
  );
  return Object.fromEntries(Object.entries(layout).map(([k, v]) => [k, python(v)]));
}

const settings = (given) => ({
  unknowns: given.unknowns ?? "auto",
  memory: given.memory ?? null,
  causal: given.causal ?? false,
  priors: python(given.priors ?? {}),
});

// Estimate a log and return the columns, for the page and for reports.
function runOver(log, machine, unknowns, memory, priors, causal, progress) {
  const share = (done, of) => progress(done / of);
  const passes = $py("estimation.passes").Passes.begun(
    log,
    machine,
    unknowns,
    memory,
    priors,
    causal,
    share,
  );
  const kept = gather(len(log));
  for (const rows of passes.rows(share)) kept.add(rows);
  opened.log = log;
  opened.run = $py("presentation.explanation").ExplainedRun(
    $kw(Object.fromEntries(passes.found().items())),
  );
  opened.kept = null;
  return withSignals(kept.columns(), log, opened.run.lag?.lag ?? null);
}

const actions = {
  machines() {
    const { example_names, example_text, KINDS } = $py("machines"),
      { unit_of } = $py("machines.contract"),
      { FIELDS } = $py("machines.datasheet");
    return {
      examples: Object.fromEntries(example_names().map((name) => [name, example_text(name)])),
      kinds: Object.fromEntries(
        KINDS.items().map(([kind, cls]) => [
          kind,
          cls.parameter_names().map((name) => ({ name, unit: unit_of(name) })),
        ]),
      ),
      sheet: plain(FIELDS),
      presets: [...$py("logs.meaning.presets").preset_names()],
    };
  },

  // Create a machine file from data-sheet values.
  sheet({ kind, fields }) {
    const made = $py("machines.new").new_machine(kind, python(fields));
    return { text: made.text, assumed: plain(made.assumed) };
  },

  open({ files }) {
    for (const { name, bytes: data } of files) $files.set(name, new Uint8Array(data));
    opened.paths = files.map((one) => one.name);
    opened.log = opened.run = opened.kept = null;
    return {};
  },

  channels({ options }) {
    const layout = layoutOf(options);
    const listing = $py("logs.meaning.channels").list_channels(
      ...opened.paths,
      $kw(layout.header ? { header: layout.header } : {}),
    );
    return {
      channels: listing.channels.map((one) => ({ ...plain(one.facts) })),
      notes: plain(listing.notes),
    };
  },

  estimate({ machine, options, ...given }, progress) {
    const { unknowns, memory, causal, priors } = settings(given);
    const made = machineFrom(machine),
      join = opened.paths.slice(1),
      layout = layoutOf({ ...options, ...(join.length ? { join } : {}) });
    const log = $py("logs.for_machine").open_for(opened.paths[0], made, $kw(layout));
    const chosen = $py("observers.unknowns").read_unknowns(unknowns);
    const columns = runOver(log, made, chosen, memory, priors, causal, progress);
    return {
      columns,
      notes: plain(log.notes),
      summary: plain($py("presentation.summary").summary_rows(opened.run, null, null)),
      ...plain($py("presentation.plot_data").shown(opened.run)),
    };
  },

  // Repeat the run of a report from the record in it.
  rerun({ columns, t, start, layout, machine, unknowns, causal, memory, priors }, progress) {
    const { truth, ...fields } = layout,
      channels = Object.entries(columns).map(([name, values]) => [
        name === "truth" ? truth : name,
        new NdArray(values, [values.length], "f"),
      ]);
    const made = machineFrom(machine);
    const given = Object.fromEntries(Object.entries(fields).filter(([, v]) => v !== null));
    const log = $py("logs.for_machine").open_for(
      $dict(channels),
      made,
      $kw({
        ...given,
        ...(truth ? { truth: $dict([[truth, truth]]) } : { truth: $dict([["none", "-"]]) }),
      }),
    );
    const out = runOver(log, made, $tuple([...unknowns]), memory, python(priors), causal, progress);
    for (let k = 0; k < out.t.length; k++) out.t[k] = t ? t[k] : start + out.t[k];
    return { columns: out };
  },

  // Summary, warnings and findings, which take longer than the plots.
  explain() {
    const run = opened.run;
    const found = run.checked,
      fit = run.truth_fit;
    return {
      summary: plain(run.summary_rows),
      warnings: plain(run.warnings),
      facts: plain(run.facts),
      findings: found === null ? [] : found.findings.map((one) => plain(one.facts)),
      check_notes: found === null ? [] : plain(found.lines().slice(found.findings.length)),
      fit: fit === null ? null : plain(fit.words),
    };
  },

  // Estimate the same rows with other parameters.
  again({ changes, memory, lag, unknowns, priors }) {
    opened.kept ??= $py("estimation.rerun").Again(opened.log, opened.run.scales);
    const machine = opened.run.machine.with_values($kw(changes ?? {}));
    const chosen = unknowns ?? plain(opened.run.unknowns);
    const rows = opened.kept.rows(
      machine,
      $tuple([...chosen]),
      memory ?? null,
      python(priors ?? {}),
      lag ?? null,
    );
    return { columns: withSignals(columnsOf(rows), opened.log, lag ?? null) };
  },

  // Start to estimate a stream.
  watch({ machine, options, ...given }) {
    const { unknowns, memory, priors } = settings(given);
    const { Watch } = $py("live"),
      made = machineFrom(machine);
    const layout = { ...layoutOf(options), unknowns, memory, priors };
    opened.watch = Watch(made, Path("stream"), $kw(layout));
    return {
      ...plain($py("presentation.plot_data").shown_machine(made)),
      adaptive: opened.watch.unknowns.length > 1,
    };
  },

  // Process the next bytes of the stream, or the last; return their estimates.
  feed({ bytes: data, last }) {
    const { watch, recorded } = opened,
      parts = [...watch.feed(data, last)],
      kept = gather(parts.reduce((sum, rows) => sum + rows.valid.size, 0));
    for (const rows of parts) kept.add(rows);
    const { rows, valid, lost, damaged, restarts, chosen, waiting } = watch.status,
      log = watch.log;
    return {
      columns: kept.columns(),
      status: { rows, valid, lost, damaged, restarts, chosen, waiting },
      notes: log === null ? [] : [...plain(log.notes), `${1 / log.sample_time} rows a second`],
      recorded: recorded.splice(0),
    };
  },

  // Start or stop recording the rows of the stream as lines of CSV.
  record({ on }) {
    opened.watch.record(on ? (lines) => void opened.recorded.push(lines) : null);
    return {};
  },

  // The machine file with the learnt parameters, or with the given ones.
  machine_file() {
    const { machine_text } = $py("machines.file_text"),
      run = opened.run,
      learnt = run.machine_learnt;
    const found = run.found,
      names = opened.log.path.name;
    return {
      text: machine_text(
        learnt,
        found.__len__()
          ? [`Learnt from ${names} by the page of fluxobs.`]
          : ["Written by the page of fluxobs."],
        found,
      ),
    };
  },
};

let working = Promise.resolve();
onmessage = ({ data: { id, action, given } }) => {
  working = working.then(async () => {
    const progress = (share) => {
      const now = performance.now();
      if (now - (progress.last ?? 0) > 100) {
        progress.last = now;
        postMessage({ id, progress: share });
      }
    };
    try {
      if (action === "start") {
        $load(given.wasm);
        // keep everything read: there are no files to read again
        $py("errors").name_flags(true); // the page names its own fields in their place
        const source = $py("logs.formats.text.source");
        source.KEPT = source.KEPT_NUMBERS = 2 ** 30;
        postMessage({ id, result: {} });
        return;
      }
      const result = await actions[action](given ?? {}, progress);
      const arrays = Object.values(result?.columns ?? {}).map((one) => one.buffer);
      postMessage({ id, result }, arrays);
    } catch (e) {
      const known = isinstance(e, BaseException);
      postMessage({
        id,
        error: known ? str(e) : `internal error of the page, please report it: ${e.message ?? e}`,
        stack: e.stack,
      });
    }
  });
};
