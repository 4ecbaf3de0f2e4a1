// How an engine looks a stack up: mipbake/material/aim.py has the same in Python.

import { MipbakeError } from './errors.js';

const LOOKUPS = [1, 2, 4, 8, 16];
const FRAMES = [1, 8];
const MOST_BIAS = 4;
const EXPECTED =
    'trilinear, anisotropic, accumulated, "anisotropic 4x", "accumulated, bias -1", or {lookups, bias, frames} with ' +
    `lookups of ${LOOKUPS.join(', ')}, a bias from -${MOST_BIAS} to ${MOST_BIAS} and frames of ${FRAMES.join(' or ')}`;

/**
 * A sampler by its numbers or by what it is called.
 * @param {unknown} given
 * @returns {import('./network.js').Sampler}
 */
export function samplerOf(given) {
    const parts = typeof given === 'string' ? named(given) : given;
    const found = { lookups: 1, bias: 0, frames: 1, .../** @type {any} */ (parts) };
    const { lookups, bias, frames } = found;
    const whole = typeof parts === 'object' && parts !== null && Object.keys(found).length === 3;
    if (!whole || !LOOKUPS.includes(lookups) || !FRAMES.includes(frames) || !(Math.abs(bias) <= MOST_BIAS)) {
        throw new MipbakeError(`unknown sampler ${JSON.stringify(given)}: expected ${EXPECTED}`);
    }
    return { lookups, bias: bias + 0, frames };
}

/** @param {string} name */
function named(name) {
    /** @type {Record<string, number>} */
    const found = {};
    for (const part of name
        .trim()
        .toLowerCase()
        .split(/\s*,\s*/)) {
        const match = /^(?:trilinear|(anisotropic)(?: (\d+)x)?|(accumulated)|bias (-?\d*\.?\d+))$/.exec(part);
        if (!match) return undefined;
        if (match[1]) found.lookups = Number(match[2] ?? 16);
        if (match[3]) found.frames = 8;
        if (match[4]) found.bias = Number(match[4]);
    }
    return found;
}
