// Bakes beside the page, so that it answers meanwhile: two stacks, what the viewer shows of them, and files.
import { bake, ktx2 } from './src/index.js';
import { png } from './images.js';
import { sceneOf } from './scene.js';
import { zipped } from './zip.js';

const FILE_NAMES = {
    baseColor: 'base_color', normal: 'normal', roughness: 'roughness', metallic: 'metallic', anisotropy: 'anisotropy',
    occlusion: 'occlusion', height: 'height', emissive: 'emissive', opacity: 'opacity',
};
const TEXTURES = { baseColor: 'baseColor', normal: 'normal', orm: 'occlusionRoughnessMetallic', anisotropy: 'anisotropy', emissive: 'emissive' };
const PLAIN = { method: 'linear', filter: 'box' };
const SHARE = 0.85;  // of the time, roughly, that the network takes

let work = null;

const jobs = {
    async bake({ maps, options }) {
        const told = (from, to) => (share) => postMessage({ share: from + (to - from) * share });
        const baked = await bake(maps, { ...options, onProgress: told(0, SHARE) });
        const plain = await bake(maps, { ...options, ...PLAIN, onProgress: told(SHARE, 1) });
        work = { maps, stacks: { mipbake: baked, plain } };
        const scene = sceneOf(plain, baked, options.normalConvention === 'directx');
        return [{ scene }, [...new Set(scene.texels.flat(2).map((array) => array.buffer))]];
    },

    /** An archive of a stack, in two forms: a KTX2 file for each texture of a glTF material, and a PNG file for each level
     * of each map that was given, and of the roughness, which takes up bumps. */
    async files({ name, which }) {
        const files = [], { maps, stacks } = work, stack = stacks[which];
        const packed = { ...stack, levels: stack.levels.map((level) => ({ ...level, orm: together(level) })) };
        const texels = stack.width % 4 || stack.height % 4 ? 'rgba8' : 'uastc';  // blocks are of 4 x 4 texels
        const textures = Object.entries(TEXTURES).filter(([map]) => map === 'orm' || (map in stack.levels[0] && (map === 'normal' || isMap(maps[map]))));
        for (const [map, called] of textures) files.push({ name: `${name}/ktx2/${name}_${called}.ktx2`, bytes: await ktx2(packed, map, { texels }) });
        for (const [index, level] of stack.levels.entries()) {
            for (const [map, image] of Object.entries(level)) {
                if (!isMap(maps[map]) && map !== 'roughness') continue;
                files.push({ name: `${name}/png/${name}_${FILE_NAMES[map]}_mip${String(index).padStart(2, '0')}.png`, bytes: await png(image) });
            }
        }
        return [{ blob: zipped(files) }, []];
    },
};

const isMap = (given) => typeof given === 'object' && !Array.isArray(given);

/** Occlusion in red, where it has the size of the maps that shade; `ktx2` finds roughness and metallic unrounded. */
function together({ occlusion, roughness: { width, height } }) {
    const data = new Uint8Array(3 * width * height).fill(255);
    if (occlusion?.width === width && occlusion.height === height) occlusion.data.forEach((value, i) => { data[3 * i] = value; });
    return { data, width, height, channels: 3 };
}

self.addEventListener('message', async ({ data: { job, ...wanted } }) => {
    try {
        const [done, given] = await jobs[job](wanted);
        postMessage({ done }, given);
    } catch (error) {
        const known = error.name === 'MipbakeError';
        postMessage({ error: known ? error.message : `Sorry, this is a defect of mipbake (${error.message}): please report it.` });
    }
});
