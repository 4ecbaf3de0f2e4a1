// Signs of anisotropy directions, and less anisotropy where no signs agree: mipbake/material/directions.py says why.

import { addressed } from './pixel_filter.js';

/** @typedef {import('./pixel_filter.js').Image} Image */
/** @typedef {import('./pixel_filter.js').Wrap} Wrap */
/** @typedef {{xy: Float32Array, strength: Float32Array, width: number, height: number}} Lines */

const TOGETHER = 1 << 18; // texels of the finest level whose signs are found together
const LEAST = Math.fround(1e-3); // strength that counts where there is none
const BETWEEN = 2; // what a texel of the next level counts beside a neighbour
const CUT = Math.fround(-0.2); // cosine of neighbours across a cut
const CLEAR = 0.5; // cosine of neighbours that nobody would give other signs
const MIN_ROUGHNESS = 0.045;
const ROUGHNESS = 4; // of the channels of gltf-anisotropic
const DIRECTION = 8;
const STRENGTH = 10;
const f = Math.fround;

/**
 * Levels of gltf-anisotropic with signs that agree, and eased where none do; changes them.
 * @param {Image[]} levels
 * @param {Wrap} wrap
 */
export function agreeing(levels, wrap) {
    const found = signs(
        levels.map((level) => linesOf(level, DIRECTION)),
        wrap,
    );
    levels.forEach((level, i) => turn(level, DIRECTION, found[i]));
    for (const level of levels) ease(level, wrap);
    return levels;
}

/**
 * An image of direction and strength (3 channels) with signs that agree; as it is where neighbours do.
 * @param {Image} image
 * @param {Wrap} wrap
 * @returns {Image}
 */
export function untangled(image, wrap) {
    const first = linesOf(image, 0);
    if (!cutTexels(first, wrap, CLEAR).length) return image;
    const levels = [first];
    for (let last = first; Math.max(last.width, last.height) > 1; levels.push(last)) last = halved(last);
    const out = { ...image, data: image.data.slice() };
    turn(out, 0, signs(levels, wrap)[0]);
    return out;
}

/**
 * @param {Image} level
 * @param {number} at the first channel of the direction, which the strength follows
 * @returns {Lines}
 */
function linesOf({ data, width, height, channels }, at) {
    const xy = new Float32Array(2 * width * height);
    const strength = new Float32Array(width * height);
    for (let i = 0; i < strength.length; i++) {
        xy[2 * i] = data[i * channels + at];
        xy[2 * i + 1] = data[i * channels + at + 1];
        strength[i] = data[i * channels + at + 2];
    }
    return { xy, strength, width, height };
}

/**
 * @param {Image} level
 * @param {number} at
 * @param {Int8Array} sign
 */
function turn({ data, channels }, at, sign) {
    sign.forEach((each, i) => {
        data[i * channels + at] *= each;
        data[i * channels + at + 1] *= each;
    });
}

/**
 * 1 or -1 for every direction, so that neighbours and levels agree wherever the field of lines allows.
 * @param {Lines[]} levels
 * @param {Wrap} wrap
 */
function signs(levels, wrap) {
    const fits = levels.findIndex((level) => level.strength.length <= TOGETHER);
    const first = fits < 0 ? levels.length - 1 : fits;
    const out = tied(levels.slice(first), wrap);
    for (let i = first - 1; i >= 0; i--) out.unshift(following(levels[i], levels[i + 1], out[0], wrap));
    let common = 0;
    levels[0].strength.forEach((each, i) => (common += f(each + LEAST) * out[0][i]));
    if (common < 0) for (const sign of out) sign.forEach((each, i) => (sign[i] = -each));
    return out;
}

/**
 * Signs of fine texels that agree with a coarser level, interpolated at their centres.
 * @param {Lines} fine
 * @param {Lines} coarse
 * @param {Int8Array} sign of the coarser level
 * @param {Wrap} wrap
 */
