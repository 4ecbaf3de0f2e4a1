// Asks the server for jobs, one after the other: an answer holds a job, and what came of it goes out with the next request.
//
// Bodies are, in both directions: the length of a header in bytes (uint32), the header in JSON with blanks behind it, and arrays. The
// first number and the header together have a length that 8 divides. A header's `arrays` lists name, type and length.
import { describe, frame } from './scene.js';

const TYPES = { float32: Float32Array, uint32: Uint32Array, uint8: Uint8Array };

function unpacked(body) {
  const length = new DataView(body).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(body, 4, length)));
  const arrays = {};
  let at = 4 + length;
  for (const [name, type, count] of header.arrays) {
    arrays[name] = new TYPES[type](body, at, count);
    at += arrays[name].byteLength;
  }
  return [header, arrays];
}

function packed(header, arrays) {
  const listed = Object.entries(arrays).map(([name, values]) => [
    name, values.constructor.name.replace('Array', '').toLowerCase(), values.length]);
  let text = new TextEncoder().encode(JSON.stringify({ ...header, arrays: listed }));
  const blanks = (8 - (4 + text.length) % 8) % 8;
  const first = new DataView(new ArrayBuffer(4));
  first.setUint32(0, text.length + blanks, true);
  return new Blob([first, text, new Uint8Array(blanks).fill(32), ...Object.values(arrays)]);
}

function done(body) {
  const [header, arrays] = unpacked(body);
  try {
    return packed({ job: header.job }, frame(header, arrays));
  } catch (error) {
    return packed({ job: header.job, error: String(error) }, {});
  }
}

let result = packed({ job: 0, ...describe() }, {});
for (;;) {
  let answer;
  try {
    answer = await fetch('next', { method: 'POST', body: result });
  } catch {
    break; // the server has gone, so nobody needs this browser any more
  }
  const body = await answer.arrayBuffer();
  result = body.byteLength > 0 ? done(body) : null; // there was no job for a while: ask again
}
window.close();
