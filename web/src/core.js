// The native core as WebAssembly. Its functions are those of csrc/wasm/bakes.cpp. The structures of csrc/ops lie in
// memory as wasm32 lays them out: pointers, int and size_t take 4 bytes, int64_t takes 8 and is aligned to 8.

import { MipbakeError } from './errors.js';

/** @typedef {(name: string) => Promise<ArrayBuffer | Uint8Array>} Assets Gives the bytes of a file of dist/ by name. */

/** @type {WeakMap<Assets, Map<string, Promise<any>>>} */
const known = new WeakMap();

/**
 * What is made of a file of dist/, once for each source of files.
 * @template T
 * @param {Assets} assets
 * @param {string} name
 * @param {(bytes: Uint8Array) => T | Promise<T>} make
 * @returns {Promise<T>}
 */
export function once(assets, name, make) {
    const made = known.get(assets) ?? new Map();
    known.set(assets, made);
    if (!made.has(name)) {
        // A copy, because Buffer of Node.js has methods of other meanings under the names of Uint8Array.
        const found = assets(name).then((bytes) => make(new Uint8Array(bytes)));
        found.catch(() => made.delete(name)); // another try may find it
        made.set(name, found);
    }
    return made.get(name);
}

/**
 * Where the files of dist/ lie. Each is spelt out, which is how bundlers find them.
 * @type {Record<string, () => URL>}
 */
const FILES = {
    'bakes.wasm': () => new URL('../dist/bakes.wasm', import.meta.url),
    'bakes-scalar.wasm': () => new URL('../dist/bakes-scalar.wasm', import.meta.url),
    'mipbake-3.json': () => new URL('../dist/mipbake-3.json', import.meta.url),
    'mipbake-3.safetensors': () => new URL('../dist/mipbake-3.safetensors', import.meta.url),
    'mipbake-3-anisotropic.json': () => new URL('../dist/mipbake-3-anisotropic.json', import.meta.url),
    'mipbake-3-anisotropic.safetensors': () => new URL('../dist/mipbake-3-anisotropic.safetensors', import.meta.url),
    'mipbake-3-ggx.json': () => new URL('../dist/mipbake-3-ggx.json', import.meta.url),
    'mipbake-3-ggx.safetensors': () => new URL('../dist/mipbake-3-ggx.safetensors', import.meta.url),
};

/**
 * A module of Node.js; undefined elsewhere. An import would keep bundlers for browsers busy.
 * @param {string} name
 * @returns {any}
 */
export const nodeModule = (name) => /** @type {any} */ (globalThis).process?.getBuiltinModule?.(name);

/** @type {Assets} The files beside this package: from disk in Node.js, else fetched. */
export async function packaged(name) {
    const url = FILES[name]();
    if (url.protocol === 'file:') {
        return nodeModule('node:fs/promises')
            .readFile(url)
            .catch((/** @type {any} */ error) => {
                throw new MipbakeError(`${name} of mipbake cannot be read (${error.code}): install the package again`);
            });
    }
    const answer = await fetch(url).catch(() => undefined);
    if (!answer?.ok) {
        throw new MipbakeError(`${url.href} cannot be loaded: copy dist/ of mipbake there, or pass assets`);
    }
    return answer.arrayBuffer();
}

/** @param {number} bytes */
const megabytes = (bytes) => `${Math.ceil(bytes / 2 ** 20)} MB`;

/** A module with one function, of one packet: engines before 2023 take none. */
// prettier-ignore
const SIMD = new Uint8Array([
    0, 97, 115, 109, 1, 0, 0, 0, 1, 5, 1, 96, 0, 1, 123, 3, 2, 1, 0, 10, 8, 1, 6, 0, 65, 0, 253, 15, 11,
]);

/** One instance of the module, and what it was lent. A fault ends it, so every job takes one of its own. */
export class Core {
    /** @param {WebAssembly.Module} module */
    constructor(module) {
        this.module = module;
        const refuse = () => 52; // ENOSYS: nothing is written anywhere
        const system = { fd_close: refuse, fd_seek: refuse, fd_write: refuse };
        /** @type {any} */
        this.exports = new WebAssembly.Instance(module, { wasi_snapshot_preview1: system }).exports;
        this.exports._initialize();
    }

    /** @param {Assets} assets */
    static async of(assets) {
        const name = WebAssembly.validate(SIMD) ? 'bakes.wasm' : 'bakes-scalar.wasm';
        return new Core(await once(assets, name, (bytes) => WebAssembly.compile(/** @type {any} */ (bytes))));
    }

    /**
     * Calls a function of the module; a fault becomes a MipbakeError.
     * @param {string} name
     * @param {...number} args
     * @returns {number}
     */
    call(name, ...args) {
        try {
            return this.exports[name](...args);
        } catch (error) {
            if (!(error instanceof WebAssembly.RuntimeError)) throw error;
            const text = new Uint8Array(this.exports.memory.buffer, this.exports.last_fault());
            const said = new TextDecoder().decode(text.subarray(0, text.indexOf(0)));
            if (said === 'std::bad_alloc') throw tooLarge(0);
            throw new Error(`the core of mipbake failed${said ? `: ${said}` : ''}`, { cause: error });
        }
    }

    /**
     * Memory for so many bytes, aligned for every type.
     * @param {number} bytes
     */
    take(bytes) {
        const at = this.call('take', bytes) >>> 0;
        if (!at) throw tooLarge(bytes);
        return at;
    }

    /** @param {number} at */
    give(at) {
        this.call('give', at);
    }

    /**
     * Floats in memory. The view is good until memory is taken the next time.
     * @param {number} at
     * @param {number} count
     */
    floats(at, count) {
        return new Float32Array(this.exports.memory.buffer, at, count);
    }

    /**
     * A copy of bytes in memory.
     * @param {number} at
     * @param {number} count
     */
    bytes(at, count) {
        return new Uint8Array(this.exports.memory.buffer, at, count).slice();
    }

    /**
     * A copy of an array in memory.
     * @param {Float32Array | Int32Array} array
     */
    put(array) {
        const at = this.take(Math.max(4, array.byteLength));
        const kind = array instanceof Float32Array ? Float32Array : Int32Array;
        new kind(this.exports.memory.buffer, at, array.length).set(array);
        return at;
    }

    /**
     * A structure in memory, from what stands at some of its bytes; all others are 0.
     * @param {number} size
     * @param {[number, 'int' | 'int64' | 'float' | 'byte', number][]} fields
     */
    structure(size, fields) {
        const at = this.take(size);
        new Uint8Array(this.exports.memory.buffer, at, size).fill(0);
        const view = new DataView(this.exports.memory.buffer, at, size);
        for (const [place, kind, value] of fields) {
            if (kind === 'float') view.setFloat32(place, value, true);
            else if (kind === 'byte') view.setUint8(place, value);
            else view.setInt32(place, value, true); // the upper half of an int64_t stays 0
        }
        return at;
    }
}

/** @param {number} bytes */
function tooLarge(bytes) {
    const what = bytes ? ` of ${megabytes(bytes)}` : '';
    return new MipbakeError(
        `the maps do not fit into the 4 GB of WebAssembly (an array${what} is left over): expected smaller ones, or ` +
            'the Python tool',
    );
}
