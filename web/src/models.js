// Stored channels of the material models, and the way from one to another: mipbake/material has the same in Python.
// Numbers are rounded to 32 bits where rounding shows: glossy materials have an alpha^2 down to 4e-6.

/** @typedef {import('./pixel_filter.js').Image} Image */
/** @typedef {(from: Float32Array, at: number, to: Float32Array, place: number) => void} Texel Converts one texel. */

const f = Math.fround;
const MIN_ROUGHNESS = 0.045;
const DIELECTRIC_F0 = f(0.04);
const TINY = 1.1754943508222875e-38; // the least normal number of 32 bits

/** The least alpha^2 that stacks hold. */
export const LEAST_ALPHA2 = f(MIN_ROUGHNESS ** 4);

/** How many channels a model stores: base colour 3, metallic, roughness, normal 3, and direction 2 with strength. */
export const CHANNELS = { gltf: 8, 'gltf-anisotropic': 11, ggx: 11 };

/** @param {number} x @param {number} low @param {number} high */
export const clamp = (x, low, high) => (x < low ? low : x > high ? high : x);

/** @type {Texel} `gltf` or `gltf-anisotropic` to `ggx`, but for the lobe. */
function reflectances(from, at, to, place) {
    const metallic = from[at + 3];
    for (let c = 0; c < 3; c++) {
        to[place + c] = from[at + c] * f(1 - metallic);
        to[place + 3 + c] = DIELECTRIC_F0 + f(f(from[at + c] - DIELECTRIC_F0) * metallic);
    }
    to[place + 6] = from[at + 5];
    to[place + 7] = from[at + 6];
}

/** @type {Texel} */
function gltfToGgx(from, at, to, place) {
    reflectances(from, at, to, place);
    const alpha = f(Math.max(from[at + 4], MIN_ROUGHNESS) ** 2);
    to[place + 8] = to[place + 9] = 2 * f(Math.log(alpha));
    to[place + 10] = 0;
}

/** @type {Texel} */
function anisotropicToGgx(from, at, to, place) {
    reflectances(from, at, to, place);
    const alpha = f(Math.max(from[at + 4], MIN_ROUGHNESS) ** 2);
    to.set(tensorLog(axesToTensor(alpha, from[at + 10], from[at + 8], from[at + 9])), place + 8);
}

/** @type {Texel} Base colour, metallic and normal from `ggx`. */
function baseOfGgx(from, at, to, place) {
    const mean = (/** @type {number} */ i) => f((from[at + i] + from[at + i + 1] + from[at + i + 2]) / 3);
    const excess = f(mean(3) - DIELECTRIC_F0);
    const b = f(f(mean(0) + mean(3)) - f(2 * DIELECTRIC_F0));
    const root = Math.sqrt(Math.max(b * b + 4 * DIELECTRIC_F0 * excess, 0));
    const shiny = b >= 0 ? (2 * excess) / Math.max(b + root, 1e-12) : (root - b) / (2 * DIELECTRIC_F0);
    const dark = b < 0 ? (-2 * excess) / Math.max(root - b, 1e-12) : 0;
    const metallic = clamp(excess > 0 ? shiny : dark, 0, 1);
    for (let c = 0; c < 3; c++) {
        to[place + c] = clamp(from[at + c] + from[at + 3 + c] - DIELECTRIC_F0 * (1 - metallic), 0, 1);
    }
    to[place + 3] = metallic;
    const scale = Math.max(Math.hypot(from[at + 6], from[at + 7]), 1);
    const [x, y] = [f(from[at + 6] / scale), f(from[at + 7] / scale)];
    to[place + 5] = x;
    to[place + 6] = y;
    to[place + 7] = Math.sqrt(Math.max(f(1 - f(f(x * x) + f(y * y))), 0));
}

/** @type {Texel} */
function ggxToGltf(from, at, to, place) {
    baseOfGgx(from, at, to, place);
    to[place + 4] = clamp(Math.exp(f(from[at + 8] + from[at + 9]) / 8), 0, 1);
}

/** @type {Texel} */
function ggxToAnisotropic(from, at, to, place) {
    baseOfGgx(from, at, to, place);
    putAxes(tensorExp(from[at + 8], from[at + 9], from[at + 10]), to, place);
}

/**
 * Direction, strength and roughness of a tensor, into the channels of `gltf-anisotropic`.
 * @param {number[]} tensor
 * @param {Float32Array} to
 * @param {number} place
 */
