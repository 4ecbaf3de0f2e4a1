// Trained weights, and what of them the core takes.

import { once } from './core.js';
import { MipbakeError } from './errors.js';
import { FILTERS } from './pixel_filter.js';

/** @typedef {{lookups: number, bias: number, frames: number}} Sampler */
/** @typedef {{weight: Float32Array, bias: Float32Array, outputs: number, inputs: number, taps: number}} Layer */
/** @typedef {{kernel: string, sampler: Sampler}} Lookup */
/** @typedef {{index: number, channels: number, mostRoughness: number}} Model */
/** @typedef {{read: Model, made: Model, told: Float32Array, encoder: Layer[], project: Layer, decoder: Layer[],
 *  codes: Float32Array[][]}} Network
 * Weights, ready for bakes; workers are sent copies. `codes`: what the code adds to the biases of the layers of the
 * decoder, (outputs, code) each. */

const LEAST_ROUGHNESS = 0.045; // what shading raises it to
const NAMED = 3; // numbers of the code that come before the pixel filter's
const MOST_LEVEL = 8; // that the decoder distinguishes

/** Number of a material model in the core, its channels, and the greatest roughness that it stores. */
const MODELS = {
    gltf: { index: 0, channels: 8, mostRoughness: 1 },
    'gltf-anisotropic': { index: 1, channels: 11, mostRoughness: 1 },
    ggx: { index: 2, channels: 11, mostRoughness: Math.exp(0.5) },
};

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

/**
 * @param {any} info content of the .json file
 * @param {ReturnType<typeof tensorsOf>} tensors
 * @returns {Network}
 */
function networkOf({ network }, tensors) {
    const layer = (/** @type {string} */ name) => {
        const weight = tensors.get(`${name}.weight`);
        const bias = tensors.get(`${name}.bias`);
        if (!weight || !bias) throw new Error(`no layer ${name}`);
        const [outputs, inputs, ...sides] = weight.shape;
        return { weight: weight.data, bias: bias.data, outputs, inputs, taps: sides[0] === 3 ? 9 : 1 };
    };
    const layers = (/** @type {string} */ name, /** @type {number} */ count) =>
        Array.from({ length: count }, (_, i) => layer(`${name}.${i}`));
    const made = MODELS[/** @type {keyof typeof MODELS} */ (network.decoders[0])];
    const last = [layer('output'), layer('crisp'), ...(tensors.has('stretch.weight') ? [layer('stretch')] : [])];
    const decoder = [...layers('decoder', network.decoder_layers), stacked(last)];
    // The code, of level and filter, stands between the features and the learned latents.
    const code = NAMED + FILTERS.length;
    const features = decoder[0].inputs - code - network.latent_channels;
    return {
        read: made === MODELS['gltf-anisotropic'] ? MODELS.gltf : made,
        made,
        told: /** @type {Float32Array} */ (tensors.get('told')?.data),
        encoder: layers('encoder', network.convolutions + network.pointwise),
        project: layer('project'),
        decoder: decoder.map((each) => without(each, features, code)),
        codes: decoder.map(({ weight, outputs, inputs }) =>
            Array.from({ length: outputs }, (_, row) =>
                weight.slice(row * inputs + features, row * inputs + features + code),
            ),
        ),
    };
}

/**
 * Biases of the decoder's layers one after the other, with what level, filter and sampler add.
 * @param {Network} network
 * @param {number} level
 * @param {Lookup} lookup
 */
export function biases({ decoder, codes, told }, level, { kernel, sampler }) {
    const filters = FILTERS.map((name) => Number(name === kernel));
    const code = [Number(level === 0), Number(level === 1), (Math.min(level, MOST_LEVEL) - 3) / 4, ...filters];
    const out = decoder.flatMap(({ bias }, i) =>
        codes[i].map((row, at) => code.reduce((sum, each, k) => sum + each * row[k], bias[at])),
    );
    const share = Math.log2(sampler.lookups) / 4;
    const features = [1 - share, share, sampler.bias, Number(sampler.frames > 1)];
    const wide = told.length / features.length;
    features.forEach((each, k) => {
        for (let i = 0; i < wide; i++) out[i] += each * told[k * wide + i];
    });
    return new Float32Array(out);
}

/**
 * The packed network in a core; what the structures point to may go then.
 * @param {import('./core.js').Core} core
 * @param {Network} network
 */
export function packed(core, { read, made, encoder, project, decoder }) {
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
    const most = made.mostRoughness;
    const limits = [LEAST_ROUGHNESS, most, Math.log(LEAST_ROUGHNESS), Math.log(most)];
    const args = kept(
        core.structure(120, [
            [4, 'int', read.index],
            [8, 'int', made.index],
            ...[...limits, LEAST_ROUGHNESS ** 4, most ** 4].map(
                (value, i) => /** @type {[number, 'float', number]} */ ([12 + 4 * i, 'float', value]),
            ),
            [72, 'int', list(encoder)],
            [76, 'int', encoder.length],
            ...fieldsOf(project, 80),
            [112, 'int', list(decoder)],
            [116, 'int', decoder.length],
        ]),
    );
    const found = core.call('network_begin', args);
    for (const each of lent) core.give(each);
    return found;
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
            return networkOf(info, tensorsOf(bytes));
        } catch (error) {
            throw new MipbakeError(`${name}.safetensors of mipbake is damaged: install the package again`);
        }
    });
}
