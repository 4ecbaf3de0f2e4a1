// Every level of a stack by trained weights: what models/moment_baker.py does. Parts of the finest levels are baked
// beside each other, with the latents that all coarser ones are filtered from; the coarser ones follow.

import { bakedPart } from './part.js';
import { biases } from './network.js';
import { addressed, levelSizes, resampleWeights } from './pixel_filter.js';
import { byWorkers, threadsHere } from './workers.js';

/** @typedef {import('./pixel_filter.js').Wrap} Wrap */
/** @typedef {import('./pixel_filter.js').Image} Image */
/** @typedef {import('./network.js').Lookup} Lookup */
/** @typedef {import('./network.js').Network} Network */
/** @typedef {import('./network.js').Sampler} Sampler */
/** @typedef {import('./part.js').Axis} Axis */
/** @typedef {import('./part.js').Part} Part */
/** @typedef {import('./part.js').Made} Made */
/** @typedef {import('./part.js').Sink & {level: number}} LevelSink */

const FROM_TOP = 3; // levels that are filtered from level 0; each coarser one from box averages so many levels finer
const TRILINEAR = 0.8; // width of the pixel filter above level 0 for trilinear lookups
const BETWEEN = 1 / 60; // what levels are sharper by because lookups lie between them
const FINE = 0.95; // of the time, roughly, that levels take that are filtered from level 0
const WORTH = 1 << 17; // texels that a worker is started for
const MOST_WORKERS = 8; // each encodes some rows of its neighbours again

/**
 * Width of the pixel filter of a level.
 * @param {number} level
 * @param {Sampler} sampler
 */
function widthOf(level, { lookups, bias, frames }) {
    if (!level) return 1;
    if (frames > 1) return TRILINEAR;
    const width = TRILINEAR + (1 - TRILINEAR) * (Math.log2(lookups) / 4);
    return Math.min(Math.max(width * 2 ** (-bias / 2), 0.5), 4);
}

/**
 * a of the filter (-a, 1 + 2 a, -a) that undoes the blur of a bilinear lookup.
 * @param {number} level
 */
const sharpening = (level) => 1 / 12 + BETWEEN - 4 ** -level / 24;

/**
 * Every level of the stack of a material.
 * @param {import('./core.js').Core} core
 * @param {Network} network
 * @param {Image} stored channels of the model that the network reads
 * @param {Lookup} lookup
 * @param {Wrap} wrap
 * @param {number | undefined} threads as many as are of use where it is left out
 * @param {(share: number) => Promise<void>} progress
 * @returns {Promise<Image[]>} stored channels of the model that it makes
 */
export async function networkLevels(core, network, stored, lookup, wrap, threads, progress) {
    const sizes = levelSizes(stored.height, stored.width);
    const last = sizes.length - 1;
    const fine = sinksOf(network, sizes, 1, Math.min(FROM_TOP, last), 0, lookup, wrap);
    if (last > FROM_TOP) fine.push({ source: -1, level: 1, bias: null, ...boxAxes(sizes, 1, wrap) });
    const top = { ...topTaps(lookup.kernel), bias: biases(network, 0, lookup) };
    const part = (/** @type {number} */ k, /** @type {number} */ of) => partOf(network, stored, top, fine, wrap, k, of);
    const most = threads ?? Math.min(threadsHere(), MOST_WORKERS, Math.floor((stored.height * stored.width) / WORTH));
    const shown = (/** @type {number} */ share) => progress(FINE * share);
    const made =
        (await byWorkers(core.module, network, Math.min(most, stored.height), part, shown)) ??
        [await bakedPart(core, network, part(0, 1), shown)];
    const found = fine.map((_, i) => joined(made.map(({ sinks }) => sinks[i])));
    const levels = [joined(made.map((each) => each.top)), ...found.slice(0, Math.min(FROM_TOP, last))];
    if (last > FROM_TOP) {
        const coarse = sinksOf(network, sizes, FROM_TOP + 1, last, 1, lookup, wrap);
        const [height, width] = sizes[1];
        const rest = { stored: null, latents: found[found.length - 1], height, width, begin: 0, end: 0, kept: -1 };
        const unused = { ...top, sharp: top.sharp.slice(0, 1), wrapRows: false, wrapColumns: false };
        const { sinks } = await bakedPart(core, network, { ...rest, ...unused, sinks: coarse }, (share) =>
            progress(FINE + (1 - FINE) * share),
        );
        levels.push(...sinks.filter((_, i) => coarse[i].bias));
    }
    const { channels } = network.made;
    return sizes.map(([height, width], level) => ({ data: levels[level], width, height, channels }));
}

