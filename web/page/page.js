// The page: what is dropped becomes texture sets, one of them is baked, and the viewer shows it.
import * as baker from './baker.js';
import { chosen, dropped, mapsOf } from './intake.js';
import { ROLES } from './names.js';
import { Viewer } from './viewer.js';
import { effectOf, inWords, measured } from './verdict.js';

const at = (id) => document.getElementById(id);
const OPTIONAL = { base_color: 'none: grey', normal: 'none: flat', roughness: 'none: 0.5 everywhere', metallic: 'none: not metallic' };
const CONVENTIONS = [['', 'found by mipbake'], ['opengl', 'OpenGL (green is up)'], ['directx', 'DirectX (green is down)']];

/** What is on the page: the sets that were dropped, which one, what the user chose for it, and how often was begun. */
const state = { sets: [], index: 0, chosen: {}, convention: '', preset: '', run: 0, urls: [] };

// ---- what is dropped

async function take(files) {
    const run = begin('Reading …');
    Object.assign(state, { sets: [], index: 0, chosen: {}, convention: '' });
    at('maps').hidden = true;
    try {
        const sets = await baker.opened(await files);
        if (run !== state.run) return;
        state.sets = sets;
        await bake();
    } catch (error) {
        if (run === state.run) fail(error);
    }
}

/** Clears what was shown, and tells what goes on; what was at work before is of no use any more. */
function begin(words) {
    for (const url of state.urls.splice(0)) URL.revokeObjectURL(url);
    for (const id of ['start', 'problem', 'result']) at(id).hidden = true;
    for (const id of ['download', 'plain']) at(id).hidden = true;
    at('size').textContent = at('verdict').textContent = '';
    dispose(at('viewer'));
    at('again').hidden = at('work').hidden = false;
    say(words);
    return ++state.run;
}

/** Gives back what the graphics card holds for a viewer, which browsers do late, and for a few viewers alone. */
function dispose(place) {
    if (place.viewer) {
        place.viewer.broken = true;
        place.viewer.renderer.gl.getExtension('WEBGL_lose_context')?.loseContext();
        place.viewer = null;
    }
    place.replaceChildren();
}

function say(words, share = null) {
    at('step').textContent = share === null ? words : `${words} ${Math.round(100 * share)} %`;
    if (share === null) at('share').removeAttribute('value');
    else at('share').value = share;
}

/** One sentence of what is wrong. */
function fail(error) {
    at('work').hidden = true;
    at('problem').hidden = false;
    at('result').hidden = !at('viewer').viewer;
    at('size').textContent = '';
    // All that is said on purpose is an Error; what is of another kind, the browser has thrown.
    at('problem').textContent = error.constructor === Error ? error.message : `Sorry, this is a defect of mipbake (${error.message}): please report it.`;
    at('start').hidden = state.sets.length > 0;
}

function startAgain() {
    begin('');
    baker.stop();
    Object.assign(state, { sets: [], chosen: {} });
    for (const id of ['work', 'maps', 'again']) at(id).hidden = true;
    at('start').hidden = false;
    at('files').focus();
}

// ---- baking

async function bake() {
    const run = begin('Baking …'), set = state.sets[state.index], found = mapsOf(set, state.chosen);
    document.title = `${set.name} – mipbake`;
    choices(set, found);
    if (found.problem) {
        at('maps').open = true;
        fail(new Error(found.problem));
        at(`map-${found.role}`).focus();
        return;
    }
    try {
        const tell = (words, share) => { if (run === state.run) say(words, share); };
        const result = await baker.bake(set, { maps: found.maps, chosen: state.chosen, convention: state.convention, preset: state.preset }, tell);
        if (run !== state.run) return;
        await show(result, run, [...found.notes, ...result.notes]);
    } catch (error) {
        if (run === state.run) fail(error);
    }
}

