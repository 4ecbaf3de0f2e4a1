#!/usr/bin/env node
// npx mipbake IN.glb OUT.glb

import { access, rename, rm, stat } from 'node:fs/promises';
import { basename, dirname, join } from 'node:path';
import { parseArgs } from 'node:util';

import { FILTERS, METHODS, MipbakeError } from './index.js';

const HELP = `Usage: mipbake IN.glb OUT.glb [options]

Gives the materials of a glTF file textures with baked MIP levels, as KTX2.

  --method METHOD    ${METHODS.join(', ')} (default ${METHODS[0]})
  --sampler SAMPLER  of the engine: trilinear (default), anisotropic, accumulated,
                     "anisotropic 4x", "accumulated, bias -1"
  --filter FILTER    ${FILTERS.join(', ')}
                     (default ${FILTERS[0]})
  --texels TEXELS    uastc or rgba8 (default uastc)
  --help             this text

Node.js 22.15 and later compress the textures. The Python tool mipbake reads more
formats, and has methods that search.`;

const text = /** @type {const} */ ({ type: 'string' });
const OPTIONS = { method: text, sampler: text, filter: text, texels: text, help: /** @type {const} */ ({ type: 'boolean' }) };

/** Whether a line of progress is of use. */
const shows = process.stderr.isTTY;

/** @param {string} line */
function progress(line) {
    if (shows) process.stderr.write(`\r\x1b[K${line}`);
}

/** @param {number} bytes */
const size = (bytes) => (bytes < 2 ** 20 ? `${(bytes / 2 ** 10).toFixed(1)} KB` : `${(bytes / 2 ** 20).toFixed(1)} MB`);

async function main() {
    const started = performance.now();
    const { values, positionals } = parsed();
    if (values.help) return console.log(HELP);
    if (positionals.length !== 2) {
        throw new MipbakeError(`expected an input and an output file, got ${positionals.length} names: see mipbake --help`);
    }
    const [from, to] = positionals;
    if (!/\.(glb|gltf)$/i.test(from)) throw new MipbakeError(`${from} is no .glb or .gltf file: expected glTF`);
    if (!/\.glb$/i.test(to)) throw new MipbakeError(`${to} does not end in .glb: expected such a name for the output`);
    await access(from).catch(() => {
        throw new MipbakeError(`${from} cannot be read: expected a .glb or .gltf file`);
    });
    await access(dirname(to)).catch(() => {
        throw new MipbakeError(`${dirname(to)} is no folder: make it first`);
    });
    const { io, mipbake } = await gltfTransform();
    const document = await io.read(from).catch((/** @type {any} */ error) => {
        throw new MipbakeError(`${from} cannot be read (${oneLine(error)}): check it with the glTF validator`);
    });
    const shown = (/** @type {number} */ share) => progress(`baking: ${Math.round(100 * share)} %`);
    /** @type {string[]} */
    const names = [];
    document.setLogger(quiet);
    await document.transform(mipbake({ ...values, onProgress: shown, onBaked: (/** @type {string[]} */ own) => names.push(...own) }));
    progress('');
    const total = document.getRoot().listMaterials().length;
    if (!names.length) {
        throw new MipbakeError(
            `${from} has no material to bake, of ${total}: expected one with a normal or a metallicRoughness texture in ` +
                'PNG, JPEG or WebP',
        );
    }
    const beside = join(dirname(to), `.${basename(to)}.${process.pid}.glb`);
    try {
        await io.write(beside, document);
        await rename(beside, to);
    } catch (error) {
        await rm(beside, { force: true });
        throw new MipbakeError(`${to} cannot be written (${oneLine(error)}): choose another place`);
    }
    const bytes = await Promise.all([from, to].map(async (file) => (await stat(file)).size));
    const seconds = ((performance.now() - started) / 1000).toFixed(1);
    console.log(`${to}: ${names.length} of ${total} materials baked, ${bytes.map(size).join(' in, ')} out, ${seconds} s`);
}

function parsed() {
    try {
        return parseArgs({ options: OPTIONS, allowPositionals: true });
    } catch (error) {
        throw new MipbakeError(`${oneLine(error)}: see mipbake --help`);
    }
}

/** Warnings of transforms go to stderr, each in a line of its own. */
const quiet = {
    debug() {},
    info() {},
    warn(/** @type {string} */ line) {
        progress('');
        console.error(line);
    },
    error(/** @type {string} */ line) {
        console.error(line);
    },
};

async function gltfTransform() {
    try {
        const [{ NodeIO }, { ALL_EXTENSIONS }, { mipbake }] = await Promise.all([
            import('@gltf-transform/core'),
            import('@gltf-transform/extensions'),
            import('./gltf_transform.js'),
        ]);
        return { io: new NodeIO().registerExtensions(ALL_EXTENSIONS), mipbake };
    } catch (error) {
        if (/** @type {any} */ (error).code !== 'ERR_MODULE_NOT_FOUND') throw error;
        throw new MipbakeError(
            'the command needs glTF-Transform: run npm install @gltf-transform/core @gltf-transform/extensions',
        );
    }
}

/** @param {unknown} error */
function oneLine(error) {
    return String(error instanceof Error ? error.message : error).split('\n')[0].replace(/[.:]$/, '');
}

main().catch((error) => {
    progress('');
    console.error(error instanceof MipbakeError ? `mipbake: ${error.message}` : error);
    process.exitCode = error instanceof MipbakeError ? 2 : 1;
});
