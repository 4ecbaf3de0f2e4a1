// What of a material of glTF-Transform is baked, and where it goes. mipbake/source/gltf has the same rules in Python.

import { MipbakeError } from './errors.js';
import { decodedNormals } from './normals.js';
import { toLinear } from './srgb.js';

/** @typedef {import('@gltf-transform/core').Material} Material */
/** @typedef {import('@gltf-transform/core').Texture} Texture */
/** @typedef {import('@gltf-transform/core').TextureInfo} TextureInfo */
/** @typedef {import('./maps.js').StoredMap} StoredMap */
/** @typedef {(texture: Texture) => Promise<StoredMap>} Decode */

const REPEAT = 10497;
const UNFIT = ['KHR_materials_unlit', 'KHR_materials_pbrSpecularGlossiness'];
const TRANSFORM = 'KHR_texture_transform';
const ANISOTROPY = 'KHR_materials_anisotropy';
const f = Math.fround;

/**
 * What of a material is baked, or why nothing is; `loud` where its author should know.
 * @param {Material} material
 * @returns {{part?: Part, reason?: string, loud?: boolean}}
 */
export function materialOf(material) {
    const where = `material ${material.getName() || 'without a name'}`;
    const left = (/** @type {string} */ why, loud = false) => ({
        reason: `${where} ${why}, and is left as it is`,
        loud,
    });
    if (UNFIT.some((name) => material.getExtension(name))) return left('is unlit or in specular and glossiness');
    const normal = material.getNormalTexture();
    const packed = material.getMetallicRoughnessTexture();
    if (!normal && !packed) return left('has neither a normal nor a metallicRoughness texture');
    if (material.getNormalScale() < 0) return left('has a negative scale of its normals, which inverts bumps', true);
    const part = new Part(material);
    if (part.textures.some((texture) => texture.getMimeType() === 'image/ktx2')) {
        return left('has KTX2 textures already: bake it from PNG or JPEG', true);
    }
    const apart = part.infos.some((info) => mappingOf(info) !== mappingOf(part.main));
    return apart ? left('has textures on different texture coordinates', true) : { part };
}

/**
 * Where on the surface a texture lies, as text.
 * @param {TextureInfo} info
 */
function mappingOf(info) {
    const transform = /** @type {any} */ (info.getExtension(TRANSFORM));
    const placed = transform && [transform.getOffset(), transform.getRotation(), transform.getScale()];
    return JSON.stringify([transform?.getTexCoord() ?? info.getTexCoord(), placed ?? [[0, 0], 0, [1, 1]]]);
}

/** The microfacet lobe of a material. */
export class Part {
    /** @param {Material} material */
    constructor(material) {
        this.material = material;
        this.normal = material.getNormalTexture();
        this.packed = material.getMetallicRoughnessTexture();
        const extension = /** @type {any} */ (material.getExtension(ANISOTROPY));
        this.anisotropy = extension?.getAnisotropyStrength() ? extension : null;
        this.directions = /** @type {Texture | null} */ (this.anisotropy?.getAnisotropyTexture() ?? null);
        /** @type {TextureInfo[]} */
        this.infos = [];
        if (this.normal) this.infos.push(/** @type {TextureInfo} */ (material.getNormalTextureInfo()));
        if (this.packed) this.infos.push(/** @type {TextureInfo} */ (material.getMetallicRoughnessTextureInfo()));
        if (this.directions) this.infos.push(this.anisotropy.getAnisotropyTextureInfo());
        /** Whose place on the surface and whose wrap all of them have. */
        this.main = this.infos[0];
        const base = material.getBaseColorTexture();
        const beside = material.getBaseColorTextureInfo();
        /** A base colour that lies elsewhere on the surface is not baked; its mean stands for it. */
        this.elsewhere = base && beside && mappingOf(beside) !== mappingOf(this.main) ? base : null;
        this.base = this.elsewhere ? null : base;
        const occlusion = material.getOcclusionTexture();
        this.occluded = Boolean(occlusion && occlusion === this.packed);
        const alpha = material.getBaseColorFactor()[3];
        const tested = material.getAlphaCutoff() / alpha; // the material tests the product
        const mode = material.getAlphaMode();
        this.transparent = mode !== 'OPAQUE';
        this.cutoff = mode === 'MASK' && tested > 0 && tested <= 1 ? tested : undefined;
    }