/** @param {import('./baker.js').Result} result */
async function show(result, run, notes) {
    at('work').hidden = true;
    at('result').hidden = false;
    at('verdict').textContent = result.verdict?.sentence ?? 'Comparing with plain MIP maps …';
    at('size').textContent = 'Writing the files …';
    at('notes').textContent = notes.join(' ');
    if (document.activeElement === document.body) at('verdict').focus();  // the button that was pressed is gone
    const files = result.files(), viewer = at('viewer').viewer = new Viewer(at('viewer'), result.scene);
    files.catch(() => {});  // it is waited for below
    await viewer.set({ sides: [0, 1] });  // until the texels are loaded
    if (run !== state.run) return;
    if (viewer.broken) throw new Error(at('viewer').textContent);
    const verdict = result.verdict ?? inWords(Object.fromEntries(Object.entries(await measured(viewer)).map(([away, found]) => [away, effectOf(found)])));
    if (run !== state.run) return;
    at('verdict').textContent = `${verdict.sentence} ${verdict.advice}`;
    viewer.change({ sides: viewer.choices.map((_, index) => index) });
    const baked = await files;
    if (run !== state.run) return;
    at('download').classList.toggle('second', !verdict.better);
    offer('download', baked, `Download ${baked.name}`);
    at('size').textContent = baked.about;
    const plain = verdict.better ? null : await result.plain();
    if (plain && run === state.run) offer('plain', plain, 'Download plain MIP maps');
}

function offer(id, { name, blob, url }, words) {
    const link = at(id), made = url ?? URL.createObjectURL(blob);
    if (!url) state.urls.push(made);
    Object.assign(link, { href: made, download: name, textContent: words, hidden: false });
}

// ---- choosers

function choices(set, found) {
    const files = set.files.map((file) => [file.name, file.name.split('/').at(-1)]), made = [];
    if (state.sets.length > 1) made.push(select('Material', state.sets.map((each, i) => [String(i), each.name]), String(state.index), (value) => {
        Object.assign(state, { index: Number(value), chosen: {}, convention: '' });
        bake();
    }));
    if (baker.presets.length) made.push(engine());
    for (const [role, label] of Object.entries(ROLES)) {
        if (!files.length) break;
        const none = ['', OPTIONAL[role] ?? 'none'];
        made.push(select(label, [none, ...files], found.maps[role]?.file ?? '', (value) => { state.chosen[role] = value; }, `map-${role}`));
    }
    if (files.length) made.push(select('Normals are', CONVENTIONS, state.convention, (value) => { state.convention = value; }));
    at('choices').replaceChildren(...made);
    at('maps').hidden = !made.length;
}

const engine = () => select('Files for', baker.presets, state.preset, (value) => { state.preset = value; });

function select(label, options, value, chose, id = '') {
    const made = document.createElement('label'), list = document.createElement('select');
    list.append(...options.map(([key, words]) => new Option(words, key)));
    list.value = value;
    list.id = id;
    list.addEventListener('change', () => chose(list.value));
    made.append(label, list);
    return made;
}

// ---- hands

for (const [button, input] of [['files', 'file-input'], ['folder', 'folder-input']]) {
    at(button).addEventListener('click', () => at(input).click());
    at(input).addEventListener('change', () => {
        const files = chosen(at(input).files);
        at(input).value = '';  // the same files may be chosen again
        if (files.length) take(files);
    });
}
at('example').addEventListener('click', async () => take((await import('./example.js')).example()));
at('again').addEventListener('click', startAgain);
at('bake').addEventListener('click', () => {
    if (state.sets.length) bakeChosen();
});

/** As the user has it in the choosers: what a list shows is chosen, even where it was not touched. */
function bakeChosen() {
    const set = state.sets[state.index], found = mapsOf(set, state.chosen);
    if (found.problem) {
        const roles = Object.keys(ROLES).filter((role) => !(role in state.chosen));
        for (const role of roles) state.chosen[role] = found.maps[role]?.file ?? '';
    }
    bake();
}

addEventListener('dragover', (event) => {
    event.preventDefault();
    at('start').classList.add('over');
});
addEventListener('dragleave', () => at('start').classList.remove('over'));
addEventListener('drop', (event) => {
    event.preventDefault();
    at('start').classList.remove('over');
    take(dropped(event.dataTransfer));
});

at('privacy').textContent = baker.privacy;
const given = await baker.start();
if (baker.presets.length) {
    at('engine').replaceChildren(engine());
    at('maps').querySelector('summary').textContent = 'Engine and maps';
}
if (given) take(null);
