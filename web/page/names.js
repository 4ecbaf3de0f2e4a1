// What the name of a file says about the map in it: the essentials of mipbake/source/names.py and matches.py, which have
// the reasons. A name must END in a known word, after words about resolution, format or variant.

/**
 * @typedef {{role: string, channels: string, inverted: boolean, rank: number, convention: string, variant: number}} Meaning
 * @typedef {{word: string, meanings: Meaning[], asset: string}} NameMatch
 * @typedef {{file: string, channels: string, inverted: boolean, convention: string}} Choice
 * @typedef {{maps: Record<string, Choice>, problem: string, role: string, notes: string[]}} Found
 */

/** Roles in the order that people look for them, with what the page calls them. */
export const ROLES = {
    base_color: 'Base colour', normal: 'Normal', roughness: 'Roughness', metallic: 'Metallic', anisotropy: 'Anisotropy',
    occlusion: 'Ambient occlusion', height: 'Height', emissive: 'Emissive', opacity: 'Opacity',
};

const WORDS_OF_ROLES = {
    base_color: 'basecolor basecolour basecol base color colour col albedo alb diffuse diff dif diffusecolor diffusecolour basemap '
        + 'maintex colormap colourmap diffusemap albedomap basecolormap basecolourmap bc d',
    roughness: 'roughness rough rgh roughnessmap roughmap r',
    metallic: 'metallic metalness metal met mtl metallicmap metalnessmap m',
    anisotropy: 'anisotropy anisotropic aniso anisotropymap',
    occlusion: 'ambientocclusion occlusion occ ao mixedao ambientocclusionmap occlusionmap aomap',
    height: 'height displacement displ disp dsp hgt heightmap displacementmap parallax parallaxmap disp16 displacement16 height16 h',
    emissive: 'emissive emission emit emis emissivecolor emissivecolour emissioncolor emissioncolour emissivemap emissionmap e',
    opacity: 'opacity alpha transparency opac cutout opacitymap alphamap alphamask opacitymask',
};
const GLOSS = 'gloss glossiness smoothness smooth gls glossmap glossinessmap smoothnessmap';
const NORMALS = 'normal normals nor norm nrm nml nmp nmap nrm16 normal16 normalmap normalsmap bumpmap ddn n';
const CONVENTIONS = { '': '', gl: 'opengl', ogl: 'opengl', opengl: 'opengl', dx: 'directx', directx: 'directx', d3d: 'directx' };
const LETTERS = { a: 'occlusion', o: 'occlusion', r: 'roughness', m: 'metallic', d: 'height' };
const PACKED = { arm: 'arm', orm: 'orm', rma: 'rma', rmo: 'rmo', mra: 'mra', mro: 'mro', ord: 'ord', ordp: 'ord', mrao: 'mra' };
const UNUSED_OF = 'specular spec sheen coat clearcoat subsurface sss transmission detail bent worldspace objectspace';
const UNUSED_MAPS = 'color colour normal normals roughness rough gloss map mask albedo';
const UNUSED = `${UNUSED_OF} spc specularlevel specularsmoothness specularglossiness specgloss refl reflection cavity cav curvature `
    + 'translucency translucent thickness fuzz ior mask id position anisotropylevel anisotropyangle anisotropyrotation';
const RANK = { inverted: 1, derived: 1, packed: 2, glued: 3 };
const NEEDS_SEPARATOR = new Set(['d', 'n', 'r', 'm', 'h', 'e', 'bc', 'id', 'mads', 'ddn', 'nmp', ...Object.keys(PACKED)]);
const LOOSE = new Set(['smooth', 'cutout', 'id', 'mask']);
const LEAST_GLUED = 5;

const meaning = (role, more = {}) => ({ role, channels: '', inverted: false, rank: 0, convention: '', variant: 0, ...more });
const packed = (role, channels, more = {}) => meaning(role, { channels, rank: RANK.packed, ...more });
const list = (text) => text.split(' ');

