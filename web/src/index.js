// Bakes PBR texture sets into MIP maps that keep their look, in browsers, workers and Node.js.

import { CLOSED_FORMS } from './closed_forms.js';
import { Core, packaged } from './core.js';
import { agreeing, untangled } from './directions.js';
import { MipbakeError } from './errors.js';
import { networkLevels } from './levels.js';
import { encoded, MAPS, readMaps } from './maps.js';
import { CHANNELS, convert, regularise } from './models.js';
import { networkNamed } from './network.js';
import { cover, filled, keepingCoverage } from './opacity.js';
import { FILTERS, filteredLevels, oneOf } from './pixel_filter.js';
import { samplerOf } from './sampler.js';
import { ktx2 } from './textures.js';
import { checkThreads } from './workers.js';

export { FILTERS, ktx2, MipbakeError };

/** @typedef {import('./pixel_filter.js').Image} Image */
/** @typedef {import('./pixel_filter.js').Wrap} Wrap */

/** Names of the methods, the default first. */
export const METHODS = ['neural', ...Object.keys(CLOSED_FORMS)];

const PAUSE = 50; // milliseconds after which a bake lets others have a turn

const DEFAULTS = {
    method: 'neural',
    target: 'auto',
    filter: 'gaussian',
    sampler: /** @type {any} */ ('trilinear'),
    wrap: /** @type {any} */ ('wrap'),
    normalConvention: 'opengl',
    alphaCutoff: /** @type {number | undefined} */ (undefined),
    multipleOf: 1,
    threads: /** @type {number | undefined} */ (undefined),
    onProgress: /** @type {((share: number) => void) | undefined} */ (undefined),
    assets: packaged,
};

/** Weights for a target and a source, and the models that they read and make. @type {Record<string, string[]>} */
const WEIGHTS = {
    'gltf of gltf': ['mipbake-3', 'gltf', 'gltf'],
    'gltf of gltf-anisotropic': ['mipbake-3', 'gltf', 'gltf'],
    'gltf-anisotropic of gltf': ['mipbake-3-anisotropic', 'gltf', 'gltf-anisotropic'],
    'gltf-anisotropic of gltf-anisotropic': ['mipbake-3-ggx', 'ggx', 'ggx'],
};

/**
 * Bakes the maps of a material; `index.d.ts` says what the options are and what comes back.
 * @param {Record<string, any>} maps
 * @param {Record<string, any>} [options]
 * @returns {Promise<import('../index.d.ts').Stack>}
 */
export async function bake(maps, options = {}) {
    for (const name of Object.keys(options)) oneOf('option', name, Object.keys(DEFAULTS));
    const given = Object.entries(options).filter(([, value]) => value !== undefined && value !== null);
    /** @type {typeof DEFAULTS} */
    const asked = { ...DEFAULTS, ...Object.fromEntries(given) };
    const method = oneOf('method', asked.method, METHODS);
    const filter = oneOf('filter', asked.filter, FILTERS);
    const chosen = oneOf('target', asked.target, ['auto', 'gltf', 'gltf-anisotropic']);
    const [sampler, wrap, cutoff] = [samplerOf(asked.sampler), wrapOf(asked.wrap), asked.alphaCutoff];
    if (cutoff !== undefined && !(cutoff > 0 && cutoff <= 1)) {
        throw new MipbakeError(`alphaCutoff is ${cutoff}: expected a number above 0 and at most 1`);
    }
    if (!Number.isInteger(asked.multipleOf) || asked.multipleOf < 1) {
        throw new MipbakeError(`multipleOf is ${asked.multipleOf}: expected a whole number of at least 1`);
    }
    checkThreads(asked.threads);
    const material = readMaps(maps, wrap, asked.normalConvention, asked.multipleOf);
    const source = material.shading.anisotropy ? 'gltf-anisotropic' : 'gltf';
    const target = /** @type {import('../index.d.ts').Target} */ (chosen === 'auto' ? source : chosen);
    const progress = turns(asked.onProgress);
    await progress(0);

    const core = await Core.of(asked.assets);
    const opacity = hidden(material);
    const stored = sideBySide(material, opacity, wrap);
    const [weights, read, makes] = method === 'neural' ? WEIGHTS[`${target} of ${source}`] : [null, '', ''];
    let levels;
    if (weights) {
        const network = await networkNamed(asked.assets, weights);
        const lookup = { kernel: filter, sampler };
        const shown = (/** @type {number} */ share) => progress(0.95 * share);
        levels = await networkLevels(core, network, convert(stored, source, read), lookup, wrap, asked.threads, shown);
        if (makes !== target) {
            levels = levels.map((level) => convert(level, makes, target));
            levels.forEach(regularise);
        }
        if (target === 'gltf-anisotropic') agreeing(levels, wrap);
    } else {
        levels = CLOSED_FORMS[method](core, stored, source, target, filter, wrap);
    }
    if (opacity) cover(core, levels, stored, opacity, filter, wrap);

    /** @type {Record<string, Image[]>} */
    const plain = {};
    for (const [role, image] of Object.entries(material.plain)) {
        plain[role] = filteredLevels(core, image, 'box', wrap);
        if (role === 'opacity' && cutoff !== undefined) plain[role] = keepingCoverage(plain[role], cutoff);
    }
    const layouts = material.layouts.filter(({ name }) => name !== 'anisotropy' || target !== 'gltf');
    if (target !== 'gltf' && source === 'gltf') {
        layouts.push({ name: 'anisotropy', pieces: MAPS.anisotropy, top: layouts[0].top, down: false });
    }
    const shown = levels.map((level, index) => {
        const images = { ...rolesOf(level) };
        // Maps that do not shade have chains of their own sizes; the last level stands for those that they lack.
        for (const [role, chain] of Object.entries(plain)) images[role] = chain[Math.min(index, chain.length - 1)];
        return Object.fromEntries(layouts.map((layout) => [layout.name, encoded(layout, images)]));
    });
    await progress(1);
    const normalConvention = /** @type {'opengl' | 'directx'} */ (asked.normalConvention);
    const made = { method, filter, sampler: weights ? sampler : null, weights: weights ?? null };
    const about = { model: target, ...made, wrap, normalConvention };
    return { width: material.width, height: material.height, ...about, levels: shown, stored: levels };
}

