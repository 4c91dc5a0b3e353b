// The demo log: whole numbers over powers of ten, of which the archive has the second differences,
// column by column, their low bytes first (web/build.py).

const PLANES = 3;

export function demoLog(packed) {
  const length = packed[0] | (packed[1] << 8),
    { digits, rows } = JSON.parse(new TextDecoder().decode(packed.subarray(2, 2 + length))),
    lines = Array.from({ length: rows }, () => []);
  let at = 2 + length;
  for (const places of Object.values(digits)) {
    let value = 0,
      step = 0;
    for (let k = 0; k < rows; k++) {
      let change = 0;
      for (let p = PLANES - 1; p >= 0; p--) change = (change << 8) | packed[at + p * rows + k];
      step += (change << 8) >> 8; // its sign
      value += step;
      lines[k].push((value / 10 ** places).toFixed(places));
    }
    at += PLANES * rows;
  }
  return [Object.keys(digits), ...lines].map((line) => `${line.join(",")}\n`).join("");
}