const WORDS = (() => {
    const words = new Map(list(UNUSED).map((word) => [word, []]));
    for (const of of list(UNUSED_OF)) for (const map of list(UNUSED_MAPS)) words.set(of + map, []);
    for (const [role, names] of Object.entries(WORDS_OF_ROLES)) for (const word of list(names)) words.set(word, [meaning(role)]);
    words.set('bump', [meaning('height', { rank: RANK.derived })]);
    for (const word of list(GLOSS)) words.set(word, [meaning('roughness', { inverted: true, rank: RANK.inverted })]);
    for (const base of list(NORMALS)) {
        for (const [suffix, convention] of Object.entries(CONVENTIONS)) words.set(base + suffix, [meaning('normal', { convention })]);
    }
    for (const [word, letters] of Object.entries(PACKED)) words.set(word, [...letters].map((letter, i) => packed(LETTERS[letter], 'RGB'[i])));
    const [occlusion, roughness, metallic] = ['occlusion', 'roughness', 'metallic'].map((role, i) => packed(role, 'RGB'[i]));
    for (const word of ['occlusionroughnessmetallic', 'aoroughnessmetallic', 'aoroughmetal']) words.set(word, [occlusion, roughness, metallic]);
    for (const word of ['metallicroughness', 'roughnessmetallic', 'metalroughness', 'roughnessmetalness', 'metalrough']) words.set(word, [roughness, metallic]);
    const smoothness = packed('roughness', 'A', { inverted: true });
    for (const metal of ['metallic', 'metal']) {
        for (const gloss of ['smoothness', 'smooth', 'gloss', 'glossmap', 'glossiness']) words.set(metal + gloss, [packed('metallic', 'R'), smoothness]);
    }
    for (const word of ['maskmap', 'mads']) words.set(word, [packed('metallic', 'R'), packed('occlusion', 'G'), smoothness]);
    words.set('ddna', [meaning('normal'), smoothness]);
    for (const colour of ['albedo', 'basecolor', 'color', 'diffuse']) {
        for (const alpha of ['transparency', 'opacity', 'alpha']) words.set(colour + alpha, [meaning('base_color'), packed('opacity', 'A')]);
    }
    return words;
})();

