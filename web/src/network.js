// Baking with trained weights: what models/moment_baker.py does, over the core as WebAssembly.

import { once } from './core.js';
import { MipbakeError } from './errors.js';
import { addressed, FILTERS, levelSizes, resampleWeights } from './pixel_filter.js';

/** @typedef {import('./pixel_filter.js').Wrap} Wrap */
/** @typedef {import('./pixel_filter.js').Image} Image */
/** @typedef {{lookups: number, bias: number, frames: number}} Sampler */
/** @typedef {{weight: Float32Array, bias: Float32Array, outputs: number, inputs: number, taps: number}} Layer */
/** @typedef {{places: Int32Array, sharp: Float32Array, plain: Float32Array, count: number, taps: number}} Axis */
/** @typedef {{kernel: string, sampler: Sampler}} Lookup */

const LEAST_ROUGHNESS = 0.045; // what shading raises it to
const NAMED = 3; // numbers of the code that come before the pixel filter's
const MOST_LEVEL = 8; // that the decoder distinguishes
const FROM_TOP = 3; // levels that are filtered from level 0; each coarser one from box averages so many levels finer
const TRILINEAR = 0.8; // width of the pixel filter above level 0 for trilinear lookups
const BETWEEN = 1 / 60; // what levels are sharper by because lookups lie between them

/** Number of a material model in the core, its channels, and the greatest roughness that it stores. */
const MODELS = {
    gltf: { index: 0, channels: 8, mostRoughness: 1 },
    'gltf-anisotropic': { index: 1, channels: 11, mostRoughness: 1 },
    ggx: { index: 2, channels: 11, mostRoughness: Math.exp(0.5) },
};

/**
 * Width of the pixel filter of a level.
 * @param {number} level
 * @param {Sampler} sampler
 */
function widthOf(level, { lookups, bias, frames }) {
    if (!level) return 1;
    if (frames > 1) return TRILINEAR;
    const width = TRILINEAR + (1 - TRILINEAR) * (Math.log2(lookups) / 4);
    return Math.min(Math.max(width * 2 ** (-bias / 2), 0.5), 4);
}

/**
 * a of the filter (-a, 1 + 2 a, -a) that undoes the blur of a bilinear lookup.
 * @param {number} level
 */
const sharpening = (level) => 1 / 12 + BETWEEN - 4 ** -level / 24;

/**
 * The tensors of a .safetensors file.
 * @param {Uint8Array} bytes
 * @returns {Map<string, {shape: number[], data: Float32Array}>}
 */
function tensorsOf(bytes) {
    const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    const length = Number(view.getBigUint64(0, true));
    const header = JSON.parse(new TextDecoder().decode(bytes.subarray(8, 8 + length)));
    const found = new Map();
    for (const [name, about] of Object.entries(header)) {
        if (name === '__metadata__') continue;
        const [from, to] = about.data_offsets;
        const data = new Float32Array(bytes.slice(8 + length + from, 8 + length + to).buffer);
        found.set(name, { shape: about.shape, data });
    }
    return found;
}

