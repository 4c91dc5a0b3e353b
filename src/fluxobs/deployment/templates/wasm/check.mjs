// Replays the record of this export and compares every output bit for bit: node test/check.mjs
import { readFile } from "node:fs/promises";
import process from "node:process";
import { load } from "../@prefix@.mjs";

const text = await readFile(new URL("./record.csv", import.meta.url), "utf8");
const [head, ...rows] = text
  .trimEnd()
  .split("\n")
  .map((line) => line.split(","));
const observer = await load();
let different = 0;
rows.forEach((row, k) => {
  if (k === Math.floor(rows.length / 2)) {
    // a saved state must survive a reset
    const saved = observer.save();
    observer.reset();
    observer.restore(saved);
  }
  const given = row.map((cell) => (cell === "nan" ? NaN : Number(cell)));
  const found = observer.step(...given.slice(0, 4));
  const same = head.slice(4).every((name, n) => Object.is(Number(found[name]) + 0, given[4 + n] + 0));
  different += same ? 0 : 1;
});
if (process.argv.includes("--json")) {
  const by = `Node.js ${process.version}`;
  const what = "@prefix@.wasm";
  const other = "the outputs of the library in double precision, bit for bit";
  console.log(JSON.stringify([{ what, with: other, by, rows: rows.length, different }]));
} else {
  console.log(`${rows.length - different} of ${rows.length} rows equal`);
}
process.exit(different === 0 && rows.length > 0 ? 0 : 1);
