// The worker, as functions that return promises.

const unpack = window.unpack; // of boot.js
export { unpack };
export const unpacked = (id) => unpack(document.getElementById(id).textContent);

export async function start(onProgress = () => {}) {
  const source = new TextDecoder().decode(await unpacked("worker"));
  const worker = new Worker(URL.createObjectURL(new Blob([source], { type: "text/javascript" })));
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
  const wasm = await unpacked("wasm");
  await ask("start", { wasm });
  return ask;
}
