// The flux observer of one machine, for browsers, Node.js and Deno. Content @content@.
//
//   import { load } from "./@prefix@.mjs";
//   const observer = await load();
//   const { theta_e, speed_e, valid } = observer.step(u_alpha, u_beta, i_alpha, i_beta);
//
// SI units; the stationary frame, amplitude-invariant, per phase; the voltage is the mean over the
// interval that ends at the current. A step is @step_time@ s. NaN is a missing sample.

export const SAMPLE_TIME = @step_time@; // [s]
export const OUTPUTS = @names@;
const BOOLEAN = new Set(@booleans@);

class Observer {
  constructor(exports) {
    this.exports = exports;
    this.inputs = new Float64Array(exports.memory.buffer, exports.inputs(), 4);
    this.outputs = new Float64Array(exports.memory.buffer, exports.outputs(), OUTPUTS.length);
    this.reset();
  }

  // Start over with unknown position.
  reset() {
    this.exports.reset();
  }

  // Process one sample; return the estimate, an object with the names in OUTPUTS.
  step(u_alpha, u_beta, i_alpha, i_beta) {
    this.inputs.set([u_alpha, u_beta, i_alpha, i_beta]);
    this.exports.step();
    const found = {};
    OUTPUTS.forEach((name, k) => {
      found[name] = BOOLEAN.has(name) ? this.outputs[k] > 0.5 : this.outputs[k];
    });
    return found;
  }

  // Return the state as bytes for restore(), preceded by the module's content: restore() accepts only
  // a state of the same module.
  save() {
    const content = this.content();
    const saved = new Uint8Array(content.length + this.state().length);
    saved.set(content);
    saved.set(this.state(), content.length);
    return saved;
  }

  restore(saved) {
    const content = this.content();
    const size = content.length + this.state().length;
    if (saved.length !== size) {
      throw new Error(`a state of ${saved.length} bytes; this observer's has ${size}`);
    }
    if (!content.every((byte, k) => saved[k] === byte)) {
      throw new Error("a state of another observer: save and restore need the same export");
    }
    this.state().set(saved.subarray(content.length));
  }

  content() {
    return this.bytes("content");
  }

  state() {
    return this.bytes("state");
  }

  bytes(name) {
    const { memory, [name]: address, [`${name}_size`]: size } = this.exports;
    return new Uint8Array(memory.buffer, address(), size());
  }
}

// Return a new observer. Without `module` (bytes or a compiled module), load the file beside this one.
export async function load(module) {
  let given = module;
  if (given === undefined) {
    const place = new URL("./@prefix@.wasm", import.meta.url);
    given =
      place.protocol === "file:"
        ? await (await import("node:fs/promises")).readFile(place)
        : await (await fetch(place)).arrayBuffer();
  }
  const made = await WebAssembly.instantiate(given, {});
  return new Observer((made.instance ?? made).exports);
}