function following(fine, coarse, sign, wrap) {
    const between = (/** @type {number} */ size, /** @type {number} */ count, /** @type {string} */ mode) =>
        Array.from({ length: size }, (_, i) => {
            const at = ((i + 0.5) * count) / size - 0.5;
            const low = Math.floor(at);
            return { near: addressed(low, count, mode), far: addressed(low + 1, count, mode), weight: f(at - low) };
        });
    const rows = between(fine.height, coarse.height, wrap[1]);
    const columns = between(fine.width, coarse.width, wrap[0]);
    const value = (/** @type {number} */ y, /** @type {number} */ x, /** @type {number} */ c) => {
        const i = y * coarse.width + x;
        return coarse.xy[2 * i + c] * sign[i];
    };
    const out = new Int8Array(fine.strength.length);
    rows.forEach((row, y) =>
        columns.forEach((column, x) => {
            let sum = 0;
            for (let c = 0; c < 2; c++) {
                const [near, far] = [column.near, column.far].map((place) => {
                    const above = value(row.near, place, c);
                    return f(above + f(row.weight * f(value(row.far, place, c) - above)));
                });
                sum += f(f(near + f(column.weight * f(far - near))) * fine.xy[2 * (y * fine.width + x) + c]);
            }
            out[y * fine.width + x] = sum < 0 ? -1 : 1;
        }),
    );
    return out;
}

/**
 * Directions and strengths at half the size: means of vectors of twice the angle.
 * @param {Lines} lines
 * @returns {Lines}
 */
function halved({ xy, strength, width, height }) {
    const [wide, high] = [Math.max(1, width >> 1), Math.max(1, height >> 1)];
    const out = {
        xy: new Float32Array(2 * wide * high),
        strength: new Float32Array(wide * high),
        width: wide,
        height: high,
    };
    const [across, down] = [width > 1 ? 2 : 1, height > 1 ? 2 : 1];
    for (let y = 0; y < high; y++) {
        for (let x = 0; x < wide; x++) {
            let [dx, dy] = [0, 0];
            for (let k = 0; k < across * down; k++) {
                const i = (y * down + Math.floor(k / across)) * width + x * across + (k % across);
                const [vx, vy, s] = [xy[2 * i], xy[2 * i + 1], strength[i]];
                dx += ((vx * vx - vy * vy) * s) / (across * down);
                dy += (2 * vx * vy * s) / (across * down);
            }
            const i = y * wide + x;
            const angle = Math.atan2(dy, dx) / 2;
            out.xy[2 * i] = Math.cos(angle);
            out.xy[2 * i + 1] = Math.sin(angle);
            out.strength[i] = Math.hypot(dx, dy);
        }
    }
    return out;
}

/**
 * Calls back with the indices of every two texels that lie beside each other.
 * @param {{width: number, height: number}} size
 * @param {Wrap} wrap
 * @param {(one: number, other: number) => void} see
 */
function neighbours({ width, height }, wrap, see) {
    for (let y = 0; y < height - 1; y++) for (let x = 0; x < width; x++) see(y * width + x, (y + 1) * width + x);
    if (height > 2 && wrap[1] === 'wrap') for (let x = 0; x < width; x++) see((height - 1) * width + x, x);
    for (let y = 0; y < height; y++) for (let x = 0; x < width - 1; x++) see(y * width + x, y * width + x + 1);
    if (width > 2 && wrap[0] === 'wrap') for (let y = 0; y < height; y++) see((y + 1) * width - 1, y * width);
}

/**
 * Signs of levels that are found together: texels are tied to their neighbours and to the texel of the next level.
 * @param {Lines[]} levels
 * @param {Wrap} wrap
 */
function tied(levels, wrap) {
    const starts = levels.reduce((sums, level) => [...sums, sums[sums.length - 1] + level.strength.length], [0]);
    const most = 3 * starts[levels.length]; // two neighbours and a coarser texel each
    const [a, b, weight] = [new Int32Array(most), new Int32Array(most), new Float64Array(most)];
    let ties = 0;
    const vectors = levels.map(({ xy, strength }) => xy.map((each, i) => f(each * f(strength[i >> 1] + LEAST))));
    levels.forEach((level, i) => {
        const own = vectors[i];
        const tie = (
            /** @type {number} */ one,
            /** @type {Float32Array} */ v,
            /** @type {number} */ other,
            /** @type {number} */ to,
            /** @type {number} */ factor,
        ) => {
            a[ties] = starts[i] + one;
            b[ties] = starts[to] + other;
            weight[ties++] = factor * f(f(own[2 * one] * v[2 * other]) + f(own[2 * one + 1] * v[2 * other + 1]));
        };
        neighbours(level, wrap, (one, other) => tie(one, own, other, i, 1));
        const under = levels[i + 1];
        for (let one = 0; under && one < level.strength.length; one++) {
            const y = Math.floor(((Math.floor(one / level.width) + 0.5) * under.height) / level.height);
            const x = Math.floor((((one % level.width) + 0.5) * under.width) / level.width);
            tie(one, vectors[i + 1], y * under.width + x, i + 1, BETWEEN);
        }
    });
    const sign = agree(starts[levels.length], a.subarray(0, ties), b.subarray(0, ties), weight.subarray(0, ties));
    return levels.map((_, i) => sign.slice(starts[i], starts[i + 1]));
}