    /** The textures that are replaced. */
    get textures() {
        const found = [this.normal, this.packed, this.directions, this.base];
        return /** @type {Texture[]} */ (found.filter(Boolean));
    }

    /**
     * Addressing along u and v; a mirrored texture is nearest to "clamp".
     * @returns {import('./pixel_filter.js').Wrap}
     */
    get wrap() {
        const mode = (/** @type {number} */ each) => (each === REPEAT ? 'wrap' : 'clamp');
        return [mode(this.main.getWrapS()), mode(this.main.getWrapT())];
    }

    /** Equal for materials that are baked as one: everything that texels are made from. */
    get key() {
        const textures = [this.normal, this.packed, this.directions, this.base, this.elsewhere];
        const { material, anisotropy } = this;
        return JSON.stringify([
            textures.map((texture) => (texture ? idOf(texture) : 0)),
            this.wrap,
            [material.getNormalScale(), material.getRoughnessFactor(), material.getMetallicFactor()],
            this.base || this.elsewhere ? null : material.getBaseColorFactor().slice(0, 3),
            [this.transparent, this.cutoff],
            [anisotropy?.getAnisotropyStrength(), anisotropy?.getAnisotropyRotation()],
        ]);
    }

    /**
     * The maps that are baked, factors taken in.
     * @param {Decode} decode
     * @param {boolean} occluded whether red of the packed texture is occlusion
     */
    async maps(decode, occluded) {
        const { material } = this;
        const packed = this.packed ? await decode(this.packed) : null;
        /** @type {Record<string, any>} */
        const maps = {
            baseColor: await this.colour(decode),
            orm: packedMap(packed, occluded, material.getRoughnessFactor(), material.getMetallicFactor()),
        };
        if (this.normal) maps.normal = scaledNormals(await decode(this.normal), material.getNormalScale());
        if (this.anisotropy) {
            const drawn = this.directions ? await decode(this.directions) : null;
            maps.anisotropy = turned(
                drawn,
                this.anisotropy.getAnisotropyStrength(),
                this.anisotropy.getAnisotropyRotation(),
            );
        }
        return maps;
    }

    /**
     * The base colour; its alpha where that counts.
     * @param {Decode} decode
     */
    async colour(decode) {
        if (this.elsewhere) return meanColour(await decode(this.elsewhere));
        if (!this.base) return this.material.getBaseColorFactor().slice(0, 3);
        const map = await decode(this.base);
        if (this.transparent || map.channels % 2) return map;
        return withoutAlpha(map);
    }

    /**
     * The maps of a stack that become textures; a roughness is made even where there was no texture of it.
     * @param {import('../index.d.ts').Stack} stack
     */
    slots(stack) {
        const made = [this.base && 'baseColor', 'orm', this.normal && 'normal'];
        if (stack.model !== 'gltf') made.push('anisotropy');
        return /** @type {string[]} */ (made.filter(Boolean));
    }

    /**
     * Shows baked textures, and makes 1 of what they hold already.
     * @param {Record<string, Texture>} textures
     * @param {import('./textures.js').Ranges} ranges
     */
    show(textures, ranges) {
        const { material } = this;
        if (textures.baseColor) material.setBaseColorTexture(textures.baseColor);
        if (textures.normal) material.setNormalTexture(textures.normal).setNormalScale(ranges.normal);
        if (this.occluded) material.setOcclusionTexture(textures.orm);
        material.setMetallicRoughnessTexture(textures.orm);
        material.setRoughnessFactor(ranges.roughness).setMetallicFactor(1);
        if (!this.packed) copy(this.main, /** @type {TextureInfo} */ (material.getMetallicRoughnessTextureInfo()));
        if (!this.anisotropy) return;
        this.anisotropy.setAnisotropyTexture(textures.anisotropy).setAnisotropyStrength(1).setAnisotropyRotation(0);
        if (!this.directions) copy(this.main, this.anisotropy.getAnisotropyTextureInfo());
    }
}

/** @type {WeakMap<Texture, number>} */
const ids = new WeakMap();
let nextId = 1;

/** @param {Texture} texture */
function idOf(texture) {
    if (!ids.has(texture)) ids.set(texture, nextId++);
    return ids.get(texture);
}

/**
 * Where and how a texture is shown, for another texture.
 * @param {TextureInfo} from
 * @param {TextureInfo} to
 */