/** A network's weights, ready for bakes. */
class Network {
    /**
     * @param {any} info content of the .json file
     * @param {ReturnType<typeof tensorsOf>} tensors
     */
    constructor(info, tensors) {
        const { network } = info;
        const layer = (/** @type {string} */ name) => {
            const weight = tensors.get(`${name}.weight`);
            const bias = tensors.get(`${name}.bias`);
            if (!weight || !bias) throw new Error(`no layer ${name}`);
            const [outputs, inputs, ...sides] = weight.shape;
            return { weight: weight.data, bias: bias.data, outputs, inputs, taps: sides[0] === 3 ? 9 : 1 };
        };
        this.made = MODELS[/** @type {keyof typeof MODELS} */ (network.decoders[0])];
        this.read = this.made === MODELS['gltf-anisotropic'] ? MODELS.gltf : this.made;
        this.told = /** @type {Float32Array} */ (tensors.get('told')?.data);
        /** @type {Layer[]} */
        this.encoder = [];
        for (let i = 0; i < network.convolutions + network.pointwise; i++) this.encoder.push(layer(`encoder.${i}`));
        this.project = layer('project');
        const decoder = [];
        for (let i = 0; i < network.decoder_layers; i++) decoder.push(layer(`decoder.${i}`));
        const last = [layer('output'), layer('crisp'), ...(tensors.has('stretch.weight') ? [layer('stretch')] : [])];
        decoder.push(stacked(last));
        // The code, of level and filter, stands between the features and the learned latents.
        const code = NAMED + FILTERS.length;
        const features = decoder[0].inputs - code - network.latent_channels;
        /** @type {Layer[]} */
        this.decoder = decoder.map((each) => without(each, features, code));
        /** What the code adds to the biases of a layer: (outputs, code). */
        this.codes = decoder.map(({ weight, outputs, inputs }) =>
            Array.from({ length: outputs }, (_, row) =>
                weight.subarray(row * inputs + features, row * inputs + features + code),
            ),
        );
    }

    /**
     * Biases of the decoder's layers one after the other, with what level, filter and sampler add.
     * @param {number} level
     * @param {Lookup} lookup
     */
    biases(level, { kernel, sampler }) {
        const filters = FILTERS.map((name) => Number(name === kernel));
        const code = [Number(level === 0), Number(level === 1), (Math.min(level, MOST_LEVEL) - 3) / 4, ...filters];
        const out = this.decoder.flatMap(({ bias }, i) =>
            this.codes[i].map((row, at) => code.reduce((sum, each, k) => sum + each * row[k], bias[at])),
        );
        const share = Math.log2(sampler.lookups) / 4;
        const features = [1 - share, share, sampler.bias, Number(sampler.frames > 1)];
        const wide = this.told.length / features.length;
        features.forEach((each, k) => {
            for (let i = 0; i < wide; i++) out[i] += each * this.told[k * wide + i];
        });
        return new Float32Array(out);
    }

    /**
     * The packed network in a core; what the structures point to may go then.
     * @param {import('./core.js').Core} core
     */
    packed(core) {
        /** @type {number[]} */
        const lent = [];
        const kept = (/** @type {number} */ at) => (lent.push(at), at);
        const fieldsOf = (/** @type {Layer} */ each, /** @type {number} */ at) =>
            /** @type {[number, 'int' | 'int64', number][]} */ ([
                [at, 'int', kept(core.put(each.weight))],
                [at + 4, 'int', kept(core.put(each.bias))],
                [at + 8, 'int64', each.outputs],
                [at + 16, 'int64', each.inputs],
                [at + 24, 'int', each.taps],
            ]);
        const list = (/** @type {Layer[]} */ all) =>
            kept(
                core.structure(
                    32 * all.length,
                    all.flatMap((each, i) => fieldsOf(each, 32 * i)),
                ),
            );
        const most = this.made.mostRoughness;
        const limits = [LEAST_ROUGHNESS, most, Math.log(LEAST_ROUGHNESS), Math.log(most)];
        const args = kept(
            core.structure(120, [
                [4, 'int', this.read.index],
                [8, 'int', this.made.index],
                ...[...limits, LEAST_ROUGHNESS ** 4, most ** 4].map(
                    (value, i) => /** @type {[number, 'float', number]} */ ([12 + 4 * i, 'float', value]),
                ),
                [72, 'int', list(this.encoder)],
                [76, 'int', this.encoder.length],
                ...fieldsOf(this.project, 80),
                [112, 'int', list(this.decoder)],
                [116, 'int', this.decoder.length],
            ]),
        );
        const packed = core.call('network_begin', args);
        for (const each of lent) core.give(each);
        return packed;
    }
}

/**
 * Layers with the same inputs as one; the inputs that some have fewer of are 0.
 * @param {Layer[]} layers
 * @returns {Layer}
 */
