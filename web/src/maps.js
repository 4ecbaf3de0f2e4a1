// Maps as files and canvases hold them to numbers that are filtered, and back.

import { untangled } from './directions.js';
import { MipbakeError } from './errors.js';
import { clamp } from './models.js';
import { decodedNormals } from './normals.js';
import { oneOf, addressed } from './pixel_filter.js';
import { toByte, toEncoded, toLinear } from './srgb.js';

/** @typedef {import('./pixel_filter.js').Image} Image */
/** @typedef {import('./pixel_filter.js').Wrap} Wrap */
/** @typedef {Uint8Array | Uint8ClampedArray | Uint16Array | Float32Array} Texels */
/** @typedef {{data: Texels, width: number, height: number, channels?: number}} GivenMap */
/** @typedef {import('../index.d.ts').LevelMap} StoredMap */

const f = Math.fround;
const UP_TO = 65536; // texels along a side

/** @typedef {{role: string, index: number, encoding: 'colour' | 'unit' | 'signed'}} Piece */
const colours = (/** @type {string} */ role) =>
    [0, 1, 2].map((index) => /** @type {Piece} */ ({ role, index, encoding: 'colour' }));
const one = (/** @type {string} */ role) => /** @type {Piece} */ ({ role, index: 0, encoding: 'unit' });
const signed = (/** @type {string} */ role, /** @type {number} */ count) =>
    Array.from({ length: count }, (_, index) => /** @type {Piece} */ ({ role, index, encoding: 'signed' }));

/** What the channels of every map hold. @type {Record<string, Piece[]>} */
export const MAPS = {
    baseColor: [...colours('baseColor'), one('opacity')],
    normal: signed('normal', 3),
    roughness: [one('roughness')],
    metallic: [one('metallic')],
    orm: [one('occlusion'), one('roughness'), one('metallic')],
    anisotropy: [...signed('anisotropy', 2), { role: 'anisotropy', index: 2, encoding: 'unit' }],
    occlusion: [one('occlusion')],
    emissive: colours('emissive'),
    height: [one('height')],
    opacity: [one('opacity')],
};
const PLAIN = ['occlusion', 'emissive', 'height', 'opacity'];

/** Values of maps that may be left out. @type {Record<string, number[]>} */
const DEFAULTS = { baseColor: [0.5, 0.5, 0.5], normal: [0, 0, 1], metallic: [0] };

/** @param {Texels} data 0 for floating-point numbers */
const topOf = (data) => (data instanceof Float32Array ? 0 : data instanceof Uint16Array ? 65535 : 255);

/** @type {Map<string, Float32Array>} */
const tables = new Map();

/**
 * What integers of files stand for.
 * @param {number} top
 * @param {Piece['encoding']} encoding
 */
function tableOf(top, encoding) {
    const key = `${encoding} ${top}`;
    const scale = f(1 / top);
    const value = (/** @type {number} */ i) =>
        encoding === 'colour' ? toLinear(i / top) : encoding === 'unit' ? i * scale : f(f(i * scale) * 2) - 1;
    const known = tables.get(key) ?? Float32Array.from({ length: top + 1 }, (_, i) => value(i));
    tables.set(key, known);
    return known;
}

/**
 * A map with its channels counted; MipbakeError where it is none.
 * @param {string} name
 * @param {unknown} given
 * @returns {StoredMap}
 */
function checked(name, given) {
    const { data, width, height, channels } = /** @type {GivenMap} */ (given ?? {});
    const known = [Uint8Array, Uint8ClampedArray, Uint16Array, Float32Array].some((kind) => data instanceof kind);
    if (!known) {
        throw new MipbakeError(
            `${name} has no data of a known kind: expected {data, width, height} with a Uint8Array, Uint16Array or ` +
                'Float32Array',
        );
    }
    for (const side of [width, height]) {
        if (!Number.isInteger(side) || side < 1 || side > UP_TO) {
            throw new MipbakeError(`${name} is ${width} x ${height}: expected whole numbers from 1 to ${UP_TO}`);
        }
    }
    const found = channels ?? data.length / (width * height);
    if (![1, 2, 3, 4].includes(found) || data.length !== width * height * found) {
        throw new MipbakeError(
            `${name} holds ${data.length} numbers for ${width} x ${height} texels` +
                `${channels ? ` of ${channels} channels` : ''}: expected 1 to 4 for each texel`,
        );
    }
    if (data instanceof Float32Array && !data.every(Number.isFinite)) {
        throw new MipbakeError(`${name} holds NaN or infinite values: expected none`);
    }
    const clamped = data instanceof Uint8ClampedArray;
    const own = clamped ? new Uint8Array(data.buffer, data.byteOffset, data.length) : data;
    return { data: own, width, height, channels: found };
}

