// Workers that bake parts: threads of Node.js, or those of browsers.

import { nodeModule } from './core.js';
import { MipbakeError } from './errors.js';

/** @typedef {import('./part.js').Part} Part */
/** @typedef {import('./part.js').Made} Made */

class NoWorker extends Error {}

/** @param {unknown} threads */
export function checkThreads(threads) {
    if (threads === undefined || threads === null || (Number.isInteger(threads) && Number(threads) >= 1)) return;
    throw new MipbakeError(`threads is ${threads}: expected a whole number of at least 1`);
}

/** How many threads there are; 1 where no worker can be had. */
export function threadsHere() {
    const node = nodeModule('node:os');
    if (node) return node.availableParallelism();
    return typeof Worker === 'undefined' ? 1 : (navigator.hardwareConcurrency ?? 1);
}

/**
 * A worker that is told what to do, and what it says.
 * @param {any} message
 * @param {Transferable[]} given
 * @param {(answer: any) => void} answered
 * @param {(error: unknown) => void} failed
 * @returns {{terminate: () => void}}
 */
function started(message, given, answered, failed) {
    const node = nodeModule('node:worker_threads');
    if (node) {
        const worker = new node.Worker(new URL('./part_worker.js', import.meta.url), { execArgv: [] });
        worker.on('message', answered).on('error', failed).postMessage(message, given);
        return worker;
    }
    const worker = new Worker(new URL('./part_worker.js', import.meta.url), { type: 'module' });
    worker.onmessage = ({ data }) => answered(data);
    worker.onerror = failed;
    worker.postMessage(message, given);
    return worker;
}

/**
 * What workers make of parts, one each; undefined where one part is enough, or workers do not start.
 * @param {WebAssembly.Module} module
 * @param {import('./network.js').Network} network
 * @param {number} count
 * @param {(k: number, of: number) => Part} part
 * @param {(share: number) => Promise<void>} progress
 * @returns {Promise<Made[] | undefined>}
 */
export async function byWorkers(module, network, count, part, progress) {
    if (count < 2) return undefined;
    const shares = new Float64Array(count);
    /** @type {{terminate: () => void}[]} */
    const workers = [];
    const one = (/** @type {number} */ k) =>
        new Promise((done, failed) => {
            const own = part(k, count);
            const answered = (/** @type {any} */ { share, made, error }) => {
                if (made) done(made);
                else if (error) failed(error.known ? new MipbakeError(error.message) : new Error(error.message));
                else {
                    shares[k] = share;
                    progress(shares.reduce((sum, each) => sum + each) / count).catch(failed);
                }
            };
            const missing = () => failed(new NoWorker());
            try {
                const given = [/** @type {Float32Array} */ (own.stored).buffer];
                workers.push(started({ module, network, part: own }, given, answered, missing));
            } catch {
                missing();
            }
        });
    try {
        return await Promise.all(Array.from({ length: count }, (_, k) => one(k)));
    } catch (error) {
        if (error instanceof NoWorker) return undefined;
        throw error;
    } finally {
        for (const worker of workers) worker.terminate();
    }
}
