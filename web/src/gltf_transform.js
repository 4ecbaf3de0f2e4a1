// A transform of glTF-Transform: materials get textures whose levels keep their look.

import { KHRTextureBasisu } from '@gltf-transform/extensions';

import { decodedImage } from './decode.js';
import { MipbakeError } from './errors.js';
import { bake, FILTERS, ktx2, METHODS } from './index.js';
import { materialOf } from './gltf_material.js';
import { oneOf } from './pixel_filter.js';
import { checkThreads } from './workers.js';
import { samplerOf } from './sampler.js';
import { rangesOf } from './textures.js';

/** @typedef {import('@gltf-transform/core').Document} Document */
/** @typedef {import('@gltf-transform/core').Texture} Texture */
/** @typedef {import('@gltf-transform/core').TextureInfo} TextureInfo */
/** @typedef {import('./gltf_material.js').Part} Part */

const OWN = ['encoder', 'texels', 'onProgress', 'onBaked'];
const TAKEN = ['method', 'filter', 'sampler', 'threads', 'assets'];

/**
 * Bakes the materials of a document; `gltf_transform.d.ts` describes the options.
 * @param {Record<string, any>} [options]
 */
export function mipbake(options = {}) {
    for (const name of Object.keys(options)) oneOf('option', name, [...TAKEN, ...OWN]);
    const { encoder, texels = 'uastc', onProgress, onBaked } = options;
    // What is wrong is said before any work.
    oneOf('method', options.method ?? METHODS[0], METHODS);
    oneOf('filter', options.filter ?? FILTERS[0], FILTERS);
    oneOf('kind of texels', texels, ['uastc', 'rgba8']);
    samplerOf(options.sampler ?? 'trilinear');
    checkThreads(options.threads);
    const taken = Object.fromEntries(TAKEN.map((name) => [name, options[name]]));

    return named('mipbake', async (/** @type {Document} */ document) => {
        /** @type {Map<Texture, Promise<any>>} */
        const images = new Map();
        const image = (/** @type {Texture} */ texture) => {
            const found = images.get(texture) ?? decodedImage(...fileOf(texture), encoder);
            images.set(texture, found);
            return found;
        };
        /** @type {Map<string, Part[]>} Materials that show the same are baked once. */
        const groups = new Map();
        for (const material of document.getRoot().listMaterials()) {
            const { part, reason, loud } = materialOf(material);
            if (part) groups.set(part.key, [...(groups.get(part.key) ?? []), part]);
            else document.getLogger()[loud ? 'warn' : 'info'](`mipbake: ${reason}`);
        }
        // All is baked before anything is changed.
        const made = [];
        for (const parts of groups.values()) {
            const share = (/** @type {number} */ own) => onProgress?.((made.length + own) / groups.size);
            made.push({ parts, textures: await baked(parts, image, taken, texels, share) });
        }
        if (!made.length) return;
        document.createExtension(KHRTextureBasisu).setRequired(true);
        const before = new Set();
        for (const { parts, textures } of made) show(document, parts, textures, before);
        onBaked?.(made.flatMap(({ parts }) => parts.map((part) => part.material.getName())));
        for (const texture of before) {
            if (texture.listParents().every((/** @type {any} */ each) => each.propertyType === 'Root'))
                texture.dispose();
        }
    });
}

/**
 * glTF-Transform tells transforms apart by their names.
 * @template {Function} T
 * @param {string} name
 * @param {T} transform
 * @returns {T}
 */
function named(name, transform) {
    return Object.defineProperty(transform, 'name', { value: name });
}

/**
 * @param {Texture} texture
 * @returns {[Uint8Array, string, string]}
 */
function fileOf(texture) {
    const [bytes, name] = [texture.getImage(), texture.getName() || texture.getURI() || 'without a name'];
    if (!bytes) throw new MipbakeError(`the texture ${name} has no image: expected a document with its resources`);
    return [bytes, texture.getMimeType(), name];
}

/**
 * The textures of materials that show the same, as KTX2 files by slot, and what the materials multiply them by.
 * @param {Part[]} parts
 * @param {(texture: Texture) => Promise<any>} image
 * @param {Record<string, any>} taken
 * @param {'uastc' | 'rgba8'} texels
 * @param {(share: number) => void} progress
 */
async function baked(parts, image, taken, texels, progress) {
    const [first] = parts;
    const maps = await first.maps(
        image,
        parts.some((part) => part.occluded),
    );
    const onProgress = (/** @type {number} */ share) => progress(0.8 * share);
    const { wrap, cutoff: alphaCutoff } = first;
    const stack = await bake(maps, { ...taken, wrap, alphaCutoff, multipleOf: 4, onProgress });
    const ranges = rangesOf(stack);
    /** @type {Record<string, Uint8Array>} */
    const files = {};
    for (const name of first.slots(stack)) {
        files[name] = await ktx2(stack, name, { texels, ranges, assets: taken.assets });
    }
    progress(1);
    return { files, ranges };
}

/**
 * Gives materials their textures, and the factors that bring out what the textures mean.
 * @param {Document} document
 * @param {Part[]} parts
 * @param {{files: Record<string, Uint8Array>, ranges: import('./textures.js').Ranges}} made
 * @param {Set<Texture>} before gets the textures that were shown
 */
function show(document, parts, { files, ranges }, before) {
    const name = parts[0].material.getName();
    /** @type {Record<string, Texture>} */
    const textures = {};
    for (const [slot, file] of Object.entries(files)) {
        const texture = document.createTexture([name, slot].filter(Boolean).join('_'));
        textures[slot] = texture.setMimeType('image/ktx2').setImage(/** @type {any} */ (file));
    }
    for (const part of parts) {
        for (const texture of part.textures) before.add(texture);
        part.show(textures, ranges);
    }
}