function copy(from, to) {
    to.setTexCoord(from.getTexCoord()).setWrapS(from.getWrapS()).setWrapT(from.getWrapT());
    to.setMagFilter(from.getMagFilter()).setMinFilter(from.getMinFilter());
    to.setExtension(TRANSFORM, from.getExtension(TRANSFORM));
}

/** @param {StoredMap} map */
const topOf = ({ data }) => (data instanceof Uint16Array ? 65535 : 255);

/**
 * Occlusion, roughness and metallic as floating-point numbers, times the factors of the material.
 * @param {StoredMap | null} map
 * @param {boolean} occluded
 * @param {number} roughness
 * @param {number} metallic
 * @returns {StoredMap}
 */
function packedMap(map, occluded, roughness, metallic) {
    if (!map) return { data: Float32Array.of(1, roughness, metallic), width: 1, height: 1, channels: 3 };
    const { width, height, channels } = map;
    const scale = f(1 / topOf(map));
    const factors = [1, f(roughness), f(metallic)];
    const data = new Float32Array(3 * width * height);
    for (let i = 0; i < data.length; i++) {
        const c = i % 3;
        const value = map.data[Math.floor(i / 3) * channels + (channels < 3 ? 0 : c)];
        data[i] = c === 0 && !occluded ? 1 : Math.min(f(value * scale) * factors[c], 1);
    }
    return { data, width, height, channels: 3 };
}

/**
 * Normals whose x and y a factor scales.
 * @param {StoredMap} map
 * @param {number} scale
 * @returns {StoredMap}
 */
function scaledNormals(map, scale) {
    if (scale === 1) return map;
    const { width, height, channels } = map;
    const unit = f(1 / topOf(map));
    if (channels < 2) throw new MipbakeError('a normal texture has one channel: expected red, green and blue');
    const component = (/** @type {number} */ i, /** @type {number} */ c) =>
        f(f(f(map.data[i * channels + c] * unit) * 2) - 1);
    const data = decodedNormals(component, width, height, channels);
    for (let i = 0; i < data.length; i += 3) {
        data[i] *= f(scale);
        data[i + 1] *= f(scale);
        const length = Math.hypot(data[i], data[i + 1], data[i + 2]);
        for (let c = 0; c < 3; c++) data[i + c] /= length;
    }
    return { data, width, height, channels: 3 };
}

/**
 * Directions and strengths, turned and scaled as KHR_materials_anisotropy says.
 * @param {StoredMap | null} map
 * @param {number} strength
 * @param {number} rotation
 * @returns {StoredMap}
 */
function turned(map, strength, rotation) {
    if (map && strength === 1 && rotation === 0) return map;
    const { width, height, channels } = map ?? { width: 1, height: 1, channels: 3 };
    if (channels < 3) throw new MipbakeError('an anisotropy texture has no blue: expected direction and strength');
    const data = new Float32Array(3 * width * height);
    const [cosine, sine] = [Math.cos(rotation), Math.sin(rotation)];
    const top = map ? topOf(map) : 1;
    for (let i = 0; i < width * height; i++) {
        const held = (/** @type {number} */ c) => (map ? map.data[i * channels + c] / top : [1, 0.5, 1][c]);
        const [x, y] = [2 * held(0) - 1, 2 * held(1) - 1];
        data.set([cosine * x - sine * y, sine * x + cosine * y, held(2) * strength], 3 * i);
    }
    return { data, width, height, channels: 3 };
}

/**
 * @param {StoredMap} map with an alpha channel
 * @returns {StoredMap}
 */
function withoutAlpha({ data, width, height, channels }) {
    const kept = channels - 1;
    const out = new /** @type {any} */ (data.constructor)(width * height * kept);
    for (let i = 0; i < width * height; i++) {
        for (let c = 0; c < kept; c++) out[i * kept + c] = data[i * channels + c];
    }
    return { data: out, width, height, channels: kept };
}

/**
 * The mean of a map of colours, linear.
 * @param {StoredMap} map
 */
function meanColour(map) {
    const { data, channels } = map;
    const sums = [0, 0, 0];
    for (let i = 0; i < data.length; i += channels) {
        for (let c = 0; c < 3; c++) sums[c] += toLinear(data[i + (channels < 3 ? 0 : c)] / topOf(map));
    }
    return sums.map((sum) => Math.min(1, sum / (data.length / channels)));
}