/**
 * Some channels of a map as numbers, linear; vectors unit.
 * @param {string} name of the map
 * @param {StoredMap} map
 * @param {string} role
 * @param {number[]} places its channels in the map
 * @param {boolean} down whether green of normals points down
 * @returns {Image}
 */
function decoded(name, map, role, places, down) {
    const { data, width, height, channels } = map;
    const texels = width * height;
    const top = topOf(data);
    const [units, vectors] = top ? [tableOf(top, 'unit'), tableOf(top, 'signed')] : [];
    const stored = (/** @type {number} */ i, /** @type {number} */ c) => data[i * channels + places[c]];
    const unit = (/** @type {number} */ i, /** @type {number} */ c) => (units ? units[stored(i, c)] : stored(i, c));
    const vector = (/** @type {number} */ i, /** @type {number} */ c) =>
        vectors ? vectors[stored(i, c)] : stored(i, c);
    if (role === 'normal') {
        if (channels < 2) {
            throw new MipbakeError(`${name} has one channel: expected a normal map with red, green and blue`);
        }
        if (!top) checkSigned(name, map);
        const out = decodedNormals(vector, width, height, channels);
        if (down) for (let i = 1; i < out.length; i += 3) out[i] = -out[i];
        return { data: out, width, height, channels: 3 };
    }
    if (role === 'anisotropy') {
        const out = new Float32Array(3 * texels);
        const grey = channels < 3 || (top > 0 && isGrey(map, top));
        for (let i = 0; i < texels; i++) {
            const [x, y] = grey ? [1, 0] : [vector(i, 0), vector(i, 1)];
            const length = Math.hypot(x, y);
            out.set(length > 0.02 ? [x / length, y / length] : [1, 0], 3 * i);
            out[3 * i + 2] = clamp(unit(i, grey ? 0 : 2), 0, 1);
        }
        return { data: out, width, height, channels: 3 };
    }
    const count = MAPS[role].filter((piece) => piece.role === role).length;
    const table = top ? tableOf(top, MAPS[role][0].encoding) : undefined;
    const out = new Float32Array(count * texels);
    for (let c = 0; c < count; c++) {
        let at = places[c] ?? places[0]; // grey fills all colours
        for (let to = c; to < out.length; to += count, at += channels) out[to] = table ? table[data[at]] : data[at];
    }
    if (!top && role !== 'height') checkRange(name, out, role === 'emissive' ? Infinity : 1);
    return { data: out, width, height, channels: count };
}

/** @param {string} name @param {Float32Array} values @param {number} most */
function checkRange(name, values, most) {
    const found = values.find((value) => !(value >= 0 && value <= most));
    if (found === undefined) return;
    const range = most === Infinity ? 'values of at least 0' : 'values from 0 to 1';
    throw new MipbakeError(`${name} holds ${found}: expected linear ${range} in a Float32Array`);
}

/** @param {string} name @param {StoredMap} map */
function checkSigned(name, { data, channels }) {
    let [sum, least] = [0, Infinity];
    for (let i = 0; i < data.length; i += channels) {
        const vector = data.subarray(i, i + Math.min(channels, 3));
        sum += Math.hypot(...vector);
        least = Math.min(least, ...vector);
    }
    if (least >= 0 && sum > (1.1 * data.length) / channels) {
        throw new MipbakeError(
            `${name} is encoded in 0 to 1, as files store it: expected signed vectors in a Float32Array, pass ` +
                '2 * value - 1',
        );
    }
}

/** @param {StoredMap} map @param {number} top */
function isGrey({ data, channels }, top) {
    for (let i = 0; i < data.length; i += channels) {
        const most = Math.max(Math.abs(data[i + 1] - data[i]), Math.abs(data[i + 2] - data[i]));
        if (most > (1.5 * top) / 255) return false;
    }
    return true;
}

/**
 * An image at a size no smaller than its own, interpolated bilinearly; vectors are made unit again.
 * @param {Image} image
 * @param {number} width
 * @param {number} height
 * @param {Wrap} wrap
 * @param {string} role
 * @returns {Image}
 */