/**
 * @param {unknown} given
 * @returns {Wrap}
 */
function wrapOf(given) {
    const [u, v] = Array.isArray(given) && given.length === 2 ? given : [given, given];
    return /** @type {Wrap} */ ([u, v].map((mode) => oneOf('wrap', mode, ['wrap', 'clamp'])));
}

/**
 * Tells the finished share, and from time to time gives way to others.
 * @param {((share: number) => void) | undefined} told
 */
function turns(told) {
    let last = performance.now();
    return async (/** @type {number} */ share) => {
        told?.(share);
        if (performance.now() - last < PAUSE) return;
        await new Promise((resolve) => setTimeout(resolve));
        last = performance.now();
    };
}

/**
 * Opacity at the size of the maps that shade; undefined where nothing is hidden.
 * @param {import('./maps.js').Material} material
 */
function hidden({ plain, width, height }) {
    const { opacity } = plain;
    if (!opacity || opacity.data.every((each) => each >= 1)) return undefined;
    if (opacity.width === width && opacity.height === height) return opacity.data;
    throw new MipbakeError(
        `opacity is ${opacity.width} x ${opacity.height}, the other maps are ${width} x ${height}: expected one size`,
    );
}

/**
 * The maps that shade in one image, what is wholly transparent filled from its surroundings.
 * @param {import('./maps.js').Material} material
 * @param {Float32Array | undefined} opacity
 * @param {Wrap} wrap
 * @returns {Image}
 */
function sideBySide({ shading, width, height }, opacity, wrap) {
    const { baseColor, metallic, roughness, normal, anisotropy } = shading;
    const images = [baseColor, metallic, roughness, normal, ...(anisotropy ? [untangled(anisotropy, wrap)] : [])];
    const channels = CHANNELS[anisotropy ? 'gltf-anisotropic' : 'gltf'];
    const data = new Float32Array(width * height * channels);
    let start = 0;
    for (const image of images) {
        for (let i = 0; i < width * height; i++) {
            for (let c = 0; c < image.channels; c++)
                data[i * channels + start + c] = image.data[i * image.channels + c];
        }
        start += image.channels;
    }
    const whole = { data, width, height, channels };
    if (!opacity) return whole;
    const out = filled(
        whole,
        opacity.map((each) => Number(each > 0)),
        wrap,
    );
    regularise(out);
    return out;
}

/**
 * Stored channels as images of their own, by role.
 * @param {Image} level
 * @returns {Record<string, Image>}
 */
function rolesOf({ data, width, height, channels }) {
    const part = (/** @type {number} */ start) => ({ data: data.subarray(start), width, height, channels });
    const roles = { baseColor: part(0), metallic: part(3), roughness: part(4), normal: part(5) };
    return channels > 8 ? { ...roles, anisotropy: part(8) } : roles;
}
