// Requests to the worker, as functions that return promises.

export const { unpack, parts } = window; // set by boot.js

export async function start(onProgress = () => {}) {
  const source = new Blob([parts.worker], { type: "text/javascript" });
  const worker = new Worker(URL.createObjectURL(source));
  const waiting = new Map();
  let last = 0;
  worker.onmessage = ({ data: { id, result, error, progress, stack } }) => {
    const one = waiting.get(id);
    if (progress !== undefined) {
      onProgress(progress);
      return;
    }
    waiting.delete(id);
    if (error === undefined) one.resolve(result);
    else one.reject(Object.assign(new Error(error), { workerStack: stack }));
  };
  worker.onerror = (event) => {
    for (const one of waiting.values())
      one.reject(new Error(`the worker stopped: ${event.message}`));
    waiting.clear();
  };
  const ask = (action, given, transfer = []) =>
    new Promise((resolve, reject) => {
      const id = ++last;
      waiting.set(id, { resolve, reject });
      worker.postMessage({ id, action, given }, transfer);
    });
  await ask("start", { wasm: parts.wasm });
  return ask;
}