/**
 * Signs of nodes tied by edges (a, b), of positive weight where they should be the same. Every group of nodes joins the
 * one that it has the strongest tie with, all at once, until none is left to join.
 * @param {number} count
 * @param {Int32Array} a
 * @param {Int32Array} b
 * @param {Float64Array} weight
 */
function agree(count, a, b, weight) {
    const group = Int32Array.from({ length: count }, (_, i) => i);
    const sign = new Int8Array(count).fill(1);
    const [best, to, turned] = [new Int32Array(count), new Int32Array(count), new Int8Array(count)];
    while (a.length) {
        best.fill(-1);
        for (let edge = 0; edge < a.length; edge++) {
            const size = Math.abs(weight[edge]);
            let node = a[edge];
            if (best[node] < 0 || size >= Math.abs(weight[best[node]])) best[node] = edge; // of equal ones the last
            node = b[edge];
            if (best[node] < 0 || size >= Math.abs(weight[best[node]])) best[node] = edge;
        }
        for (let node = 0; node < count; node++) {
            const edge = best[node];
            to[node] = edge < 0 ? node : a[edge] === node ? b[edge] : a[edge];
            turned[node] = edge >= 0 && weight[edge] < 0 ? -1 : 1;
        }
        // The strongest tie of two groups that merge belongs to both: the lower group stays.
        for (let node = 0; node < count; node++) {
            if (to[to[node]] === node && node < to[node]) [to[node], turned[node]] = [node, 1];
        }
        for (let changed = true; changed;) {
            changed = false;
            for (let node = 0; node < count; node++) {
                const further = to[to[node]];
                if (further === to[node]) continue;
                turned[node] *= turned[to[node]];
                to[node] = further;
                changed = true;
            }
        }
        for (let i = 0; i < count; i++) {
            sign[i] *= turned[group[i]];
            group[i] = to[group[i]];
        }
        [a, b, weight] = merged(count, a, b, weight, to, turned);
    }
    return sign;
}

/**
 * Ties between groups that have merged: between the same two they are one, the sum of all.
 * @param {number} count
 * @param {Int32Array} a
 * @param {Int32Array} b
 * @param {Float64Array} weight
 * @param {Int32Array} to
 * @param {Int8Array} turned
 * @returns {[Int32Array, Int32Array, Float64Array]}
 */
function merged(count, a, b, weight, to, turned) {
    const ends = [new Int32Array(a.length), new Int32Array(a.length)];
    let order = new Int32Array(a.length);
    let apart = 0;
    for (let edge = 0; edge < a.length; edge++) {
        const [one, other] = [to[a[edge]], to[b[edge]]];
        ends[0][edge] = Math.max(one, other);
        ends[1][edge] = Math.min(one, other);
        if (one !== other) order[apart++] = edge;
    }
    order = order.subarray(0, apart);
    for (const end of ends) order = sorted(order, end, count);
    const [high, low] = ends;
    const [firsts, seconds, sums] = [new Int32Array(apart), new Int32Array(apart), new Float64Array(apart)];
    let last = -1;
    for (const edge of order) {
        if (last < 0 || firsts[last] !== low[edge] || seconds[last] !== high[edge]) {
            last++;
            firsts[last] = low[edge];
            seconds[last] = high[edge];
        }
        sums[last] += weight[edge] * turned[a[edge]] * turned[b[edge]];
    }
    return [firsts.subarray(0, last + 1), seconds.subarray(0, last + 1), sums.subarray(0, last + 1)];
}

/**
 * Indices in the order of their keys below `count`; equal ones keep theirs.
 * @param {Int32Array} order
 * @param {Int32Array} key
 * @param {number} count
 */
