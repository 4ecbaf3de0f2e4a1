// Baked levels as the viewer shows them: it has two textures for a material, three where that is anisotropic.

/**
 * @typedef {import('./images.js').Texels} Texels
 * @typedef {{levels: Record<string, Texels>[], wrap: [string, string]}} Stack levels with baseColor, normal, roughness, metallic and perhaps anisotropy
 */

/**
 * What a scene has of its own; the viewer's SETTING has the rest.
 * @param {Stack} plain whose level 0 is the source @param {Stack} baked
 * @param {boolean} down whether green of normals points down
 */
export function sceneOf(plain, baked, down) {
    const images = [], texels = [];
    for (const [name, levels] of [['truth', plain.levels.slice(0, 1)], ['plain', plain.levels], ['mipbake', baked.levels]]) {
        const anisotropic = 'anisotropy' in levels[0];
        images.push({
            name, model: anisotropic ? 'gltf-anisotropic' : 'gltf', wrap: baked.wrap, half: false,
            sizes: levels.map(({ normal }) => [normal.height, normal.width]), srgb: [true, false, false].slice(0, anisotropic ? 3 : 2),
        });
        texels.push(levels.map((level) => [
            together(level.baseColor, level.metallic), together(level.normal, level.roughness, down),
            ...(anisotropic ? [together(level.anisotropy, null)] : []),
        ]));
    }
    return { images, source: true, texels };
}

/** Three channels of one map, and one of another; `down`: green is turned round. */
function together(three, one, down = false) {
    const count = three.width * three.height, data = new Uint8Array(4 * count);
    for (let texel = 0; texel < count; ++texel) {
        for (let channel = 0; channel < 3; ++channel) data[4 * texel + channel] = three.data[three.channels * texel + channel];
        if (down) data[4 * texel + 1] = 255 - data[4 * texel + 1];
        data[4 * texel + 3] = one ? one.data[one.channels * texel] : 255;
    }
    return data;
}
