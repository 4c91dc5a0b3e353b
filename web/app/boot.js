// The first script of a page: it unpacks the others, which are compressed.

// Bytes of text that has seven bits a character (fluxobs/web/columns.py), unpacked.
const ESCAPED = [0, 13, 60];
async function unpack(text) {
  const bytes = new Uint8Array(Math.floor((text.length * 7) / 8));
  for (let n = 0, at = 0, hold = 0, bits = 0; n < text.length; n++) {
    const code = text.charCodeAt(n);
    hold = (hold << 7) | (code < 128 ? code : ESCAPED[code - 128]);
    bits += 7;
    if (bits >= 8) {
      bits -= 8;
      bytes[at++] = hold >> bits;
      hold &= (1 << bits) - 1;
    }
  }
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

window.unpack = unpack;
const code = await unpack(document.getElementById("app").textContent);
await import(URL.createObjectURL(new Blob([code], { type: "text/javascript" })));