export function resized(image, width, height, wrap, role) {
    if (image.width === width && image.height === height) return image;
    const lines = role === 'anisotropy';
    const down = stretched(lines ? untangled(image, wrap) : image, height, 1, wrap[1]);
    const out = stretched(down, width, 0, wrap[0]);
    if (lines || role === 'normal') {
        const count = lines ? 2 : 3;
        for (let at = 0; at < out.data.length; at += 3) {
            const length = Math.hypot(...out.data.subarray(at, at + count));
            for (let c = 0; c < count; c++) {
                const axis = Number(c === (lines ? 0 : 2));
                out.data[at + c] = length > (lines ? 0.02 : 1e-3) ? out.data[at + c] / length : axis;
            }
        }
    }
    return out;
}

/**
 * An image stretched along x (axis 0) or y (axis 1).
 * @param {Image} image
 * @param {number} size
 * @param {0 | 1} axis
 * @param {string} mode
 * @returns {Image}
 */
function stretched(image, size, axis, mode) {
    const count = axis ? image.height : image.width;
    if (count === size) return image;
    const { channels } = image;
    const [width, height] = axis ? [image.width, size] : [size, image.height];
    const data = new Float32Array(width * height * channels);
    for (let y = 0; y < height; y++) {
        for (let x = 0; x < width; x++) {
            const at = (((axis ? y : x) + 0.5) * count) / size - 0.5;
            const low = Math.floor(at);
            const weight = f(at - low);
            const [near, far] = [low, low + 1].map((place) => {
                const found = addressed(place, count, mode);
                return (axis ? found * image.width + x : y * image.width + found) * channels;
            });
            for (let c = 0; c < channels; c++) {
                const start = image.data[near + c];
                data[(y * width + x) * channels + c] = start + f(weight * f(image.data[far + c] - start));
            }
        }
    }
    return { data, width, height, channels };
}

/** @typedef {{name: string, pieces: Piece[], top: number, down: boolean}} Layout
 * A map as it is given back: `top` is the integer that stands for 1, 0 for floating-point numbers. */
/** @typedef {{width: number, height: number, shading: Record<string, Image>, plain: Record<string, Image>,
 *  layouts: Layout[]}} Material
 * `shading`: baseColor, metallic, roughness, normal and, where it is given, anisotropy, all of one size. */

/**
 * The maps of a material as numbers.
 * @param {Record<string, any>} maps
 * @param {Wrap} wrap
 * @param {string} convention of the normal map
 * @param {number} multiple of which the sides shall be multiples
 * @returns {Material}
 */
export function readMaps(maps, wrap, convention, multiple) {
    const down = oneOf('normalConvention', convention, ['opengl', 'directx']) === 'directx';
    /** @type {Record<string, Image>} */
    const found = {};
    /** @type {Layout[]} */
    const layouts = [];
    for (const [name, given] of Object.entries(maps ?? {})) {
        if (given === undefined || given === null) continue;
        oneOf('map', name, Object.keys(MAPS));
        const constant = typeof given === 'number' ? [given] : Array.isArray(given) ? given : undefined;
        if (constant) {
            found[name] = constantOf(name, constant);
            continue;
        }
        const map = checked(name, given);
        if (name === 'orm' && map.channels < 3) {
            throw new MipbakeError(`orm has ${map.channels} channels: expected occlusion, roughness and metallic`);
        }
        const alpha = map.channels % 2 === 0 && !maps.opacity; // an opacity of its own counts, not alpha beside it
        const pieces = MAPS[name].filter(({ role }) => name !== 'baseColor' || role !== 'opacity' || alpha);
        for (const role of new Set(pieces.map((piece) => piece.role))) {
            if (found[role]) throw new MipbakeError(`${role} is given twice: expected it alone or within ${name}`);
            let places = pieces.flatMap((piece, place) => (piece.role === role ? [place] : []));
            if (name === 'baseColor')
                places = role === 'opacity' ? [map.channels - 1] : map.channels < 3 ? [0] : [0, 1, 2];
            found[role] = decoded(name, map, role, places, down);
        }
        layouts.push({ name, pieces, top: topOf(map.data), down: down && name === 'normal' });
    }
    if (!found.roughness) throw new MipbakeError('there is no roughness: expected a map, a number, or an orm map');
    for (const [role, value] of Object.entries(DEFAULTS)) found[role] ??= constantOf(role, value);
    const { shading, width, height } = sameSize(found, wrap, multiple);
    const plain = Object.fromEntries(PLAIN.filter((role) => found[role]).map((role) => [role, found[role]]));
    for (const { name, pieces } of layouts) {
        // Maps that do not shade take the size of those that they share a file with.
        for (const { role } of pieces) {
            if (name !== role && plain[role]) plain[role] = toSize(plain[role], width, height, wrap, role);
        }
    }
    const held = new Set(layouts.flatMap(({ pieces }) => pieces.map((piece) => piece.role)));
    const top = layouts[0]?.top ?? 255;
    for (const role of Object.keys(shading)) {
        if (held.has(role)) continue;
        layouts.push({ name: role, pieces: MAPS[role].filter((piece) => piece.role === role), top, down: false });
    }
    return { width, height, shading, plain, layouts };
}

