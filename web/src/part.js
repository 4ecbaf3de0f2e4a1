// Part of a bake by trained weights, over the core as WebAssembly.

import { packed } from './network.js';

/** @typedef {{places: Int32Array, sharp: Float32Array, plain: Float32Array, count: number, taps: number}} Axis */
/** @typedef {{source: number, rows: Axis, columns: Axis, bias: Float32Array | null}} Sink
 * An image that is filtered from level 0 (source -1) or from an earlier sink. It is decoded where it has biases. */
/** @typedef {{stored: Float32Array | null, latents: Float32Array | null, height: number, width: number,
 *  wrapRows: boolean, wrapColumns: boolean, begin: number, end: number, sharp: Float32Array, plain: Float32Array,
 *  bias: Float32Array, sinks: Sink[], kept: number}} Part
 * NetworkBakeArgs and NetworkPart of csrc/ops/networks.h: rows [begin, end) of level 0 are decoded; `kept` is a sink or -1. */
/** @typedef {{top: Float32Array, sinks: Float32Array[]}} Made
 * Rows of level 0 and of every sink: stored channels where it is decoded, latents where they are kept, else none. */

/**
 * @param {import('./core.js').Core} core
 * @param {import('./network.js').Network} network
 * @param {Part} part
 * @param {(share: number) => Promise<void> | void} progress
 * @returns {Promise<Made>}
 */
export async function bakedPart(core, network, part, progress) {
    const { channels } = network.made;
    const handle = packed(core, network);
    /** @type {number[]} */
    const lent = [];
    const kept = (/** @type {number} */ at) => (lent.push(at), at);
    const put = (/** @type {Float32Array | Int32Array} */ array) => kept(core.put(array));
    const rowFloats = (/** @type {number} */ texels) => core.call('row_floats', handle, texels);
    const room = (/** @type {number} */ floats) => ({ at: kept(core.take(4 * Math.max(1, floats))), floats });

    const top = room((part.end - part.begin) * part.width * channels);
    const outs = part.sinks.map(({ rows, columns, bias }, i) => {
        if (bias) return room(rows.count * columns.count * channels);
        return room(i === part.kept ? rows.count * rowFloats(columns.count) : 0);
    });
    const fields = part.sinks.flatMap(({ source, rows, columns, bias }, i) => {
        const axis = (/** @type {number} */ at, /** @type {Axis} */ { places, sharp, plain, count, taps }) =>
            [put(places), put(sharp), put(plain), count, taps].map((value, k) => [at + 4 * k, value]);
        const decoded = bias ? [outs[i].at, put(bias)] : [0, 0];
        const own = [[0, source], ...axis(4, rows), ...axis(24, columns), [44, decoded[0]], [48, decoded[1]]];
        return own.map(([at, value]) => /** @type {[number, 'int', number]} */ ([52 * i + at, 'int', value]));
    });
    const args = core.structure(56, [
        [0, 'int', part.stored ? put(part.stored) : 0],
        [8, 'int64', part.height],
        [16, 'int64', part.width],
        [24, 'byte', Number(part.wrapRows)],
        [25, 'byte', Number(part.wrapColumns)],
        [28, 'int', put(part.sharp)],
        [32, 'int', put(part.plain)],
        [36, 'int', (part.sharp.length - 1) / 2],
        [40, 'int', put(part.bias)],
        [44, 'int', top.at],
        [48, 'int', kept(core.structure(Math.max(52, 52 * part.sinks.length), fields))],
        [52, 'int', part.sinks.length],
    ]);
    const own = core.structure(32, [
        [0, 'int64', part.begin],
        [8, 'int64', part.end],
        [16, 'int', part.latents ? put(part.latents) : 0],
        [20, 'int', part.kept],
        [24, 'int', part.kept < 0 ? 0 : outs[part.kept].at],
    ]);
    const bake = core.call('bake_begin', handle, args, own);
    for (let done = 0; done < part.height;) {
        done = core.call('bake_advance', bake);
        await progress(done / part.height);
    }
    const [first, ...sinks] = [top, ...outs].map(({ at, floats }) => core.floats(at, floats).slice());
    core.call('bake_end', bake);
    core.call('network_end', handle);
    for (const each of [...lent, args, own]) core.give(each);
    return { top: first, sinks };
}
