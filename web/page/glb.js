// The materials of a .glb file, as texture sets.

const MAGIC = 0x46546c67, JSON_CHUNK = 0x4e4f534a, BINARY_CHUNK = 0x004e4942;

/** @typedef {{name: string, files: import('./intake.js').Source[], choices: Record<string, import('./names.js').Choice>, factors: Record<string, number>, wrap: [string, string]}} Material */

/**
 * Materials with a normal or a roughness texture. Textures keep what their factors say: roughness, metallic and the
 * normal's scale go into the texels, as `mipbake bake` has it, and the colour's factor stays in the material.
 * @param {Blob} blob @returns {Promise<Material[]>}
 */
export async function materialsOf(blob, name) {
    const bytes = await blob.arrayBuffer(), view = new DataView(bytes);
    if (bytes.byteLength < 20 || view.getUint32(0, true) !== MAGIC) throw new Error(`${name} is no .glb file: export it again.`);
    const chunks = {};
    for (let at = 12; at + 8 <= bytes.byteLength; at += 8 + view.getUint32(at, true)) {
        chunks[view.getUint32(at + 4, true)] = new Uint8Array(bytes, at + 8, Math.min(view.getUint32(at, true), bytes.byteLength - at - 8));
    }
    const found = [], problems = [];
    let materials;
    try {
        const document = JSON.parse(new TextDecoder().decode(chunks[JSON_CHUNK]));
        materials = (document.materials ?? []).map((material, index) => () => materialOf(document, chunks[BINARY_CHUNK], material, index));
    } catch {
        throw new Error(`${name} is broken: export it again.`);
    }
    for (const read of materials) {
        try {
            const material = read();
            if (material.choices.normal || material.choices.roughness) found.push(material);
        } catch (error) {
            problems.push(error.constructor === Error ? error : new Error(`${name} is broken: export it again.`));
        }
    }
    if (!found.length) throw problems[0] ?? new Error(`${name} has no material with a normal or a roughness texture: there is nothing to bake.`);
    return found;
}

const OTHERS = ['KHR_materials_pbrSpecularGlossiness', 'KHR_materials_unlit'];  // models that this page does not bake
const SHADING = ['normal', 'roughness'];

function materialOf(document, binary, material, index) {
    const pbr = material.pbrMetallicRoughness ?? {}, anisotropy = material.extensions?.KHR_materials_anisotropy;
    const files = new Map(), choices = {}, name = material.name || `material ${index + 1}`;
    const wraps = [];
    let main = '';
    const take = (slot, roles) => {
        if (!slot || OTHERS.some((other) => other in (material.extensions ?? {}))) return;
        // Textures are baked together where they lie alike on the surface.
        const place = JSON.stringify([slot.texCoord ?? 0, slot.extensions?.KHR_texture_transform]);
        main ||= place;
        if (place !== main) {
            if (SHADING.some((role) => role in roles)) throw new Error(`The normals and the roughness of ${name} lie differently on the surface: use the program, mipbake gui.`);
            return;
        }
        const texture = document.textures?.[slot.index] ?? {};
        const source = texture.extensions?.EXT_texture_webp?.source ?? texture.extensions?.EXT_texture_avif?.source ?? texture.source;
        const file = imageOf(document, binary, source);
        files.set(file.name, file);
        const sampler = document.samplers?.[texture.sampler] ?? {};
        wraps.push([sampler.wrapS, sampler.wrapT].map((mode) => (mode === 33071 ? 'clamp' : 'wrap')));
        for (const [role, channels] of Object.entries(roles)) choices[role] = { file: file.name, channels, inverted: false, convention: 'opengl' };
    };
    take(pbr.metallicRoughnessTexture, { roughness: 'G', metallic: 'B' });
    take(material.normalTexture, { normal: '' });
    take(pbr.baseColorTexture, { base_color: '' });
    take(material.occlusionTexture, { occlusion: 'R' });
    take(material.emissiveTexture, { emissive: '' });
    take(anisotropy?.anisotropyTexture, { anisotropy: '' });
    return {
        name, files: [...files.values()], choices, wrap: wraps[0] ?? ['wrap', 'wrap'],
        factors: { roughness: pbr.roughnessFactor ?? 1, metallic: pbr.metallicFactor ?? 1, normal: material.normalTexture?.scale ?? 1 },
    };
}

function imageOf(document, binary, index) {
    const image = document.images?.[index];
    if (!image) throw new Error('A texture of the .glb file is compressed or has no image: use the program, mipbake gui.');
    const name = image.name || `image ${index + 1}`, { byteOffset = 0, byteLength } = image.uri ? {} : document.bufferViews[image.bufferView];
    if (image.uri && !image.uri.startsWith('data:')) throw new Error(`The image ${image.uri} is not in the .glb file: export the file with its images inside.`);
    const blob = async () => {
        if (image.uri) return (await fetch(image.uri)).blob();
        return new Blob([binary.subarray(byteOffset, byteOffset + byteLength)], { type: image.mimeType });
    };
    return { name: `${name} (${index})`, blob };
}
