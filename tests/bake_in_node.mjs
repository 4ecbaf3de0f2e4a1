// Bakes what a file of JSON describes, and writes what comes back beside it: tests/test_web.py compares it.

import { readFile, writeFile } from 'node:fs/promises';
import { dirname, join } from 'node:path';

import { bake, ktx2 } from '../web/src/index.js';

const KINDS = { uint8: Uint8Array, uint16: Uint16Array, float32: Float32Array };

const folder = dirname(process.argv[2]);
const job = JSON.parse(await readFile(process.argv[2], 'utf8'));
/** @type {Record<string, any>} */
const maps = {};
for (const [name, map] of Object.entries(job.maps)) {
    const [height, width, channels] = map.shape;
    const kind = KINDS[/** @type {keyof typeof KINDS} */ (map.dtype)];
    maps[name] = {
        data: new kind(new Uint8Array(await readFile(join(folder, map.file))).buffer),
        width,
        height,
        channels,
    };
}
const stack = await bake(maps, job.options);
/** @param {string} file @param {any} image */
async function kept(file, { data, width, height, channels }) {
    await writeFile(join(folder, file), new Uint8Array(data.buffer, data.byteOffset, data.byteLength));
    return { file, shape: [height, width, channels], dtype: data.constructor.name.replace('Array', '').toLowerCase() };
}
const stored = await Promise.all(stack.stored.map((level, i) => kept(`stored_${i}`, level)));
const levels = [];
for (const [i, level] of stack.levels.entries()) {
    const files = Object.entries(level).map(async ([name, map]) => [name, await kept(`${name}_${i}`, map)]);
    levels.push(Object.fromEntries(await Promise.all(files)));
}
for (const name of job.ktx2 ?? []) await writeFile(join(folder, `${name}.ktx2`), await ktx2(stack, name));
const { model, weights, sampler } = stack;
await writeFile(join(folder, 'baked.json'), JSON.stringify({ model, weights, sampler, stored, levels }));
