// The print's points, as packed.py packs them: differences from point to point, byte plane after byte plane, deflated.
"use strict";

const EXTRUDING = 128, BREAK = 64, FEATURE = 63;

async function bytesOf(text) {
  const packed = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const plain = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(plain).arrayBuffer());
}

function columnsOf(bytes, n) {
  let at = 0;
  return (Type, width = 1) => {
    const column = new Type(n * width), size = Type.BYTES_PER_ELEMENT;
    for (let k = 0; k < width; k++, at += n * size) {
      for (let i = 0, value = 0; i < n; i++) {
        for (let j = 0; j < size; j++) value += bytes[at + j * n + i] << (8 * j);
        column[i * width + k] = value |= 0;
      }
    }
    return column;
  };
}

async function unpack(method) {
  const n = method.count, take = columnsOf(await bytesOf(method.data), n);
  return {
    ...method, n,
    foot: take(Uint16Array, 3), away: take(Int16Array, 3), due: take(Uint32Array),
    layer: take(Uint16Array), error: take(Uint8Array), kind: take(Uint8Array),
    x: new Float32Array(n), y: new Float32Array(n),
  };
}

// What the print extrudes, evaluated or not; `layer` is the print's own number.
async function unpackOutline(outline) {
  const n = outline.count, take = columnsOf(await bytesOf(outline.data), n);
  return { n, foot: take(Uint16Array, 3), layer: take(Uint16Array), kind: take(Uint8Array) };
}
