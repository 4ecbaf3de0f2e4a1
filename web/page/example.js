// A small material that is made here: lacquered leather. Its shine comes from facets that plain MIP maps flatten.
import { png } from './images.js';

const CELLS = 40;  // along a side

/** @returns {Promise<import('./intake.js').Source[]>} files as if they had been dropped */
export async function example(size = 512) {
    const random = randomFrom(7), points = Array.from({ length: CELLS * CELLS }, () => [random(), random(), random()]);
    const height = new Float32Array(size * size), tone = new Float32Array(size * size);
    for (let y = 0; y < size; ++y) {
        for (let x = 0; x < size; ++x) {
            const [nearest, second, own] = cell((CELLS * x) / size, (CELLS * y) / size, points);
            height[y * size + x] = (3.2 * size) / 512 * Math.sqrt(Math.min(second - nearest, 0.5));  // domes, with creases between
            tone[y * size + x] = own;
        }
    }
    const map = (channels) => ({ data: new Uint8Array(channels * size * size), width: size, height: size, channels });
    const maps = { color: map(3), normal_gl: map(3), roughness: map(1) };
    for (let y = 0; y < size; ++y) {
        for (let x = 0; x < size; ++x) {
            const at = y * size + x, beside = (dx, dy) => height[((y + dy + size) % size) * size + ((x + dx + size) % size)];
            const n = [beside(-1, 0) - beside(1, 0), beside(0, 1) - beside(0, -1), 2], length = Math.hypot(...n), worn = height[at] / 2.3;
            [92, 24, 20].forEach((value, c) => { maps.color.data[3 * at + c] = value * (0.6 + 0.3 * worn + 0.15 * tone[at]); });
            n.forEach((value, c) => { maps.normal_gl.data[3 * at + c] = Math.round(127.5 + (127.5 * value) / length); });
            maps.roughness.data[at] = 62 + 14 * tone[at];
        }
    }
    return Promise.all(Object.entries(maps).map(async ([name, texels]) => {
        const bytes = await png(texels);
        return { name: `lacquered_leather/lacquered_leather_${name}.png`, blob: async () => new Blob([bytes], { type: 'image/png' }) };
    }));
}

/** Distances to the nearest and the second point of cells that repeat, and the third number of the nearest. */
function cell(x, y, points) {
    let [nearest, second, own] = [9, 9, 0];
    for (let row = Math.floor(y) - 1; row <= y + 1; ++row) {
        for (let column = Math.floor(x) - 1; column <= x + 1; ++column) {
            const [px, py, tone] = points[((row + CELLS) % CELLS) * CELLS + ((column + CELLS) % CELLS)];
            const distance = Math.hypot(column + px - x, row + py - y);
            if (distance < nearest) [nearest, second, own] = [distance, nearest, tone];
            else if (distance < second) second = distance;
        }
    }
    return [nearest, second, own];
}

/** Numbers from 0 to 1 that are the same every time: a linear congruential generator. */
function randomFrom(seed) {
    return () => {
        seed = (Math.imul(seed, 1664525) + 1013904223) >>> 0;
        return seed / 2 ** 32;
    };
}
