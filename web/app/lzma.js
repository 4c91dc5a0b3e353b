// The decoder alone: the library's own door leads to its encoder too.

import { Decoder } from "../node_modules/lzma1/lib/decoder.js";
import { InputBuffer, OutputBuffer } from "../node_modules/lzma1/lib/streams.js";

export function unlzma(data) {
  const out = new OutputBuffer(1 << 20);
  new Decoder().decompress(new InputBuffer(data), out);
  return out.toArray();
}