function sorted(order, key, count) {
    const starts = new Int32Array(count + 1);
    for (const each of order) starts[key[each] + 1]++;
    for (let i = 0; i < count; i++) starts[i + 1] += starts[i];
    const out = new Int32Array(order.length);
    for (const each of order) out[starts[key[each]]++] = each;
    return out;
}

/**
 * Texels one of whose four neighbours has the opposite sign, in their order.
 * @param {Lines} lines
 * @param {Wrap} wrap
 * @param {number} [cosine]
 */
function cutTexels(lines, wrap, cosine = CUT) {
    const { xy } = lines;
    const found = new Uint8Array(lines.strength.length);
    neighbours(lines, wrap, (one, other) => {
        const against = f(f(xy[2 * one] * xy[2 * other]) + f(xy[2 * one + 1] * xy[2 * other + 1])) < cosine;
        if (against) found[one] = found[other] = 1;
    });
    /** @type {number[]} */
    const out = [];
    found.forEach((each, i) => each && out.push(i));
    return out;
}

/** Weights of a texel and its eight neighbours in four lookups, evenly spread over the square around it. */
const LOOKUPS = [-0.25, 0.25].flatMap((v) =>
    [-0.25, 0.25].map((u) => {
        const axis = (/** @type {number} */ p) => [Math.max(-p, 0), 1 - Math.abs(p), Math.max(p, 0)];
        return axis(v).flatMap((row) => axis(u).map((column) => row * column));
    }),
);

/**
 * Takes anisotropy from texels along cuts, as much as lookups around them turn away from what is stored: the logarithm
 * of the ratio of both alphas is multiplied by the share that is left, their product stays.
 * @param {Image} level
 * @param {Wrap} wrap
 */
function ease(level, wrap) {
    const lines = linesOf(level, DIRECTION);
    for (const texel of cutTexels(lines, wrap)) {
        const share = agreement(lines, texel, wrap);
        if (!(share < 1)) continue;
        const at = texel * level.channels;
        const roughness = level.data[at + ROUGHNESS];
        let across = Math.max(roughness, MIN_ROUGHNESS) ** 2;
        let along = across + (1 - across) * level.data[at + STRENGTH] ** 2;
        const middle = Math.log(along * across) / 2;
        const half = (Math.log(along / across) / 2) * share;
        [across, along] = [Math.exp(middle - half), Math.exp(middle + half)];
        level.data[at + ROUGHNESS] = Math.max(Math.sqrt(across), roughness);
        const ratio = (along - across) / Math.max(1 - across, 1e-6);
        level.data[at + STRENGTH] = Math.sqrt(Math.min(Math.max(ratio, 0), 1));
    }
}

/**
 * The share of the anisotropy of a texel that lookups around it leave.
 * @param {Lines} lines
 * @param {number} texel
 * @param {Wrap} wrap
 */
function agreement({ xy, width, height }, texel, wrap) {
    const [row, column] = [Math.floor(texel / width), texel % width];
    const near = [-1, 0, 1].flatMap((dy) =>
        [-1, 0, 1].map((dx) => {
            const y = addressed(row + dy, height, wrap[1]);
            const i = y * width + addressed(column + dx, width, wrap[0]);
            return [xy[2 * i], xy[2 * i + 1]];
        }),
    );
    const own = near[4];
    const turned = near.map(([x, y]) => (own[0] * x + own[1] * y < 0 ? [-x, -y] : [x, y]));
    const doubled = (/** @type {number[]} */ [x, y]) => [x * x - y * y, 2 * x * y];
    const look = (/** @type {number[]} */ weights, /** @type {number[][]} */ some) =>
        [0, 1].map((c) => weights.reduce((sum, each, i) => sum + each * some[i][c], 0));
    const twice = near.map(doubled);
    const sum = (/** @type {number[][]} */ some) =>
        LOOKUPS.reduce((total, weights) => {
            const [meant, seen] = [look(weights, twice), doubled(look(weights, some))];
            return total + (seen[0] * meant[0] + seen[1] * meant[1]) / Math.max(Math.hypot(...seen), 1e-9);
        }, 0);
    const best = sum(turned);
    return best > 1e-3 ? Math.min(Math.max(sum(near) / Math.max(best, 1e-3), 0), 1) : 1;
}
