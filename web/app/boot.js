// The first script of a page: it unpacks the other scripts and the style sheet.

const content = (id) => document.getElementById(id).textContent;

// gzip → bytes
window.unpack = async (packed) => {
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
};

// Split the archive into its parts, which are stored one after another (web/build.py).
const packed = Uint8Array.from(atob(content("archive")), (character) => character.charCodeAt(0));
const archive = await window.unpack(packed);
const parts = {};
let at = 0;
for (const [name, length] of Object.entries(JSON.parse(content("parts"))))
  parts[name] = archive.subarray(at, (at += length));
window.parts = parts;

const text = (name) => new TextDecoder().decode(parts[name]);
const style = document.createElement("style");
style.textContent = text("style");
document.head.append(style);
document.querySelector("footer pre").textContent = text("notices");
document.body.hidden = false;
await import(URL.createObjectURL(new Blob([parts.app], { type: "text/javascript" })));
