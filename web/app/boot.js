// The first script of a page: it unpacks the others, and the style.

// Bytes of text that has seven bits a character (fluxobs/web/columns.py).
const ESCAPED = [0, 13, 60];
function bytes(text) {
  const out = new Uint8Array(Math.floor((text.length * 7) / 8));
  for (let n = 0, at = 0, hold = 0, bits = 0; n < text.length; n++) {
    const code = text.charCodeAt(n);
    hold = (hold << 7) | (code < 128 ? code : ESCAPED[code - 128]);
    bits += 7;
    if (bits >= 8) {
      bits -= 8;
      out[at++] = hold >> bits;
      hold &= (1 << bits) - 1;
    }
  }
  return out;
}

async function unpack(text) {
  const stream = new Blob([bytes(text)]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

const content = (id) => document.getElementById(id).textContent;
const run = (code) => import(URL.createObjectURL(new Blob([code], { type: "text/javascript" })));

// The parts of the archive, one after the other (web/build.py).
const { unlzma } = await run(await unpack(content("lzma"))),
  archive = unlzma(bytes(content("archive")));
const parts = {};
let at = 0;
for (const [name, length] of Object.entries(JSON.parse(content("parts"))))
  parts[name] = archive.subarray(at, (at += length));
const style = document.createElement("style");
style.textContent = new TextDecoder().decode(parts.style);
document.head.append(style);
document.querySelector("footer pre").textContent = new TextDecoder().decode(parts.notices);
document.body.hidden = false;

window.unpack = unpack;
window.parts = parts;
await run(parts.app);
