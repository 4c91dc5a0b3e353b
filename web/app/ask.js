// The worker, as functions that return promises.

// Bytes of text that has seven bits a character (fluxobs/web/columns.py), unpacked.
const ESCAPED = [0, 13, 60];
export async function unpack(text) {
  const bytes = new Uint8Array(Math.floor((text.length * 7) / 8));
  for (let n = 0, at = 0, hold = 0, bits = 0; n < text.length; n++) {
    const code = text.charCodeAt(n);
    hold = (hold << 7) | (code < 128 ? code : ESCAPED[code - 128]);
    bits += 7;
    if (bits >= 8) { bits -= 8; bytes[at++] = hold >> bits; hold &= (1 << bits) - 1; }
  }
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}
export const unpacked = (id) => unpack(document.getElementById(id).textContent);

export async function start(onProgress = () => {}) {
  const source = new TextDecoder().decode(await unpacked("worker"));
  const worker = new Worker(URL.createObjectURL(new Blob([source], { type: "text/javascript" })));
  const waiting = new Map();
  let last = 0;
  worker.onmessage = ({ data: { id, result, error, progress, stack } }) => {
    const one = waiting.get(id);
    if (progress !== undefined) { onProgress(progress); return; }
    waiting.delete(id);
    if (error === undefined) one.resolve(result);
    else one.reject(Object.assign(new Error(error), { workerStack: stack }));
  };
  worker.onerror = (event) => { for (const one of waiting.values()) one.reject(new Error(`the worker stopped: ${event.message}`)); waiting.clear(); };
  const ask = (action, given, transfer = []) => new Promise((resolve, reject) => { const id = ++last; waiting.set(id, { resolve, reject }); worker.postMessage({ id, action, given }, transfer); });
  const wasm = await unpacked("wasm");
  await ask("start", { wasm });
  return ask;
}
