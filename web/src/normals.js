// Normal maps: from what is stored to unit vectors, and their holes. mipbake/source/normal.py says why.

import { MipbakeError } from './errors.js';

const f = Math.fround;
const MIN_Z = f(0.02); // least height that is believed
const NO_LENGTH = f(0.02); // length below which a direction is the rounding of 8 bits

/**
 * Unit vectors, three for each texel, from stored components of -1 to 1.
 * @param {(texel: number, channel: number) => number} component
 * @param {number} width
 * @param {number} height
 * @param {number} channels 2, or 3 and more
 */
export function decodedNormals(component, width, height, channels) {
    const texels = width * height;
    const flat = channels === 2 || hasConstantBlue(component, texels);
    const out = new Float32Array(3 * texels);
    const broken = new Uint8Array(texels);
    let [holes, upward] = [0, 0];
    for (let i = 0; i < texels; i++) {
        let [x, y] = [component(i, 0), component(i, 1)];
        let z;
        let length = 1;
        if (flat) {
            const squared = f(f(x * x) + f(y * y));
            z = f(Math.sqrt(Math.max(f(1 - squared), 0)));
            const over = f(Math.sqrt(Math.max(squared, 1)));
            [x, y] = [x / over, y / over];
        } else {
            z = component(i, 2);
            length = f(Math.sqrt(f(f(f(x * x) + f(y * y)) + f(z * z))));
            const by = Math.max(length, f(1e-3));
            [x, y, z] = length < 1e-3 ? [0, 0, 1] : [x / by, y / by, z / by];
        }
        upward += Number(z > 0);
        out[3 * i] = x;
        out[3 * i + 1] = y;
        out[3 * i + 2] = z;
        if (out[3 * i + 2] < MIN_Z || Math.min(length, 1) < NO_LENGTH) holes += broken[i] = 1;
    }
    if (upward < 0.95 * texels) {
        throw new MipbakeError(
            'normal does not look like a normal map: expected tangent-space normals, (0.5, 0.5, 1) where the surface ' +
                'is flat; is it a colour or a height map?',
        );
    }
    if (holes) fillHoles(out, broken, width, height);
    return out;
}

/**
 * Blue the same everywhere while red or green vary: what two-channel formats decode to.
 * @param {(texel: number, channel: number) => number} component
 * @param {number} texels
 */
function hasConstantBlue(component, texels) {
    const blue = component(0, 2);
    if (![-1, 0, 1].includes(blue)) return false;
    let varies = false;
    for (let i = 0; i < texels; i++) {
        if (component(i, 2) !== blue) return false;
        varies ||= component(i, 0) !== component(0, 0) || component(i, 1) !== component(0, 1);
    }
    return varies;
}

/**
 * Gives broken texels the mean of their neighbours that are not, from the rims of holes inwards.
 * @param {Float32Array} normals
 * @param {Uint8Array} broken
 * @param {number} width
 * @param {number} height
 */
function fillHoles(normals, broken, width, height) {
    /** @type {number[]} */
    let left = [];
    broken.forEach((each, i) => each && left.push(i));
    if (left.length === broken.length) {
        for (const i of left) normals.set([0, 0, 1], 3 * i);
        return;
    }
    while (left.length) {
        /** @type {[number, number[]][]} */
        const found = [];
        for (const i of left) {
            const sum = [0, 0, 0];
            let seen = false;
            for (let dy = -1; dy <= 1; dy++) {
                for (let dx = -1; dx <= 1; dx++) {
                    const [y, x] = [Math.floor(i / width) + dy, (i % width) + dx];
                    if (y < 0 || y >= height || x < 0 || x >= width || broken[y * width + x]) continue;
                    for (let c = 0; c < 3; c++) sum[c] = f(sum[c] + normals[3 * (y * width + x) + c]);
                    seen = true;
                }
            }
            if (seen) found.push([i, sum]);
        }
        for (const [i, sum] of found) {
            const length = Math.hypot(...sum);
            normals.set(length < 1e-3 ? [0, 0, 1] : sum.map((each) => each / length), 3 * i);
            broken[i] = 0;
        }
        left = left.filter((i) => broken[i]);
    }
}
