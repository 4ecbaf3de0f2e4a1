// Colours that a mask hides do not bleed, and what is tested against a cutoff keeps its coverage:
// mipbake/source/opacity.py and mipbake/material/fill.py have the same in Python.

import { clamp } from './models.js';
import { addressed, filteredLevels } from './pixel_filter.js';

/** @typedef {import('./pixel_filter.js').Image} Image */
/** @typedef {import('./pixel_filter.js').Wrap} Wrap */
/** @typedef {import('./core.js').Core} Core */

/**
 * An image whose texels of weight 0 are smooth continuations of the others, which stay bit for bit: pulled to coarser
 * levels, and pushed back (Gortler et al. 1996, The Lumigraph, section 3.4).
 * @param {Image} image
 * @param {Float32Array} weights 0 or 1 for each texel
 * @param {Wrap} wrap
 * @returns {Image}
 */
export function filled(image, weights, wrap) {
    if (!weights.some((each) => each > 0)) return image;
    const data = image.data.map((value, i) => (weights[Math.floor(i / image.channels)] > 0 ? value : 0));
    const levels = [{ image: { ...image, data }, weights }];
    for (let last = levels[0]; last.weights.some((each) => each < 1); levels.push(last)) {
        if (Math.max(last.image.width, last.image.height) === 1) break;
        last = pulled(last.image, last.weights);
    }
    return (
        levels.reduceRight(
            (coarse, { image: finer, weights: share }) => (coarse ? pushed(coarse, finer, share, wrap) : finer),
            /** @type {Image | undefined} */ (undefined),
        ) ?? image
    );
}

/**
 * Weighted averages of 2 x 2 texels, and their weights; sizes are rounded up.
 * @param {Image} image
 * @param {Float32Array} weights
 */
function pulled({ data, width, height, channels }, weights) {
    const [wide, high] = [(width + 1) >> 1, (height + 1) >> 1];
    const out = { data: new Float32Array(wide * high * channels), width: wide, height: high, channels };
    const sums = new Float32Array(wide * high);
    for (let y = 0; y < height; y++) {
        for (let x = 0; x < width; x++) {
            const [from, to] = [y * width + x, (y >> 1) * wide + (x >> 1)];
            sums[to] += weights[from];
            for (let c = 0; c < channels; c++) {
                out.data[to * channels + c] += Math.fround(data[from * channels + c] * weights[from]);
            }
        }
    }
    out.data.forEach((sum, i) => (out.data[i] = sum / Math.max(sums[Math.floor(i / channels)], 1e-37)));
    return { image: out, weights: sums.map((each) => Math.min(each, 1)) };
}

/**
 * A finer image, where its weights are below 1 with a coarser one, interpolated.
 * @param {Image} coarse
 * @param {Image} finer
 * @param {Float32Array} weights
 * @param {Wrap} wrap
 * @returns {Image}
 */
function pushed(coarse, finer, weights, wrap) {
    const { width, height, channels } = finer;
    const data = finer.data.slice();
    const places = (/** @type {number} */ at, /** @type {number} */ count, /** @type {string} */ mode) => [
        at >> 1,
        addressed((at >> 1) + (at % 2 ? 1 : -1), count, mode),
    ];
    for (let i = 0; i < weights.length; i++) {
        if (weights[i] >= 1) continue;
        const [y, otherY] = places(Math.floor(i / width), coarse.height, wrap[1]);
        const [x, otherX] = places(i % width, coarse.width, wrap[0]);
        for (let c = 0; c < channels; c++) {
            const down = (/** @type {number} */ column) => {
                const near = coarse.data[(y * coarse.width + column) * channels + c];
                const far = coarse.data[(otherY * coarse.width + column) * channels + c];
                return Math.fround(near + 0.25 * (far - near));
            };
            const [near, far] = [down(x), down(otherX)];
            const around = near + 0.25 * (far - near);
            data[i * channels + c] = weights[i] * data[i * channels + c] + (1 - weights[i]) * around;
        }
    }
    return { data, width, height, channels };
}

/**
 * Changes the base colours of baked levels as if texels had counted for as much as they cover: every level is
 * multiplied by the ratio of the average that is weighted by opacity to the plain one.
 * @param {Core} core
 * @param {Image[]} levels base colours in their first channels
 * @param {Image} stored of level 0 of the source
 * @param {Float32Array} opacity one for each texel of it
 * @param {string} filter
 * @param {Wrap} wrap
 */
export function cover(core, levels, stored, opacity, filter, wrap) {
    const { width, height } = stored;
    const own = { data: new Float32Array(7 * opacity.length), width, height, channels: 7 };
    opacity.forEach((weight, i) => {
        own.data[7 * i + 6] = weight;
        for (let c = 0; c < 3; c++) {
            own.data[7 * i + c] = stored.data[i * stored.channels + c];
            own.data[7 * i + 3 + c] = own.data[7 * i + c] * weight;
        }
    });
    filteredLevels(core, own, filter, wrap).forEach(({ data }, index) => {
        const { data: colours, channels } = levels[index];
        for (let i = 0; 7 * i < data.length; i++) {
            const covered = data[7 * i + 6];
            for (let c = 0; c < 3; c++) {
                const plain = data[7 * i + c];
                const average = covered > 1e-4 ? data[7 * i + 3 + c] / covered : plain;
                const ratio = plain > 1e-6 ? average / plain : 1;
                colours[i * channels + c] = clamp(colours[i * channels + c] * ratio, 0, 1);
            }
        }
    });
}

/**
 * Levels of an opacity that is tested against a cutoff, scaled so that as much passes as at level 0.
 * @param {Image[]} levels
 * @param {number} cutoff
 * @returns {Image[]}
 */
export function keepingCoverage(levels, cutoff) {
    const passing = levels[0].data.reduce((sum, each) => sum + Number(each >= Math.fround(cutoff)), 0);
    const share = passing / levels[0].data.length;
    return levels.map((level, index) => {
        if (!index) return level;
        const scale = Math.fround(cutoff / Math.max(threshold(level.data, share), 1e-6));
        return { ...level, data: level.data.map((each) => clamp(each * scale, 0, 1)) };
    });
}

/**
 * What the nearest to that share of texels lies above: between two values that occur, or beyond all.
 * @param {Float32Array} values
 * @param {number} share
 */
function threshold(values, share) {
    const sorted = values.slice().sort();
    let best = sorted[0] / 2; // below which all pass
    let least = Math.abs(1 - share);
    for (let i = 0; i < sorted.length; i++) {
        const last = i + 1 === sorted.length;
        if (!last && sorted[i + 1] === sorted[i]) continue;
        const off = Math.abs((sorted.length - i - 1) / sorted.length - share);
        if (off >= least) continue;
        least = off;
        best = last ? sorted[i] + 1e-3 : (sorted[i] + sorted[i + 1]) / 2;
    }
    return best;
}