export function putAxes([s11, s22, s12], to, place) {
    const mean = f(f(s11 + s22) / 2);
    const d = f(f(s11 - s22) / 2);
    const high = f(mean + f(Math.hypot(d, s12)));
    const low = f(Math.max(f(f(s11 * s22) - f(s12 * s12)), 0) / Math.max(high, TINY));
    const most = f(Math.sqrt(clamp(high, 0, 1)));
    const least = f(Math.sqrt(clamp(low, 0, 1)));
    const angle = Math.atan2(s12, d) / 2;
    to[place + 4] = Math.sqrt(least);
    to[place + 8] = Math.cos(angle);
    to[place + 9] = Math.sin(angle);
    to[place + 10] = Math.sqrt(clamp(f(most - least) / Math.max(f(1 - least), 1e-6), 0, 1));
}

/**
 * S11, S22, S12 of KHR_materials_anisotropy.
 * @param {number} alpha
 * @param {number} strength
 * @param {number} x
 * @param {number} y
 */
function axesToTensor(alpha, strength, x, y) {
    const along = f(f(alpha + f(f(1 - alpha) * f(strength * strength))) ** 2);
    const across = f(alpha * alpha);
    const s11 = f(f(f(along * x) * x) + f(f(across * y) * y));
    const s22 = f(f(f(along * y) * y) + f(f(across * x) * x));
    return [s11, s22, f(f(f(along - across) * x) * y)];
}

/** @param {number} a @param {number} b @param {number} c */
export function tensorExp(a, b, c) {
    const d = f(f(a - b) / 2);
    const q = f(Math.hypot(d, c));
    const sinhc = q > 1e-4 ? Math.sinh(q) / q : 1 + (q * q) / 6;
    const scale = f(Math.exp(f(f(a + b) / 2)));
    const cosh = Math.cosh(q);
    return [f(scale * f(cosh + sinhc * d)), f(scale * f(cosh - sinhc * d)), f(scale * f(sinhc * c))];
}

/** @param {number[]} tensor */
function tensorLog([s11, s22, s12]) {
    const mean = f(f(s11 + s22) / 2);
    const d = f(f(s11 - s22) / 2);
    const radius = f(Math.hypot(d, s12));
    const high = f(mean + radius);
    const low = f(Math.max(f(f(s11 * s22) - f(s12 * s12)), TINY) / high);
    const half = f(f(f(Math.log(high)) - f(Math.log(low))) / 2);
    const slope = radius > f(1e-6 * mean) ? f(half / Math.max(radius, TINY)) : f(1 / mean);
    const m = f(f(f(Math.log(high)) + f(Math.log(low))) / 2);
    return [m + f(slope * d), m - f(slope * d), f(slope * s12)];
}

/** @type {Record<string, Texel>} */
const STEPS = {
    'gltf ggx': gltfToGgx,
    'gltf-anisotropic ggx': anisotropicToGgx,
    'ggx gltf': ggxToGltf,
    'ggx gltf-anisotropic': ggxToAnisotropic,
    'gltf gltf-anisotropic': (from, at, to, place) => {
        for (let c = 0; c < 8; c++) to[place + c] = from[at + c];
        to[place + 8] = 1;
    },
};

/**
 * Stored channels of another model.
 * @param {Image} image
 * @param {string} source
 * @param {string} target
 * @returns {Image}
 */
export function convert(image, source, target) {
    if (source === target) return image;
    const step = STEPS[`${source} ${target}`];
    if (!step) return convert(convert(image, source, 'ggx'), 'ggx', target);
    const channels = CHANNELS[/** @type {keyof typeof CHANNELS} */ (target)];
    const texels = image.width * image.height;
    const data = new Float32Array(texels * channels);
    for (let i = 0; i < texels; i++) step(image.data, i * image.channels, data, i * channels);
    return { data, width: image.width, height: image.height, channels };
}

/**
 * Clips stored channels of `gltf` or `gltf-anisotropic` to their limits and makes vectors unit, in place.
 * @param {Image} image
 */
export function regularise({ data, channels }) {
    for (let at = 0; at < data.length; at += channels) {
        for (let c = 0; c < 5; c++) data[at + c] = clamp(data[at + c], 0, 1);
        unit(data, at + 5, 3, 2);
        if (channels > 8) {
            unit(data, at + 8, 2, 0);
            data[at + 10] = clamp(data[at + 10], 0, 1);
        }
    }
}

/**
 * Makes a vector unit in place; one that has no length becomes an axis.
 * @param {Float32Array} data
 * @param {number} at
 * @param {number} count
 * @param {number} axis
 */
function unit(data, at, count, axis) {
    const length = f(Math.hypot(...data.subarray(at, at + count)));
    for (let c = 0; c < count; c++) {
        data[at + c] = length > 1e-6 ? data[at + c] / length : Number(c === axis);
    }
}
