// Maps of a stack as KTX2 textures: blocks are chosen by what errors of texels count in what is shaded.
// mipbake/stack/block_weights.py and mipbake/stack/gltf/ranges.py have the same in Python.

import { Core, packaged } from './core.js';
import { MipbakeError } from './errors.js';
import { ktx2File } from './ktx2.js';
import { fileValue, MAPS } from './maps.js';
import { clamp } from './models.js';
import { oneOf } from './pixel_filter.js';

/** @typedef {import('./pixel_filter.js').Image} Image */
/** @typedef {import('../index.d.ts').Stack} Stack */
/** @typedef {{normal: number, roughness: number}} Ranges What a material multiplies the values of its textures by. */

/** First of the stored channels of a map that shades. @type {Record<string, number>} */
const STORED = { baseColor: 0, metallic: 3, roughness: 4, normal: 5, anisotropy: 8 };
const MIN_ROUGHNESS = 0.045;
const F0 = 0.04;
const LEAST_ALONG = 0.1; // of the weight across a normal, along it: its length still counts when it is averaged
const ROWS = 64; // whose blocks are made together
const PLAIN = { normal: 1, roughness: 1 };
const f = Math.fround;

/**
 * Ranges with which eight bits are used well: nearly all slopes of the normals lie within their scale, and the highest
 * roughness becomes 1.
 * @param {Stack} stack
 * @returns {Ranges}
 */
export function rangesOf({ stored }) {
    const some = stored.slice(0, 2);
    const slopes = new Float32Array(some.reduce((sum, { width, height }) => sum + 2 * width * height, 0));
    let count = 0;
    for (const { data, channels } of some) {
        for (let at = 5; at < data.length; at += channels) {
            const z = Math.max(data[at + 2], f(0.05));
            slopes[count++] = Math.abs(data[at] / z);
            slopes[count++] = Math.abs(data[at + 1] / z);
        }
    }
    slopes.sort();
    const place = 0.97 * (count - 1);
    const low = slopes[Math.floor(place)];
    const scale = low + (place % 1) * (slopes[Math.ceil(place)] - low);
    let highest = 0;
    for (const { data, channels } of stored) {
        for (let at = 4; at < data.length; at += channels) highest = Math.max(highest, data[at]);
    }
    const short = (/** @type {number} */ value) => Math.round(value * 1e6) / 1e6;
    return {
        normal: short(Math.min(1, Math.max(1 / 64, scale))),
        roughness: Math.min(1, Math.max(1 / 255, short(highest + 5e-7))),
    };
}

/**
 * A map of a stack as a KTX2 file.
 * @param {Stack} stack
 * @param {string} name
 * @param {import('../index.d.ts').Ktx2Options & {ranges?: Ranges}} [options]
 */
export async function ktx2(stack, name, { texels = 'uastc', ranges = PLAIN, onProgress, assets = packaged } = {}) {
    const chain = stack.levels.map((level) => level[name]);
    if (!chain[0]) {
        throw new MipbakeError(`the stack has no map ${name}: expected ${Object.keys(stack.levels[0]).join(', ')}`);
    }
    oneOf('kind of texels', texels, ['uastc', 'rgba8']);
    const { width, height, channels } = chain[0];
    const pieces = MAPS[name].slice(0, channels);
    const srgb = pieces[0].encoding === 'colour';
    const count = 32 - Math.clz32(Math.max(width, height)); // a map of fewer levels has its last one in their place
    const core = await Core.of(assets);
    const levels = [];
    for (let level = 0; level < Math.min(count, chain.length); level++) {
        const values = fileValues(stack, name, level, ranges);
        if (texels === 'rgba8') {
            levels.push(Uint8Array.from(values, (value) => Math.floor(clamp(value, 0, 1) * 255 + 0.5)));
        } else {
            const shades = pieces.some(({ role }) => role in STORED);
            const weights = shades ? weightsOf(stack.stored[level], pieces, srgb, ranges) : undefined;
            levels.push(await blocksOf(core, values, weights, chain[level]));
        }
        onProgress?.((level + 1) / count);
    }
    const { method, filter, sampler, weights, wrap } = stack;
    const made = JSON.stringify({ method, pixel_filter: filter, weights, sampler, wrap });
    return ktx2File(levels, { width, height, texels, channels, srgb }, { mipbake: made });
}

/**
 * What a file holds at a level, four numbers from 0 to 1 for each texel: grey fills all colours, a missing alpha is 1.
 * @param {Stack} stack
 * @param {string} name
 * @param {number} level
 * @param {Ranges} ranges
 */
function fileValues(stack, name, level, ranges) {
    const map = stack.levels[level][name];
    const stored = stack.stored[level];
    const top = map.data instanceof Float32Array ? 0 : map.data instanceof Uint16Array ? 65535 : 255;
    const texels = map.width * map.height;
    const out = new Float32Array(4 * texels).fill(1);
    const down = name === 'normal' && stack.normalConvention === 'directx' ? -1 : 1;
    MAPS[name].slice(0, map.channels).forEach(({ role, index, encoding }, place) => {
        const own = role in STORED;
        for (let i = 0; i < texels; i++) {
            const held = map.data[i * map.channels + place];
            let value = own ? stored.data[i * stored.channels + STORED[role] + index] : held / (top || 1);
            if (role === 'roughness') value = f(value / ranges.roughness);
            if (role === 'normal') value = (index === 1 ? down : 1) * stretched(stored, i, index, ranges.normal);
            out[4 * i + place] = clamp(own || !top ? fileValue(value, encoding) : value, 0, 1);
        }
    });
    if (map.channels === 1) {
        for (let at = 0; at < out.length; at += 4) out[at + 1] = out[at + 2] = out[at];
    }
    return out;
}

