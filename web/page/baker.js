// Bakes in the browser: decodes the maps of a set, and has a worker bake them.
import { channelsOf, conventionOf, decoded, least, withFactor } from './images.js';
import { setsOf } from './intake.js';
import { SETTING } from './viewer.js';

/**
 * @typedef {{name: string, blob?: Blob, url?: string, about: string}} Download
 * @typedef {{scene: object, verdict: null | {sentence: string, advice: string, better: boolean}, notes: string[],
 *   files: () => Promise<Download>, plain: () => Promise<Download>}} Result
 *   verdict: where it was measured already; plain: MIP maps as other tools make them
 */

export const privacy = 'Nothing is uploaded: the bake runs in this page. After the first visit it works without a network, too.';
export const presets = [];
export const opened = setsOf;

/** Channels of a map, where its file's name does not say which. */
const CHANNELS = { base_color: 'RGB', normal: 'RGB', anisotropy: 'RGB', emissive: 'RGB' };
const NAMES = { base_color: 'baseColor' };
const WITHOUT = { base_color: [0.5, 0.5, 0.5], normal: [0, 0, 1], roughness: 0.5, metallic: 0 };

let worker = null;

/** Prepares the page; says whether there is something to open at once. */
export async function start() {
    navigator.serviceWorker?.register('sw.js').catch(() => {});  // pages from disk have none
    return false;
}

/** Ends what is at work. */
export function stop() {
    worker?.terminate();
    worker = null;
}

/** @param {import('./intake.js').TextureSet} set @returns {Promise<Result>} */
export async function bake(set, { maps, convention }, say) {
    stop();
    const { given, options, notes } = await read(set, maps, convention, say);
    worker = new Worker('worker.js', { type: 'module' });
    const own = worker, tell = (share) => say('Baking …', share);
    const { scene } = await ask(own, { job: 'bake', maps: given, options }, tell);
    const archive = async (which, name) => {
        const { blob } = await ask(own, { job: 'files', which, name: fileName(set.name) });
        return { name, blob, about: `${blob.size < 1e5 ? `${Math.ceil(blob.size / 1e3)} KB` : `${(blob.size / 1e6).toFixed(1)} MB`}: KTX2 files for three.js, Babylon.js and other engines, and every level as PNG` };
    };
    const [files, plain] = [['mipbake', ''], ['plain', '_plain']].map(([which, end]) => () => archive(which, `${fileName(set.name)}${end}.zip`));
    return { scene: { ...SETTING, ...scene }, verdict: null, notes, files, plain };
}

/** The maps as `bake` of src/index.js takes them. */
async function read(set, maps, convention, say) {
    const images = new Map(), given = {}, notes = [], factors = set.factors ?? {};
    for (const [role, choice] of Object.entries(maps)) {
        if (!images.has(choice.file)) {
            say(`Reading ${choice.file.split('/').at(-1)} …`);
            images.set(choice.file, await decoded(await set.files.find((file) => file.name === choice.file).blob(), choice.file));
        }
        const image = images.get(choice.file);
        const alpha = role === 'base_color' && !maps.opacity && least(image, 3) < 255 ? 'A' : '';
        const letters = choice.channels || (CHANNELS[role] ?? 'R') + alpha;
        given[NAMES[role] ?? role] = withFactor(role, channelsOf(image, letters, choice.inverted), factors[role] ?? 1);
    }
    for (const [role, value] of Object.entries(WITHOUT)) given[NAMES[role] ?? role] ??= role in factors && role !== 'normal' ? factors[role] : value;
    if (set.choices) notes.push('The .zip has the textures of this material; mipbake gui bakes a whole .glb.');
    const known = !maps.normal ? 'opengl' : convention || maps.normal.convention || conventionOf(given.normal), normalConvention = known || 'opengl';
    if (!known) notes.push('The normal map is taken as OpenGL: under Maps you can say otherwise.');
    return { given, notes, options: { normalConvention, wrap: set.wrap ?? ['wrap', 'wrap'] } };
}

const fileName = (name) => name.replace(/[^\w.-]+/g, '_').replace(/^[._-]+|[._-]+$/g, '') || 'material';

/** What a worker makes of a job. */
function ask(worker, message, tell = () => {}) {
    return new Promise((done, failed) => {
        worker.onerror = () => failed(new Error('The bake has ended, perhaps because the maps need more memory than this browser gives: try smaller ones, or the program, mipbake gui.'));
        worker.onmessage = ({ data }) => {
            if ('share' in data) tell(data.share);
            else if ('error' in data) failed(new Error(data.error));
            else done(data.done);
        };
        worker.postMessage(message);
    });
}
