// What was dropped or chosen, as texture sets: folders, images, archives and .glb files.
import { materialsOf } from './glb.js';
import { isImage, isOtherImage } from './images.js';
import { bareName, find, interpretations, stemOf } from './names.js';
import { unzipped } from './zip.js';

/**
 * @typedef {{name: string, blob: () => Promise<Blob>}} Source a file, its name with its folders
 * @typedef {{name: string, files: Source[], choices?: Record<string, import('./names.js').Choice>, factors?: Record<string, number>, wrap?: [string, string]}} TextureSet
 */

/** Everything in a drop, folders opened. @param {DataTransfer} dropped @returns {Promise<Source[]>} */
export async function dropped(dropped) {
    // Entries must be taken before anything is awaited: the browser empties the list.
    const entries = [...dropped.items].filter((item) => item.kind === 'file').map((item) => item.webkitGetAsEntry?.() ?? item.getAsFile());
    return (await Promise.all(entries.filter(Boolean).map((entry) => (entry instanceof File ? [source(entry)] : opened(entry))))).flat();
}

async function opened(entry, folder = '') {
    const path = folder + entry.name;
    if (entry.isFile) return [source(await new Promise((done, failed) => entry.file(done, failed)), path)];
    const reader = entry.createReader(), found = [];
    for (;;) {  // a reader gives a hundred entries at a time
        const some = await new Promise((done, failed) => reader.readEntries(done, failed));
        if (!some.length) break;
        for (const each of some) found.push(...await opened(each, `${path}/`));
    }
    return found;
}

/** @param {FileList | File[]} files of a chooser @returns {Source[]} */
export const chosen = (files) => [...files].map((file) => source(file, file.webkitRelativePath || file.name));

const source = (file, name = file.name) => ({ name, blob: async () => file });

/** The texture sets in some files. @param {Source[]} files @returns {Promise<TextureSet[]>} */
export async function setsOf(files) {
    const sets = [], loose = [];
    for (const file of files) {
        if (/\.zip$/i.test(file.name)) {
            const own = stemOf(file.name);
            try {
                loose.push(...(await unzipped(await file.blob())).map((each) => ({ ...each, name: `${own}/${each.name}` })));
            } catch (error) {
                throw new Error(`${file.name} cannot be opened: ${error.message}.`);
            }
        } else if (/\.glb$/i.test(file.name)) sets.push(...await materialsOf(await file.blob(), file.name));
        else loose.push(file);
    }
    const folders = new Map();
    for (const file of loose.filter((each) => isImage(each.name))) {
        const folder = file.name.split('/').slice(0, -1).join('/');
        folders.set(folder, [...(folders.get(folder) ?? []), file]);
    }
    const several = [...folders].map(([folder, images]) => ({ name: nameOf(folder, images), files: images }));
    // Pictures beside a set, and folders without maps, are no sets; where there is nothing else, the user chooses maps.
    const maps = several.filter(({ files: images }) => images.some((each) => interpretations(stemOf(each.name)).some((m) => m.meanings.length)));
    sets.push(...(maps.length || sets.length ? maps : several));
    if (sets.length) return sets;
    const other = files.find((file) => isOtherImage(file.name));
    if (other) throw new Error(`${last(other.name)} is a kind of image that browsers do not read: save the maps as PNG, or use the program, mipbake gui.`);
    if (files.some((file) => /\.gltf$/i.test(file.name))) throw new Error('A .gltf file keeps its images elsewhere: export it as .glb, or use the program, mipbake gui.');
    throw new Error('No image is in there: expected the maps of a material, such as wood_color.png, wood_normal.png and wood_roughness.png.');
}

const last = (path) => path.split('/').at(-1);

/** The folder, or what the names of the images begin with. */
export function nameOf(folder, images) {
    const parts = folder.split('/').filter((part) => part && !/^textures$/i.test(part));
    if (parts.length) return parts.at(-1);
    const stems = images.map((each) => stemOf(each.name));
    let shared = stems[0];
    while (!stems.every((stem) => stem.startsWith(shared))) shared = shared.slice(0, -1);
    const name = bareName(shared);
    return stems.length > 1 && name ? name : 'material';
}

/**
 * Which image of a set fills which role, after what the user chose.
 * @param {TextureSet} set @param {Record<string, string>} by the user: role to file, "" for none
 */
export function mapsOf(set, by) {
    if (!set.choices) return find(set.files.map((file) => file.name), by);
    const maps = { ...set.choices };
    for (const [role, file] of Object.entries(by)) {
        delete maps[role];
        if (file) maps[role] = set.choices[role]?.file === file ? set.choices[role] : { file, channels: '', inverted: false, convention: 'opengl' };
    }
    return { maps, problem: '', role: '', notes: [] };
}
