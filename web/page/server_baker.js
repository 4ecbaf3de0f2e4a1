// Bakes in `mipbake gui`, the program that served this page: it reads all that mipbake reads, and bakes by `auto`.
import { adviceOf } from './verdict.js';
import { nameOf } from './intake.js';

export const privacy = 'Your files go to mipbake on this computer, and nowhere else.';
export let presets = [];

let stopping = new AbortController();

/** Prepares the page; says whether the command line named something to open. */
export async function start() {
    const { presets: engines, source } = await (await fetch('api/start')).json();
    presets = [['', 'any program: PNG files of all levels'], ...engines];
    return source !== null;
}

export function stop() {
    stopping.abort();
    stopping = new AbortController();
}

/** Texture sets in files, or in what the command line named. @param {import('./intake.js').Source[] | null} files */
export async function opened(files) {
    stop();
    if (files) {
        await ask('clear');
        const alone = `${nameOf('', files)}/`;
        for (const file of files) {
            const name = file.name.includes('/') || /\.(zip|glb)$/i.test(file.name) ? file.name : alone + file.name;
            const answer = await fetch(`api/file?name=${encodeURIComponent(name)}`, { method: 'POST', body: await file.blob(), signal: stopping.signal });
            done(await answer.json());
        }
    }
    const { sets } = await ask('sets');
    return sets.map(({ name, files: names }, index) => ({ name, index, files: names.map((each) => ({ name: each })), choices: names.length ? undefined : {} }));
}

/** @returns {Promise<import('./baker.js').Result>} */
export async function bake(set, { chosen, convention, preset }, say) {
    stop();
    const maps = Object.fromEntries(Object.entries(chosen).map(([role, file]) => [role, file || null]));
    const wanted = { index: set.index, maps, convention, preset };
    const made = await ask('bake', wanted, ({ phase, share }) => say(`Baking: ${WORDS[phase] ?? phase}`, share));
    const verdict = made.verdict && { sentence: made.verdict.sentence, ...adviceOf(made.verdict.outcome) };
    const download = (kind, { file, about }) => ({ name: file, url: `api/result/${kind}`, about });
    return {
        scene: made.scene, verdict, notes: made.notes,
        files: async () => download('baked', made), plain: async () => download('plain', await ask('plain', wanted)),
    };
}

const WORDS = { prefilter: 'trying methods', 'other maps': 'other maps', encode: 'writing', write: 'writing', check: 'measuring the files', read: 'reading', comparison: 'plain MIP maps' };

/** What the program answers: lines of JSON, the last of which has the result. */
async function ask(what, body = {}, tell = () => {}) {
    const answer = await fetch(`api/${what}`, { method: 'POST', body: JSON.stringify(body), signal: stopping.signal });
    let rest = '', last = null;
    const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
    for (let part = await reader.read(); !part.done; part = await reader.read()) {
        const lines = (rest + part.value).split('\n');
        rest = lines.pop();
        for (const line of lines) {
            last = JSON.parse(line);
            if ('phase' in last) tell(last);
        }
    }
    return done(last);
}

function done(message) {
    if (message?.done) return message.done;
    throw new Error(message?.error ?? 'mipbake has ended: start it again, and load this page.');
}
