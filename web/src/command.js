#!/usr/bin/env node
// npx mipbake IN.glb OUT.glb

import { access, realpath, rename, rm, stat } from 'node:fs/promises';
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
  --threads COUNT    of the processor (default: up to 8)
  --help             this text

Node.js 22.15 and later compress the textures. The Python tool mipbake reads more
formats, and has methods that search.`;

const text = /** @type {const} */ ({ type: 'string' });
const OPTIONS = {
    method: text,
    sampler: text,
    filter: text,
    texels: text,
    threads: text,
    help: /** @type {const} */ ({ type: 'boolean' }),
};

const COMPRESSED = ['KHR_draco_mesh_compression', 'EXT_meshopt_compression', 'KHR_meshopt_compression'];

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
        throw new MipbakeError(
            `expected an input and an output file, got ${positionals.length} names: see mipbake --help`,
        );
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
    const [own, other] = await Promise.all([from, to].map((file) => realpath(file).catch(() => file)));
    if (own === other) throw new MipbakeError(`${to} is the input: expected another name for the output`);
    const before = (await stat(from)).size;
    const { document, io, mipbake } = await opened(from);
    const shown = (/** @type {number} */ share) => progress(`baking: ${Math.round(100 * share)} %`);
    /** @type {string[]} */
    const names = [];
    await document.transform(
        mipbake({
            ...values,
            threads: values.threads && Number(values.threads),
            onProgress: shown,
            onBaked: (/** @type {string[]} */ own) => names.push(...own),
        }),
    );
    progress('');
    const total = document.getRoot().listMaterials().length;
    if (!names.length) {
        throw new MipbakeError(
            `${from} has no material to bake, of ${total}: expected one with a normal or a metallicRoughness texture ` +
                'in PNG, JPEG or WebP',
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
    const after = (await stat(to)).size;
    const seconds = ((performance.now() - started) / 1000).toFixed(1);
    const sizes = `${size(before)} in, ${size(after)} out`;
    console.log(`${to}: ${names.length} of ${total} materials baked, ${sizes}, ${seconds} s`);
}

function parsed() {
    try {
        return parseArgs({ options: OPTIONS, allowPositionals: true });
    } catch (error) {
        throw new MipbakeError(`${oneLine(error)}: see mipbake --help`);
    }
}

/** Warnings of mipbake go to stderr, each in a line of its own. */
const quiet = {
    debug() {},
    info() {},
    warn(/** @type {string} */ line) {
        if (!line.startsWith('mipbake: ')) return; // of extensions that are missing, which are named elsewhere
        progress('');
        console.error(line);
    },
    error(/** @type {string} */ line) {
        console.error(line);
    },
};

/**
 * A document, and what writes and bakes it.
 * @param {string} file
 */
async function opened(file) {
    const { NodeIO, ALL_EXTENSIONS, mipbake } = await gltfTransform();
    const io = new NodeIO().registerExtensions(ALL_EXTENSIONS).setLogger(quiet);
    const broken = (/** @type {any} */ error) => {
        throw new MipbakeError(`${file} cannot be read (${oneLine(error)}): check it with the glTF validator`);
    };
    const parsed = await io.readAsJSON(file).catch(broken);
    const { extensionsUsed = [], extensionsRequired = [] } = parsed.json;
    const compressed = extensionsUsed.find((name) => COMPRESSED.includes(name));
    if (compressed) {
        throw new MipbakeError(
            `${file} has geometry that is compressed (${compressed}): bake it before it is compressed, or with the ` +
                'Python tool, which leaves it as it is',
        );
    }
    const known = new Set(ALL_EXTENSIONS.map((each) => each.EXTENSION_NAME));
    const unknown = extensionsUsed.filter((name) => !known.has(name));
    const needed = unknown.find((name) => extensionsRequired.includes(name));
    if (needed)
        throw new MipbakeError(`${file} needs ${needed}, which glTF-Transform does not know: use the Python tool`);
    if (unknown.length) quiet.warn(`mipbake: ${unknown.join(', ')} is not known to glTF-Transform, and is left out`);
    const document = (await io.readJSON(parsed).catch(broken)).setLogger(quiet);
    return { document, io, mipbake };
}

async function gltfTransform() {
    try {
        const [{ NodeIO }, { ALL_EXTENSIONS }, { mipbake }] = await Promise.all([
            import('@gltf-transform/core'),
            import('@gltf-transform/extensions'),
            import('./gltf_transform.js'),
        ]);
        return { NodeIO, ALL_EXTENSIONS, mipbake };
    } catch (error) {
        if (/** @type {any} */ (error).code !== 'ERR_MODULE_NOT_FOUND') throw error;
        throw new MipbakeError(
            'the command needs glTF-Transform: run npm install @gltf-transform/core @gltf-transform/extensions',
        );
    }
}

/** @param {unknown} error */
function oneLine(error) {
    return String(error instanceof Error ? error.message : error)
        .split('\n')[0]
        .replace(/[.:]$/, '');
}

main().catch((error) => {
    progress('');
    console.error(error instanceof MipbakeError ? `mipbake: ${error.message}` : error);
    process.exitCode = error instanceof MipbakeError ? 2 : 1;
});