const TRAILING = /^(?:\d{1,2}k|\d{2,5}x\d{2,5}|128|256|512|1024|2048|4096|8192|16384|lod\d|[uv]\d{1,3}|(?:8|16|32)bit|1\d{3}|(?:var|variant|variation)(?<variant>\d{0,3})|jpe?g|png|exr|tiff?|tga|hdr|webp|avif|ktx2|bmp|srgb|linear|lin|raw|noncolor)$/i;
const COPY = /(?: ?\((\d{1,2})\)| - copy| copy(?: (\d{1,2}))?)$/i;
const CAMEL = /[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+/g;
const MOST_VARIANTS = 1000;

const chunksOf = (stem) => [...stem.matchAll(/[A-Za-z0-9]+/g)];

/** A stem without what trails it, and the number of its variant. @returns {[string, number]} */
function stripped(stem) {
    let variant = 0, copies = 0, copy;
    while ((copy = COPY.exec(stem))) {
        stem = stem.slice(0, copy.index);
        copies += Number(copy[1] ?? copy[2] ?? 1);
    }
    for (;;) {
        const chunks = chunksOf(stem), last = chunks.at(-1), match = chunks.length > 1 ? TRAILING.exec(last[0]) : null;
        if (!match) return [stem, variant + MOST_VARIANTS * copies];
        if (match.groups.variant !== undefined) variant = Number(match.groups.variant || 1);
        stem = stem.slice(0, last.index);
    }
}

/** A stem without resolution, format and number of a copy. @param {string} stem */
export const bareName = (stem) => stripped(stem.replace(/[^A-Za-z0-9]+$/, ''))[0].replace(/[^A-Za-z0-9]+$/, '');

/** Words of a stem in lower case, each with whether a separator precedes it. @returns {[string, boolean][]} */
function split(stem) {
    return chunksOf(stripped(stem)[0]).flatMap(([chunk]) => (
        (chunk.replace(/(?<=[A-Za-z])\d{1,2}k$/i, '').match(CAMEL) ?? []).map((word, i) => [word.toLowerCase(), i === 0])
    ));
}

const joined = (words) => words.map(([word]) => word).join('');

/** What the name of a file, without its extension, can mean. @param {string} stem @returns {NameMatch[]} */
export function interpretations(stem) {
    const words = split(stem);
    let found = [];
    for (let start = Math.max(0, words.length - 5); start < words.length; ++start) {
        const word = joined(words.slice(start)), meanings = WORDS.get(word);
        const trusted = (words[start][1] && start > 0) || !NEEDS_SEPARATOR.has(word) || (word.length >= 3 && start === 0);
        if (meanings && trusted) found.push({ word, meanings, asset: joined(words.slice(0, start)) });
    }
    if (!found.length && words.length) found = glued(words);
    const [bare, variant] = stripped(stem), workflow = /^(.+)[ _-]\d{1,2}K[ _-]METALNESS$/i.exec(bare);  // Poliigon's names
    if (workflow) found.push(...interpretations(workflow[1]));
    return variant ? found.map((each) => ({ ...each, meanings: each.meanings.map((one) => ({ ...one, variant })) })) : found;
}

/** What the last of several words means by how it ends: the longest known word, and only a long one. */
function glued(words) {
    const [whole] = words.at(-1);
    for (let start = 1; start <= whole.length - LEAST_GLUED; ++start) {
        const word = whole.slice(start), meanings = WORDS.get(word);
        if (!meanings || LOOSE.has(word) || !(word.length > LEAST_GLUED || word === 'color')) continue;
        const ranked = meanings.map((one) => ({ ...one, rank: one.rank + RANK.glued }));
        return [{ word, meanings: ranked, asset: joined(words.slice(0, -1)) + whole.slice(0, start) }];
    }
    return [];
}

/** What files of one set mean, by the names of all; null for names without a known word. @param {string[]} stems */
export function classify(stems) {
    const possible = stems.map(interpretations), shared = new Map();
    for (const several of possible) for (const asset of new Set(several.map((m) => m.asset))) shared.set(asset, (shared.get(asset) ?? 0) + 1);
    const better = (p, q) => shared.get(q.asset) - shared.get(p.asset) || Number(q.meanings.length > 0) - Number(p.meanings.length > 0)
        || q.word.length - p.word.length;
    return possible.map((several) => several.toSorted(better)[0] ?? null);
}

export const stemOf = (name) => name.split('/').at(-1).replace(/\.[^.]*$/, '');

/**
 * Which file fills which role; `problem` says in one sentence what only the user can decide, `role` for which role.
 * @param {string[]} files names of images @param {Record<string, string>} chosen role to a file, or to "" for none
 * @returns {Found}
 */
export function find(files, chosen = {}) {
    const named = classify(files.map(stemOf)), maps = {}, notes = [], problems = [];  // each with its role
    // A picture named after the set itself is a preview: its name, as a map's, would be the words of the set.
    const own = (file) => joined(split(stemOf(file)));
    const matches = files.flatMap((file, i) => (named[i]?.meanings ?? []).map((means) => ({ file, ...means })))
        .filter(({ file }) => !named.some((m, i) => m?.meanings.length && m.asset && m.asset === own(file) && files[i] !== file));
    for (const role of Object.keys(ROLES)) {
        if (role in chosen) {
            const said = chosen[role] && interpretations(stemOf(chosen[role])).flatMap((m) => m.meanings).find((m) => m.role === role);
            if (chosen[role]) maps[role] = { ...meaning(role), ...said, file: chosen[role] };
            continue;
        }
        const [first, ...others] = preferred(role, matches.filter((m) => m.role === role), notes);
        if (first) maps[role] = first;
        if (others.length) problems.push([role, `${[first, ...others].map((m) => m.file).join(' and ')} all look like the ${ROLES[role].toLowerCase()} map: choose one.`]);
    }
    const unknown = files.filter((file, i) => named[i] === null && !Object.values(maps).some((m) => m.file === file) && !isPreview(file));
    const missing = ['normal', 'roughness'].filter((role) => !maps[role] && !(role in chosen));
    if (!maps.base_color && !('base_color' in chosen) && unknown.length) missing.unshift('base_color');
    if (missing.length && !problems.length) {
        const words = missing.map((role) => ROLES[role].toLowerCase());
        problems.push([missing[0], `No file name says which image is the ${words.join(' or the ')} map: choose it below.`]);
    }
    const [role, problem] = problems[0] ?? ['', ''];
    return { maps, problem, role, notes };

    function isPreview(file) {
        return own(file) !== '' && named.some((m) => m?.meanings.length && m.asset.startsWith(own(file)));
    }
}

/** Those of one role between which nothing decides: one, where something does. */
function preferred(role, several, notes) {
    const best = Math.min(...several.map((m) => m.rank));
    let first = several.filter((m) => m.rank === best);
    if (role === 'normal' && first.length === 2 && new Set(first.map((m) => m.convention)).size === 2 && first.every((m) => m.convention)) {
        first = first.filter((m) => m.convention === 'opengl');
        notes.push(`Both normal conventions are there: ${first[0].file} (OpenGL) is used.`);
    }
    const least = Math.min(...first.map((m) => m.variant));
    return first.filter((m) => m.variant === least);
}
