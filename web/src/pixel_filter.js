// Pixel filters, and resampling with them: mipbake/material/pixel_filter.py has the same numbers.

import { MipbakeError } from './errors.js';

/** @typedef {{index: Int32Array, weights: Float32Array, count: number, taps: number}} Taps
 * What the texels of an axis are summed from: (count, taps) indices in range, and weights. */
/** @typedef {[import('../index.d.ts').Wrap, import('../index.d.ts').Wrap]} Wrap
 * Addressing along u and along v, each "wrap" or "clamp". */
/** @typedef {{data: Float32Array, width: number, height: number, channels: number}} Image */

const STEPS = 8192; // across the support of a filter

/** @param {number} x */
function mitchell(x) {
    x = Math.abs(x);
    if (x < 1) return (7 * x ** 3 - 12 * x ** 2 + 16 / 3) / 6;
    return x < 2 ? ((-7 / 3) * x ** 3 + 12 * x ** 2 - 20 * x + 32 / 3) / 6 : 0;
}

/** @param {number} x */
function blackmanHarris(x) {
    const t = (2 * Math.PI * (x + 2)) / 4;
    return 0.35875 - 0.48829 * Math.cos(t) + 0.14128 * Math.cos(2 * t) - 0.01168 * Math.cos(3 * t);
}

/** @type {Record<string, {radius: number, shape: (x: number) => number, cumulative?: Float64Array}>} */
const KERNELS = {
    gaussian: { radius: 2, shape: (x) => Math.exp(-2 * x * x) },
    box: { radius: 0.5, shape: () => 1 },
    tent: { radius: 1, shape: (x) => 1 - Math.abs(x) },
    mitchell: { radius: 2, shape: mitchell },
    'blackman-harris': { radius: 2, shape: blackmanHarris },
};

/** Names of the pixel filters, in the order that networks know. */
export const FILTERS = Object.keys(KERNELS);

/**
 * Of some names the one that was meant; MipbakeError where there is none.
 * @param {string} what
 * @param {unknown} name
 * @param {string[]} names
 * @returns {string}
 */
export function oneOf(what, name, names) {
    if (typeof name === 'string' && names.includes(name)) return name;
    throw new MipbakeError(`unknown ${what} ${JSON.stringify(name)}: expected ${names.join(', ')}`);
}

/** @param {string} name */
function kernelNamed(name) {
    const kernel = KERNELS[name];
    if (!kernel.cumulative) {
        const sums = new Float64Array(STEPS + 1);
        const at = (/** @type {number} */ i) => kernel.shape(-kernel.radius + (i * 2 * kernel.radius) / STEPS);
        for (let i = 0; i < STEPS; i++) sums[i + 1] = sums[i] + (at(i + 1) + at(i)) / 2;
        kernel.cumulative = sums.map((sum) => sum / sums[STEPS]);
    }
    return { radius: kernel.radius, cumulative: /** @type {Float64Array} */ (kernel.cumulative) };
}

/**
 * (height, width) of every level of a complete chain to 1 x 1.
 * @param {number} height
 * @param {number} width
 * @returns {[number, number][]}
 */
export function levelSizes(height, width) {
    const count = 32 - Math.clz32(Math.max(height, width));
    return Array.from({ length: count }, (_, level) => [Math.max(1, height >> level), Math.max(1, width >> level)]);
}

/**
 * Weights of one axis, from n texels to fewer, any two sizes: texel j weighs the integral of the filter over it, with
 * the filter's unit stretched to `width` output texels.
 * @param {number} from
 * @param {number} to
 * @param {string} filter
 * @param {string} wrap
 * @param {number} [width]
 * @returns {Taps}
 */