function stacked(layers) {
    const inputs = Math.max(...layers.map((each) => each.inputs));
    const outputs = layers.reduce((sum, each) => sum + each.outputs, 0);
    const weight = new Float32Array(outputs * inputs);
    const bias = new Float32Array(outputs);
    let row = 0;
    for (const each of layers) {
        for (let i = 0; i < each.outputs; i++, row++) {
            weight.set(each.weight.subarray(i * each.inputs, (i + 1) * each.inputs), row * inputs);
            bias[row] = each.bias[i];
        }
    }
    return { weight, bias, outputs, inputs, taps: 1 };
}

/**
 * A layer without some of its inputs.
 * @param {Layer} layer
 * @param {number} from
 * @param {number} count
 * @returns {Layer}
 */
function without({ weight, bias, outputs, inputs, taps }, from, count) {
    const kept = weight.filter((_, i) => i % inputs < from || i % inputs >= from + count);
    return { weight: kept, bias, outputs, inputs: inputs - count, taps };
}

/**
 * Weights by name.
 * @param {import('./core.js').Assets} assets
 * @param {string} name
 */
export async function networkNamed(assets, name) {
    const info = await once(assets, `${name}.json`, (bytes) => JSON.parse(new TextDecoder().decode(bytes)));
    return once(assets, `${name}.safetensors`, (bytes) => {
        try {
            return new Network(info, tensorsOf(bytes));
        } catch (error) {
            throw new MipbakeError(`${name}.safetensors of mipbake is damaged: install the package again`);
        }
    });
}

/**
 * Every level of the stack of a material.
 * @param {import('./core.js').Core} core
 * @param {Network} network
 * @param {Image} stored channels of the model that the network reads
 * @param {Lookup} lookup
 * @param {Wrap} wrap
 * @param {(share: number) => Promise<void> | void} progress
 * @returns {Promise<Image[]>} stored channels of the model that it makes
 */
export async function networkLevels(core, network, stored, lookup, wrap, progress) {
    const { height, width } = stored;
    const { channels } = network.made;
    const sizes = levelSizes(height, width);
    const packed = network.packed(core);
    const source = core.put(stored.data);
    const outs = sizes.map(([rows, columns]) => core.take(4 * rows * columns * channels));
    const bias = (/** @type {number} */ level) => core.put(network.biases(level, lookup));

    /** @type {[number, 'int', number][]} */
    const fields = [];
    /** @type {Map<number, number>} The place among the sinks of box averages as fine as a level. */
    const boxes = new Map();
    let count = 0;
    /** @type {Map<string, [number, 'int', number][]>} Axes that are the same are in memory once. */
    const axes = new Map();
    const put = (/** @type {string} */ key, /** @type {() => Axis} */ make) => {
        if (!axes.has(key)) {
            const { places, sharp, plain, count: n, taps } = make();
            const values = [core.put(places), core.put(sharp), core.put(plain), n, taps];
            axes.set(
                key,
                values.map((value, i) => [4 * i, 'int', value]),
            );
        }
        return /** @type {[number, 'int', number][]} */ (axes.get(key));
    };
    const add = (
        /** @type {number} */ from,
        /** @type {[number, 'int', number][][]} */ both,
        /** @type {number} */ out,
        /** @type {number} */ own,
    ) => {
        const at = 52 * count++;
        fields.push([at, 'int', from], [at + 44, 'int', out], [at + 48, 'int', own]);
        both.forEach((axis, i) => {
            for (const [place, kind, value] of axis) fields.push([at + 4 + 20 * i + place, kind, value]);
        });
    };
    for (let level = 1; level < sizes.length; level++) {
        const finer = Math.max(0, level - FROM_TOP);
        if (finer) {
            const both = [0, 1].map((axis) => {
                const [from, to, mode] = [sizes[finer - 1][axis], sizes[finer][axis], wrap[1 - axis]];
                return put(`box ${from} ${to} ${mode}`, () => plainAxis(resampleWeights(from, to, 'box', mode)));
            });
            const before = boxes.get(finer - 1) ?? -1;
            boxes.set(finer, count);
            add(before, both, 0, 0);
        }
        const both = [0, 1].map((axis) => {
            const [from, to, mode] = [sizes[finer][axis], sizes[level][axis], wrap[1 - axis]];
            return put(`${level} ${from} ${to} ${mode}`, () => {
                const found = resampleWeights(from, to, lookup.kernel, mode, widthOf(level, lookup.sampler));
                return sharpened(found, sharpening(level), mode);
            });
        });
        add(boxes.get(finer) ?? -1, both, outs[level], bias(level));
    }

    const { sharp, plain } = topTaps(lookup.kernel);
    const args = core.structure(56, [
        [0, 'int', source],
        [8, 'int64', height],
        [16, 'int64', width],
        [24, 'byte', Number(wrap[1] === 'wrap')],
        [25, 'byte', Number(wrap[0] === 'wrap')],
        [28, 'int', core.put(sharp)],
        [32, 'int', core.put(plain)],
        [36, 'int', (sharp.length - 1) / 2],
        [40, 'int', bias(0)],
        [44, 'int', outs[0]],
        [48, 'int', core.structure(Math.max(52, 52 * count), fields)],
        [52, 'int', count],
    ]);
    const bake = core.call('bake_begin', packed, args);
    for (let done = 0; done < height;) {
        done = core.call('bake_advance', bake);
        await progress(done / height);
    }
    return sizes.map(([rows, columns], level) => ({
        data: core.floats(outs[level], rows * columns * channels).slice(),
        width: columns,
        height: rows,
        channels,
    }));
}

