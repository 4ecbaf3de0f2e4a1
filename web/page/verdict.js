// The verdict, from pictures of the viewer itself, in the words of mipbake/stack/verdict.py.
import { AWAY, posed } from './viewer.js';

const SIDE = 128, SAMPLES = 24;
const LAMPS = [-40, 10];  // degrees: highlights lie elsewhere under each

// A difference counts where the displayed error changes by a tenth, and by half a step of the 8 bits of a screen: nobody
// sees less. With these limits, verdicts on pieces of 256 x 256 texels of 18 scanned sets, baked by `auto`, are those of
// mipbake/stack/verdict.py far away on all sets, and near and at middle distance on two in three; where they differ, one of
// the two sees no difference.
const LEAST_SHARE = 0.1, LEAST_STEP = 0.5 / 255;

/** @typedef {1 | 0 | -1} Effect better than plain, the same, worse */

/**
 * How the bake looks beside plain MIP maps at every distance: root mean squares of what differs from the truth in what a
 * screen displays, from 0 to 1, on a floor. The truth is drawn twice, because the product of the errors against both has
 * no part of their noise.
 * @param viewer whose texels are loaded
 * @returns {Promise<Record<string, {plain: number, mipbake: number}>>}
 */
export async function measured(viewer) {
    const { renderer, scene } = viewer, [plain, mipbake] = scene.stacks, found = {};
    for (const away of Object.keys(AWAY)) {
        const pose = { ...viewer.view, shape: 'plane', show: 0, widen: 0, tiling: 1, ...posed('plane', away, SIDE, 1, plain), lights: 0, lightHeight: 0 };
        const sums = [0, 0];
        let count = 0;
        for (const lightAzimuth of LAMPS) {
            const all = [0, SIDE], drawn = (stack, samples = 0, before = 0) => {
                renderer.drawSide(0, stack, { ...pose, lightAzimuth }, samples, before, all, all);
                return renderer.read(0);
            };
            renderer.resize(SIDE, SIDE);
            const pictures = [drawn(plain), drawn(mipbake), drawn(scene.source, SAMPLES), drawn(scene.source, SAMPLES, SAMPLES)];
            pictures[3] = pictures[3].map((mean, i) => 2 * mean - pictures[2][i]);  // it was the mean of both
            const [first, second, truth, again] = pictures.map((picture) => displayed(picture, pictures[0]));
            for (let i = 0; i < truth.length; ++i) {
                sums[0] += (first[i] - truth[i]) * (first[i] - again[i]);
                sums[1] += (second[i] - truth[i]) * (second[i] - again[i]);
            }
            count += truth.length;
            await new Promise((done) => setTimeout(done));  // the page answers in between
        }
        const [own, other] = sums.map((sum) => Math.sqrt(Math.max(sum, 0) / Math.max(count, 1)));
        found[away] = { plain: own, mipbake: other };
    }
    viewer.change();  // the size of its pictures is its own again
    return found;
}

/** What a screen shows of linear radiance where a picture has a surface: x / (1 + x), and the sRGB curve. */
function displayed(radiance, surface) {
    const shown = [];
    for (let i = 0; i < radiance.length; ++i) {
        if (i % 4 === 3 || surface[i - (i % 4) + 3] === 0) continue;
        const x = Math.max(radiance[i], 0), y = x / (1 + x);
        shown.push(y <= 0.0031308 ? 12.92 * y : 1.055 * y ** (1 / 2.4) - 0.055);
    }
    return shown;
}

/** @returns {Effect} */
export function effectOf({ plain, mipbake }) {
    const gain = plain - mipbake;
    return Math.abs(gain) < Math.max(LEAST_STEP, LEAST_SHARE * plain) ? 0 : gain > 0 ? 1 : -1;
}

const WORDS = [[1, 'calmer and truer to the source'], [0, 'no visible gain'], [-1, 'worse than plain MIP maps']];
const PLACES = { near: 'near', middle: 'at middle distance', far: 'far away' };

/**
 * @param {Record<string, Effect>} effects by distance
 * @returns {{sentence: string, advice: string, better: boolean}} better: somewhere
 */
export function inWords(effects) {
    const parts = WORDS.flatMap(([effect, words]) => {
        const where = whereOf(effects, effect);
        return where ? [`${words} ${where}`] : [];
    });
    const sentence = `${parts.join('; ')}.`, all = Object.values(effects), gains = all.includes(1), loses = all.includes(-1);
    return { sentence: sentence[0].toUpperCase() + sentence.slice(1), ...adviceOf(gains ? (loses ? 'mixed' : 'gains') : loses ? 'loses' : 'same') };
}

const ADVICE = {
    gains: 'Recommended.', mixed: 'Look at both before you decide.', same: 'Plain MIP maps look the same with this material: they are enough.',
    loses: 'Plain MIP maps look better with this material: keep them.',
};

/** What to do. @param {'gains' | 'mixed' | 'same' | 'loses'} outcome */
export const adviceOf = (outcome) => ({ advice: ADVICE[outcome], better: outcome === 'gains' || outcome === 'mixed' });

function whereOf(effects, wanted) {
    const places = Object.keys(PLACES).filter((place) => effects[place] === wanted);
    if (places.length === Object.keys(PLACES).length) return wanted ? 'at every distance' : 'at any distance';
    if (places.join() === 'middle,far') return 'from middle distance on';
    return places.map((place) => PLACES[place]).join(wanted ? ' and ' : ' or ');
}