/**
 * A component of the unit vector along (x / scale, y / scale, z).
 * @param {Image} stored
 * @param {number} texel
 * @param {number} index
 * @param {number} scale
 */
function stretched({ data, channels }, texel, index, scale) {
    const at = texel * channels + STORED.normal;
    if (scale === 1) return data[at + index];
    const [x, y, z] = [data[at] / scale, data[at + 1] / scale, data[at + 2]];
    return [x, y, z][index] / Math.max(Math.hypot(x, y, z), 1e-37);
}

/**
 * Blocks of a level, some rows at a time.
 * @param {Core} core
 * @param {Float32Array} values
 * @param {Float32Array | undefined} weights
 * @param {{width: number, height: number}} size
 */
async function blocksOf(core, values, weights, { width, height }) {
    const out = new Uint8Array(16 * Math.ceil(width / 4) * Math.ceil(height / 4));
    for (let y = 0, at = 0; y < height; y += ROWS) {
        const rows = Math.min(ROWS, height - y);
        const part = [4 * y * width, 4 * (y + rows) * width];
        const lent = [values, ...(weights ? [weights] : [])].map((each) => core.put(each.subarray(...part)));
        const size = 16 * Math.ceil(width / 4) * Math.ceil(rows / 4);
        const blocks = core.take(size);
        const args = core.structure(32, [
            [0, 'int', 6], // BlockFormat::uastc
            [8, 'int64', rows],
            [16, 'int64', width],
            [24, 'int', lent[0]],
            [28, 'int', lent[1] ?? 0],
        ]);
        core.call('encode_blocks', args, blocks);
        out.set(core.bytes(blocks, size), at);
        at += size;
        for (const each of [...lent, blocks, args]) core.give(each);
        await new Promise((resolve) => setTimeout(resolve));
    }
    return out;
}

/**
 * What a squared error of each of four channels counts, for the texels of a level.
 * @param {Image} stored
 * @param {import('./maps.js').Piece[]} pieces
 * @param {boolean} srgb
 * @param {Ranges} ranges
 */
function weightsOf(stored, pieces, srgb, ranges) {
    const { data, channels } = stored;
    const texels = data.length / channels;
    const out = new Float32Array(4 * texels);
    for (let i = 0; i < texels; i++) {
        const at = i * channels;
        const energy = energies(data, at, channels);
        let shared = 0; // channels that share a block count alike, but for those of normals
        for (const { role, index } of pieces) {
            if (role === 'normal') continue;
            let counts = role === 'occlusion' ? energy.diffuse : (energy.diffuse + energy.lobe) / 2; // of an opacity
            if (role === 'baseColor') counts = energy.tint * (srgb ? slope(data[at + index]) ** 2 : 1);
            if (role === 'metallic') counts = energy.metal;
            if (role === 'roughness') counts = energy.roughness * ranges.roughness ** 2;
            if (role === 'anisotropy') counts = index < 2 ? 4 * energy.direction : energy.strength;
            shared = Math.max(shared, counts);
        }
        for (let c = 0; c < 3; c++) {
            const { role, index } = pieces[Math.min(c, pieces.length - 1)];
            if (role !== 'normal') out[4 * i + c] = shared;
            else {
                // Of vectors that a factor makes flatter, the short ones count less where texels are averaged.
                const flat = ranges.normal ** 2;
                const across = (1 - data[at + 5 + index] ** 2) * (index < 2 ? flat : 1);
                out[4 * i + c] = 4 * energy.normal * Math.max(across, LEAST_ALONG * flat);
            }
        }
        out[4 * i + 3] = pieces.length > 3 ? shared : 1; // else nobody asks what alpha is
    }
    return out;
}

/**
 * What a small squared error of each stored channel counts in the squared error of what is shaded: the energy of a lobe
 * of the reflectance F and the area A is F^2 / A, that of diffuse light albedo^2 / pi^2.
 * @param {Float32Array} data
 * @param {number} at
 * @param {number} channels
 */
function energies(data, at, channels) {
    const metallic = data[at + 3];
    const alpha = Math.max(data[at + 4], MIN_ROUGHNESS) ** 2;
    const strength = channels > 8 ? data[at + 10] : 0;
    const along = alpha + (1 - alpha) * strength ** 2;
    const area = alpha * along;
    let [specular, base, apart] = [0, 0, 0]; // mean squares
    for (let c = 0; c < 3; c++) {
        const colour = data[at + c];
        specular += (F0 + (colour - F0) * metallic) ** 2 / 3;
        base += colour ** 2 / 3;
        apart += (colour - F0) ** 2 / 3;
    }
    const lobe = specular / area;
    const matte = base / Math.PI ** 2;
    const diffuse = matte * (1 - metallic) ** 2;
    return {
        lobe,
        diffuse,
        tint: (metallic ** 2 / area + (1 - metallic) ** 2 / Math.PI ** 2) / 3,
        metal: apart / area + matte,
        roughness: (16 * lobe) / alpha,
        normal: lobe / area + diffuse / 2,
        direction: lobe * (along / alpha - 1) ** 2,
        strength: lobe * ((2 * strength * (1 - alpha)) / along) ** 2,
    };
}

/**
 * Derivative of the decoding of sRGB where it gives a value.
 * @param {number} linear
 */
function slope(linear) {
    return linear <= 0.0031308 ? 1 / 12.92 : (2.4 / 1.055) * linear ** (1 - 1 / 2.4);
}
