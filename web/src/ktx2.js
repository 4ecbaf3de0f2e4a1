// KTX 2.0 files of one texture with its levels, as the Khronos specifications of the container and of its data format
// descriptor have them.

import { nodeModule } from './core.js';
import version from './version.js';

const IDENTIFIER = [0xab, 0x4b, 0x54, 0x58, 0x20, 0x32, 0x30, 0xbb, 0x0d, 0x0a, 0x1a, 0x0a];
const START = 80; // bytes of identifier, header and index
const ZSTANDARD = 2;
const ZSTANDARD_LEVEL = 15;

/** @typedef {{colourModel: number, vkFormat: number, side: number, bytes: number, samples: number[][]}} Kind
 * `bytes` of a block of `side` x `side` texels; samples as [bit offset, bits, channel, upper value]. */

/**
 * What the texels of a file are.
 * @param {'uastc' | 'rgba8'} texels
 * @param {number} channels
 * @param {boolean} srgb
 * @returns {Kind}
 */
function kindOf(texels, channels, srgb) {
    if (texels === 'uastc') {
        const samples = [[0, 128, channels > 3 ? 3 : 0, 0xffffffff]];
        return { colourModel: 166, vkFormat: 0, side: 4, bytes: 16, samples };
    }
    const samples = [0, 1, 2, 15 | (srgb ? 0x10 : 0)].map((channel, i) => [8 * i, 8, channel, 255]);
    return { colourModel: 1, vkFormat: srgb ? 43 : 37, side: 1, bytes: 4, samples };
}

/**
 * Zstandard where the runtime has it: Node.js 22.15 and later.
 * @returns {((bytes: Uint8Array) => Uint8Array) | undefined}
 */
function compressor() {
    const zlib = nodeModule('node:zlib');
    if (!zlib?.zstdCompressSync) return undefined;
    const params = { [zlib.constants.ZSTD_c_compressionLevel]: ZSTANDARD_LEVEL };
    return (bytes) => zlib.zstdCompressSync(bytes, { params });
}

/**
 * A file.
 * @param {Uint8Array[]} levels bytes of each, finest first
 * @param {{width: number, height: number, texels: 'uastc' | 'rgba8', channels: number, srgb: boolean}} about
 * @param {Record<string, string>} values texts by key
 */
export function ktx2File(levels, { width, height, texels, channels, srgb }, values) {
    const kind = kindOf(texels, channels, srgb);
    const compress = compressor();
    const stored = compress ? levels.map(compress) : levels;
    const descriptor = descriptorOf(kind, srgb);
    const pairs = pairsOf({ KTXorientation: 'rd', KTXwriter: `mipbake ${version}`, ...values });
    const descriptorAt = START + 24 * levels.length;
    const pairsAt = descriptorAt + descriptor.length;
    const alignment = compress ? 1 : kind.bytes;
    // Levels lie from the coarsest to the finest, so that a stream can be shown before it ends.
    const places = new Array(levels.length);
    let end = pairsAt + pairs.length;
    for (let i = levels.length - 1; i >= 0; i--) {
        places[i] = Math.ceil(end / alignment) * alignment;
        end = places[i] + stored[i].length;
    }
    const out = new Uint8Array(end);
    const view = new DataView(out.buffer);
    out.set(IDENTIFIER);
    const header = [kind.vkFormat, 1, width, height, 0, 0, 1, levels.length, compress ? ZSTANDARD : 0];
    const index = [descriptorAt, descriptor.length, pairsAt, pairs.length];
    [...header, ...index].forEach((value, i) => view.setUint32(12 + 4 * i, value, true));
    levels.forEach((level, i) => {
        [places[i], stored[i].length, level.length].forEach((value, k) => {
            view.setBigUint64(START + 24 * i + 8 * k, BigInt(value), true);
        });
        out.set(stored[i], places[i]);
    });
    out.set(descriptor, descriptorAt);
    out.set(pairs, pairsAt);
    return out;
}

/**
 * The data format descriptor: one basic block.
 * @param {Kind} kind
 * @param {boolean} srgb
 */
function descriptorOf({ colourModel, vkFormat, side, bytes, samples }, srgb) {
    const size = 24 + 16 * samples.length;
    const out = new Uint8Array(4 + size);
    const view = new DataView(out.buffer);
    view.setUint32(0, 4 + size, true);
    view.setUint16(8, 2, true); // version
    view.setUint16(10, size, true);
    // KHR_texture_basisu wants unspecified primaries for anything but colours.
    out.set([colourModel, srgb || vkFormat ? 1 : 0, srgb ? 2 : 1, 0, side - 1, side - 1, 0, 0, bytes], 12);
    samples.forEach(([offset, bits, channel, upper], i) => {
        const at = 28 + 16 * i;
        view.setUint16(at, offset, true);
        out.set([bits - 1, channel], at + 2);
        view.setUint32(at + 12, upper, true);
    });
    return out;
}

/** @param {Record<string, string>} values */
function pairsOf(values) {
    const entries = Object.keys(values)
        .sort()
        .map((key) => {
            const text = new TextEncoder().encode(`${key}\0${values[key]}\0`);
            const entry = new Uint8Array(4 + Math.ceil(text.length / 4) * 4);
            new DataView(entry.buffer).setUint32(0, text.length, true);
            entry.set(text, 4);
            return entry;
        });
    const out = new Uint8Array(entries.reduce((sum, entry) => sum + entry.length, 0));
    let at = 0;
    for (const entry of entries) {
        out.set(entry, at);
        at += entry.length;
    }
    return out;
}
