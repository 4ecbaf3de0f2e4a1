// Asks the server for jobs, one after the other: an answer holds a job, and what came of it goes out with the next request.
//
// A job is the length of a header in bytes (uint32), the header in JSON with blanks behind it, and arrays. The first number and
// the header together have a length that 8 divides. A header's `arrays` lists name, type and length. What comes of it is pixels.
import { frame } from './scene.js';

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

let result = 'ready';
for (;;) {
  let answer;
  try {
    answer = await fetch('next', { method: 'POST', body: result });
  } catch {
    break; // the server has gone, so nobody needs this browser any more
  }
  const body = await answer.arrayBuffer();
  result = null; // there was no job for a while: ask again
  try {
    if (body.byteLength > 0) result = new Blob(frame(...unpacked(body)));
  } catch (error) {
    report('error', error);
  }
}
window.close();