export function resampleWeights(from, to, filter, wrap, width = 1) {
    const { radius, cumulative } = kernelNamed(filter);
    const each = from / to;
    const scale = each * width;
    const step = (2 * radius) / STEPS;
    const integral = (/** @type {number} */ x) => {
        if (x <= -radius) return 0;
        if (x >= radius) return 1;
        const place = Math.min(STEPS - 1, Math.floor((x + radius) / step));
        const start = -radius + place * step;
        return ((cumulative[place + 1] - cumulative[place]) / step) * (x - start) + cumulative[place];
    };
    const first = new Int32Array(to);
    let taps = 0;
    for (let i = 0; i < to; i++) {
        const centre = (i + 0.5) * each;
        first[i] = Math.floor(centre - radius * scale + 1e-9);
        taps = Math.max(taps, Math.ceil(centre + radius * scale - 1e-9) - first[i]);
    }
    const index = new Int32Array(to * taps);
    const weights = new Float32Array(to * taps);
    const row = new Float64Array(taps);
    for (let i = 0; i < to; i++) {
        const centre = (i + 0.5) * each;
        let before = integral((first[i] - centre) / scale);
        let sum = 0;
        for (let k = 0; k < taps; k++) {
            const after = integral((first[i] + k + 1 - centre) / scale);
            row[k] = after - before;
            sum += row[k];
            before = after;
            index[i * taps + k] = addressed(first[i] + k, from, wrap);
        }
        for (let k = 0; k < taps; k++) weights[i * taps + k] = row[k] / sum;
    }
    return { index, weights, count: to, taps };
}

/**
 * The texel that stands at an index of an axis.
 * @param {number} at
 * @param {number} size
 * @param {string} wrap
 */
export function addressed(at, size, wrap) {
    if (wrap === 'wrap') return ((at % size) + size) % size;
    return at < 0 ? 0 : at >= size ? size - 1 : at;
}

/**
 * An image at another size, each axis with its taps.
 * @param {import('./core.js').Core} core
 * @param {Image} image
 * @param {Taps} rows
 * @param {Taps} columns
 * @returns {Image}
 */
function resampled(core, image, rows, columns) {
    const { channels } = image;
    const lent = [core.put(image.data)];
    /** @type {[number, 'int' | 'int64', number][]} */
    const fields = [
        [0, 'int', lent[0]],
        [8, 'int64', image.width * channels],
        [16, 'int64', image.width],
        [24, 'int64', channels],
    ];
    for (const [place, axis] of /** @type {[number, Taps][]} */ ([
        [32, rows],
        [56, columns],
    ])) {
        const wide = new Int32Array(2 * axis.index.length); // int64_t, which are never negative
        axis.index.forEach((value, i) => (wide[2 * i] = value));
        const index = core.put(wide);
        const weights = core.put(axis.weights);
        lent.push(index, weights);
        fields.push([place, 'int', index], [place + 4, 'int', weights]);
        fields.push([place + 8, 'int64', axis.count], [place + 16, 'int64', axis.taps]);
    }
    const count = rows.count * columns.count * channels;
    const out = core.take(4 * count);
    const args = core.structure(80, fields);
    core.call('resample', args, out);
    const data = core.floats(out, count).slice();
    for (const each of [...lent, out, args]) core.give(each);
    return { data, width: columns.count, height: rows.count, channels };
}

/**
 * An image at a size (height, width) no larger than its own.
 * @param {import('./core.js').Core} core
 * @param {Image} image
 * @param {[number, number]} size
 * @param {string} filter
 * @param {Wrap} wrap
 */
export function resample(core, image, size, filter, wrap) {
    const rows = resampleWeights(image.height, size[0], filter, wrap[1]);
    return resampled(core, image, rows, resampleWeights(image.width, size[1], filter, wrap[0]));
}

const PRE_REDUCED = 3; // levels between a level and the box averages that it is filtered from

/**
 * Averages of an image under a pixel filter at every level, level 0 included; with `box` level 0 is the image itself.
 * @param {import('./core.js').Core} core
 * @param {Image} image
 * @param {string} filter
 * @param {Wrap} wrap
 * @returns {Image[]}
 */
export function filteredLevels(core, image, filter, wrap) {
    const sizes = levelSizes(image.height, image.width);
    let finer = image;
    return sizes.map((size, level) => {
        if (level > PRE_REDUCED) {
            // Not smaller along a clamped axis: what lies beyond its border is the edge texel of level 0.
            const reduced = sizes[level - PRE_REDUCED];
            const rows = wrap[1] === 'wrap' ? reduced[0] : sizes[0][0];
            finer = resample(core, finer, [rows, wrap[0] === 'wrap' ? reduced[1] : sizes[0][1]], 'box', wrap);
        }
        return level === 0 && filter === 'box' ? image : resample(core, finer, size, filter, wrap);
    });
}