/** @param {string} name @param {unknown[]} values @returns {Image} */
function constantOf(name, values) {
    const count = DEFAULTS[name]?.length ?? 1;
    const all = name === 'baseColor' && values.length === 1 ? [values[0], values[0], values[0]] : values;
    const allowed = ['baseColor', 'normal', 'roughness', 'metallic'].includes(name);
    const least = name === 'normal' ? -1 : 0;
    if (!allowed || all.length !== count || !all.every((v) => typeof v === 'number' && v >= least && v <= 1)) {
        const expected = allowed ? `${count} from ${least} to 1, or a map` : 'a map';
        throw new MipbakeError(`${name} is ${JSON.stringify(values)}: expected ${expected}`);
    }
    return { data: Float32Array.from(/** @type {number[]} */ (all)), width: 1, height: 1, channels: count };
}

/**
 * The maps that shade at the size of the largest, its sides rounded up to multiples of a number.
 * @param {Record<string, Image>} found
 * @param {Wrap} wrap
 * @param {number} multiple
 */
function sameSize(found, wrap, multiple) {
    const roles = ['baseColor', 'metallic', 'roughness', 'normal', 'anisotropy'].filter((role) => found[role]);
    const largest = roles
        .map((role) => found[role])
        .reduce((a, b) => (b.width * b.height > a.width * a.height ? b : a));
    const [width, height] = [largest.width, largest.height].map((side) => Math.ceil(side / multiple) * multiple);
    /** @type {Record<string, Image>} */
    const shading = {};
    for (const role of roles) {
        const { width: w, height: h } = found[role];
        const [most, high] = [largest.width, largest.height];
        const apart = Math.abs(w * high - h * most) > Math.max(high, most);
        if ((w > 1 || h > 1) && (h > high || w > most || apart)) {
            throw new MipbakeError(
                `${role} is ${w} x ${h} and the largest map is ${most} x ${high}: expected one shape`,
            );
        }
        shading[role] = resized(found[role], width, height, wrap, role);
    }
    return { shading, width, height };
}

/**
 * A map that does not shade at a size that it is at least as small as.
 * @param {Image} image
 * @param {number} width
 * @param {number} height
 * @param {Wrap} wrap
 * @param {string} role
 */
function toSize(image, width, height, wrap, role) {
    if (image.width > width || image.height > height) {
        throw new MipbakeError(
            `${role} is ${image.width} x ${image.height}, larger than the maps that shade (${width} x ${height}): ` +
                'expected it in a map of its own',
        );
    }
    return resized(image, width, height, wrap, role);
}

/**
 * The values of a map at a level as they are stored: integers rounded, colours sRGB-encoded; or numbers.
 * @param {Layout} layout
 * @param {Record<string, Image>} images by role
 * @returns {StoredMap}
 */
export function encoded({ pieces, top, down }, images) {
    const { width, height } = images[pieces[0].role];
    const channels = pieces.length;
    const data = new (top === 0 ? Float32Array : top === 255 ? Uint8Array : Uint16Array)(width * height * channels);
    pieces.forEach(({ role, index, encoding }, place) => {
        const { data: from, channels: step } = images[role];
        const sign = down && index === 1 ? -1 : 1;
        const bytes = top === 255 && encoding === 'colour';
        for (let to = place, at = index; to < data.length; to += channels, at += step) {
            if (!top) data[to] = sign * from[at];
            else if (bytes) data[to] = toByte(from[at]);
            else data[to] = clamp(fileValue(sign * from[at], encoding), 0, 1) * top + 0.5; // rounded down by the array
        }
    });
    return { data, width, height, channels };
}

/**
 * What a file of integers holds of a value, from 0 to 1.
 * @param {number} value
 * @param {Piece['encoding']} encoding
 */
export function fileValue(value, encoding) {
    return encoding === 'colour' ? toEncoded(value) : encoding === 'signed' ? (value + 1) / 2 : value;
}