/**
 * Taps of level 0, which are the same for every texel.
 * @param {string} kernel
 */
function topTaps(kernel) {
    const found = resampleWeights(16, 16, kernel, 'wrap');
    const plain = found.weights.slice(0, found.taps);
    const a = sharpening(0);
    const sharp = new Float64Array(plain.length + 2);
    [-a, 1 + 2 * a, -a].forEach((factor, k) => plain.forEach((each, i) => (sharp[i + k] += factor * each)));
    return { sharp: new Float32Array(sharp), plain };
}

/**
 * @param {import('./pixel_filter.js').Taps} found
 * @returns {Axis}
 */
function plainAxis({ index, weights, count, taps }) {
    return { places: index, sharp: weights, plain: weights, count, taps };
}

/**
 * A filter with (-a, 1 + 2 a, -a) after it, in one; an axis of one texel stays as it is. Taps of one texel are one.
 * @param {import('./pixel_filter.js').Taps} found
 * @param {number} a
 * @param {string} wrap
 * @returns {Axis}
 */
function sharpened(found, a, wrap) {
    const { index, weights, count, taps } = found;
    if (count === 1) return plainAxis(found);
    const centre = Math.fround(1 + 2 * a);
    const beside = Math.fround(-a);
    const rows = Array.from({ length: count }, (_, row) => {
        /** @type {Map<number, [number, number]>} */
        const sums = new Map();
        for (const offset of [0, -1, 1]) {
            const other = addressed(row + offset, count, wrap) * taps;
            for (let k = other; k < other + taps; k++) {
                const sum = sums.get(index[k]) ?? [0, 0];
                sum[0] += Math.fround((offset ? beside : centre) * weights[k]);
                if (!offset) sum[1] += weights[k];
                sums.set(index[k], sum);
            }
        }
        return [...sums].sort(([one], [other]) => one - other);
    });
    const wide = Math.max(...rows.map((row) => row.length));
    const places = new Int32Array(count * wide);
    const sharp = new Float32Array(count * wide);
    const plain = new Float32Array(count * wide);
    rows.forEach((row, i) => {
        row.forEach(([place, sums], k) => {
            places[i * wide + k] = place;
            [sharp[i * wide + k], plain[i * wide + k]] = sums;
        });
    });
    return { places, sharp, plain, count, taps: wide };
}
