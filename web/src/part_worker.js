// A worker that bakes a part: src/workers.js starts it, and says which.

import { Core, nodeModule } from './core.js';
import { MipbakeError } from './errors.js';
import { bakedPart } from './part.js';

const port = nodeModule('node:worker_threads')?.parentPort ?? self;

port.onmessage = async (/** @type {MessageEvent} */ { data: { module, network, part } }) => {
    try {
        const shown = (/** @type {number} */ share) => port.postMessage({ share });
        const made = await bakedPart(new Core(module), network, part, shown);
        const given = [made.top, ...made.sinks].map(({ buffer }) => buffer);
        port.postMessage({ made }, given);
    } catch (error) {
        const { message } = /** @type {Error} */ (error);
        port.postMessage({ error: { message, known: error instanceof MipbakeError } });
    }
};