/**
 * Levels `first` to `last`, and the box averages that they are filtered from: those of level `base` are there.
 * @param {Network} network
 * @param {[number, number][]} sizes
 * @param {number} first
 * @param {number} last
 * @param {number} base
 * @param {Lookup} lookup
 * @param {Wrap} wrap
 */
function sinksOf(network, sizes, first, last, base, lookup, wrap) {
    /** @type {LevelSink[]} */
    const sinks = [];
    /** @type {Map<number, number>} The place among the sinks of box averages as fine as a level. */
    const boxes = new Map();
    for (let level = first; level <= last; level++) {
        const finer = Math.max(base, level - FROM_TOP);
        if (finer > base) {
            const source = boxes.get(finer - 1) ?? -1;
            boxes.set(finer, sinks.length);
            sinks.push({ source, level: finer, bias: null, ...boxAxes(sizes, finer, wrap) });
        }
        const axes = bothAxes(sizes[finer], sizes[level], wrap, (from, to, mode) => {
            const found = resampleWeights(from, to, lookup.kernel, mode, widthOf(level, lookup.sampler));
            return sharpened(found, sharpening(level), mode);
        });
        sinks.push({ source: boxes.get(finer) ?? -1, level, bias: biases(network, level, lookup), ...axes });
    }
    return sinks;
}

/**
 * @param {[number, number][]} sizes
 * @param {number} level
 * @param {Wrap} wrap
 */
function boxAxes(sizes, level, wrap) {
    return bothAxes(sizes[level - 1], sizes[level], wrap, (from, to, mode) =>
        plainAxis(resampleWeights(from, to, 'box', mode)),
    );
}

/**
 * Rows and columns; made once where they are the same.
 * @param {[number, number]} from
 * @param {[number, number]} to
 * @param {Wrap} wrap
 * @param {(from: number, to: number, mode: string) => Axis} make
 */
function bothAxes(from, to, wrap, make) {
    const rows = make(from[0], to[0], wrap[1]);
    const same = from[0] === from[1] && to[0] === to[1] && wrap[0] === wrap[1];
    return { rows, columns: same ? rows : make(from[1], to[1], wrap[0]) };
}

/**
 * Part k of so many parts of the levels that are filtered from level 0: some rows of each. Rows that it reads stand in
 * their order, each between its neighbours, so that sums are those of the whole.
 * @param {Network} network
 * @param {Image} stored
 * @param {{sharp: Float32Array, plain: Float32Array, bias: Float32Array}} top
 * @param {LevelSink[]} sinks
 * @param {Wrap} wrap
 * @param {number} k
 * @param {number} count
 * @returns {Part}
 */
