// `linear` and `lean`: mipbake/baking/rules has the same in Python.

import { agreeing } from './directions.js';
import { CHANNELS, clamp, convert, LEAST_ALPHA2, putAxes, regularise, tensorExp } from './models.js';
import { filteredLevels } from './pixel_filter.js';

/** @typedef {import('./pixel_filter.js').Image} Image */
/** @typedef {import('./pixel_filter.js').Wrap} Wrap */
/** @typedef {import('./core.js').Core} Core */

const f = Math.fround;
const MIN_NORMAL_Z = f(0.02); // slopes reach 50
const AVERAGED = 9; // base colour 3, metallic, slopes 2, moments 3

/** @typedef {(core: Core, stored: Image, source: string, target: string, filter: string, wrap: Wrap) => Image[]} Rule
 * A method that is a rule of averages. */

/** @type {Record<string, Rule>} */
export const CLOSED_FORMS = { linear, lean };

/**
 * Averages of the stored channels of the target.
 * @param {Core} core
 * @param {Image} stored
 * @param {string} source
 * @param {string} target
 * @param {string} filter
 * @param {Wrap} wrap
 */
function linear(core, stored, source, target, filter, wrap) {
    const levels = filteredLevels(core, convert(stored, source, target), filter, wrap);
    if (levels[0].data === stored.data) levels[0] = { ...stored, data: stored.data.slice() };
    levels.forEach(regularise);
    return target === 'gltf' ? levels : agreeing(levels, wrap);
}

/**
 * Averages, with the variance of the slopes added to the roughness (LEAN mapping, Olano and Baker 2010).
 * @param {Core} core
 * @param {Image} stored
 * @param {string} source
 * @param {string} target
 * @param {string} filter
 * @param {Wrap} wrap
 */
function lean(core, stored, source, target, filter, wrap) {
    const texels = stored.width * stored.height;
    const slopes = slopesOf(stored);
    // Moments about the mean slope of the whole map: a tilted map would leave its covariance to cancellation.
    const tilt = [0, 1].map((c) => {
        let sum = 0;
        for (let i = c; i < 2 * texels; i += 2) sum += slopes[i];
        return f(sum / texels);
    });
    const lobes = convert(stored, source, 'ggx').data;
    const colours = convert(stored, source, target);
    const data = new Float32Array(texels * AVERAGED);
    for (let i = 0; i < texels; i++) {
        const at = i * AVERAGED;
        for (let c = 0; c < 4; c++) data[at + c] = colours.data[i * colours.channels + c];
        const [x, y] = tilt.map((each, c) => f(slopes[2 * i + c] - each));
        const tensor = tensorExp(lobes[11 * i + 8], lobes[11 * i + 9], lobes[11 * i + 10]);
        data[at + 4] = x;
        data[at + 5] = y;
        [x * x, y * y, x * y].forEach((square, c) => (data[at + 6 + c] = tensor[c] + 2 * f(square)));
    }
    const { width, height } = stored;
    const channels = CHANNELS[/** @type {keyof typeof CHANNELS} */ (target)];
    const levels = filteredLevels(core, { data, width, height, channels: AVERAGED }, filter, wrap).map((each) =>
        written(each, tilt, channels),
    );
    return target === 'gltf' ? levels : agreeing(levels, wrap);
}

/**
 * Slopes of the normals, two for each texel.
 * @param {Image} stored
 */
function slopesOf({ data, width, height, channels }) {
    const out = new Float32Array(2 * width * height);
    for (let i = 0; i < width * height; i++) {
        const at = i * channels + 5;
        const length = f(Math.hypot(data[at], data[at + 1], data[at + 2]));
        const [x, y, z] = length > 1e-6 ? [0, 1, 2].map((c) => f(data[at + c] / length)) : [0, 0, 1];
        out[2 * i] = x / Math.max(z, MIN_NORMAL_Z);
        out[2 * i + 1] = y / Math.max(z, MIN_NORMAL_Z);
    }
    return out;
}

/**
 * Stored channels from averages.
 * @param {Image} averages
 * @param {number[]} tilt
 * @param {number} channels
 * @returns {Image}
 */
function written({ data, width, height }, tilt, channels) {
    const out = { data: new Float32Array(width * height * channels), width, height, channels };
    for (let i = 0; i < width * height; i++) {
        const [at, to] = [i * AVERAGED, i * channels];
        const [x, y] = [data[at + 4], data[at + 5]];
        for (let c = 0; c < 4; c++) out.data[to + c] = data[at + c];
        const spread = [x * x, y * y, x * y].map((square, c) => f(data[at + 6 + c] - 2 * f(square)));
        // Averages are positive definite in exact arithmetic, not after rounding.
        const [s11, s22] = spread.slice(0, 2).map((each) => Math.max(each, LEAST_ALPHA2));
        const half = f(LEAST_ALPHA2 / 2);
        const limit = f(Math.sqrt(f(f(s11 - half) * f(s22 - half))));
        if (channels === 8) out.data[to + 4] = Math.sqrt(f(Math.sqrt(f(f(s11 + s22) / 2))));
        else putAxes([s11, s22, clamp(spread[2], -limit, limit)], out.data, to);
        const normal = [f(x + tilt[0]), f(y + tilt[1]), 1];
        const length = f(Math.hypot(...normal));
        normal.forEach((each, c) => (out.data[to + 5 + c] = each / length));
    }
    regularise(out);
    return out;
}