function partOf(network, { data, width, height, channels }, top, sinks, wrap, k, count) {
    const own = (/** @type {number} */ n) => [Math.floor((n * k) / count), Math.floor((n * (k + 1)) / count)];
    const around = network.encoder.filter(({ taps }) => taps > 1).length;
    const needed = new Uint8Array(height);
    const need = (/** @type {number} */ row, /** @type {number} */ reach) => {
        for (let y = row - reach; y <= row + reach; y++) needed[addressed(y, height, wrap[1])] = 1;
    };
    const [first, end] = own(height);
    for (let y = first; y < end; y++) need(y, around + (top.sharp.length - 1) / 2);
    const parts = sinks.map((sink) => {
        const { places, sharp, plain, count: n, taps } = sink.rows;
        const [from, to] = own(n).map((row) => row * taps);
        const rows = { places: places.slice(from, to), sharp: sharp.slice(from, to), plain: plain.slice(from, to) };
        for (const place of rows.places) need(place, around);
        return { ...sink, rows: { ...rows, count: (to - from) / taps, taps } };
    });
    const place = new Int32Array(height);
    let rows = 0;
    for (let y = 0; y < height; y++) {
        place[y] = rows;
        rows += needed[y];
    }
    for (const { rows: axis } of parts) axis.places = axis.places.map((row) => place[row]);
    const wide = width * channels;
    const read = count > 1 ? new Float32Array(rows * wide) : data;
    for (let y = 0; count > 1 && y < height; y++) {
        if (needed[y]) read.set(data.subarray(y * wide, (y + 1) * wide), place[y] * wide);
    }
    const [wrapColumns, wrapRows] = wrap.map((mode) => mode === 'wrap');
    const begin = place[first];
    const shape = { height: rows, width, wrapRows, wrapColumns, begin, end: begin + end - first };
    return { stored: read, latents: null, ...shape, ...top, sinks: parts, kept: sinks.findIndex(({ bias }) => !bias) };
}

/**
 * Pieces one after the other.
 * @param {Float32Array[]} pieces
 */
function joined(pieces) {
    if (pieces.length === 1) return pieces[0];
    const out = new Float32Array(pieces.reduce((sum, each) => sum + each.length, 0));
    let at = 0;
    for (const each of pieces) {
        out.set(each, at);
        at += each.length;
    }
    return out;
}

/**
 * Taps of level 0, which are the same for every texel.
 * @param {string} kernel
 */
function topTaps(kernel) {
    const found = resampleWeights(16, 16, kernel, 'wrap');
    const plain = found.weights.slice(0, found.taps);
    const a = sharpening(0);
    const sharp = new Float64Array(plain.length + 2);
    [-a, 1 + 2 * a, -a].forEach((factor, k) => plain.forEach((each, i) => (sharp[i + k] += factor * each)));
    return { sharp: new Float32Array(sharp), plain };
}

/**
 * @param {import('./pixel_filter.js').Taps} found
 * @returns {Axis}
 */
function plainAxis({ index, weights, count, taps }) {
    return { places: index, sharp: weights, plain: weights, count, taps };
}

/**
 * A filter with (-a, 1 + 2 a, -a) after it, in one; an axis of one texel stays as it is. Taps of one texel are one.
 * @param {import('./pixel_filter.js').Taps} found
 * @param {number} a
 * @param {string} wrap
 * @returns {Axis}
 */
function sharpened(found, a, wrap) {
    const { index, weights, count, taps } = found;
    if (count === 1) return plainAxis(found);
    const centre = Math.fround(1 + 2 * a);
    const beside = Math.fround(-a);
    const rows = Array.from({ length: count }, (_, row) => {
        /** @type {Map<number, [number, number]>} */
        const sums = new Map();
        for (const offset of [0, -1, 1]) {
            const other = addressed(row + offset, count, wrap) * taps;
            for (let k = other; k < other + taps; k++) {
                const sum = sums.get(index[k]) ?? [0, 0];
                sum[0] += Math.fround((offset ? beside : centre) * weights[k]);
                if (!offset) sum[1] += weights[k];
                sums.set(index[k], sum);
            }
        }
        return [...sums].sort(([one], [other]) => one - other);
    });
    const wide = Math.max(...rows.map((row) => row.length));
    const places = new Int32Array(count * wide);
    const sharp = new Float32Array(count * wide);
    const plain = new Float32Array(count * wide);
    rows.forEach((row, i) => {
        row.forEach(([place, sums], k) => {
            places[i * wide + k] = place;
            [sharp[i * wide + k], plain[i * wide + k]] = sums;
        });
    });
    return { places, sharp, plain, count, taps: wide };
}
