import assert from 'node:assert/strict';
import { EventEmitter } from 'node:events';
import { test } from 'node:test';

import { packaged } from '../src/core.js';
import { bake, FILTERS, ktx2, MipbakeError } from '../src/index.js';
import { resampleWeights } from '../src/pixel_filter.js';
import { samplerOf } from '../src/sampler.js';
import { toByte, toEncoded, toLinear } from '../src/srgb.js';

/** @param {number} side @param {number} channels @param {(x: number, y: number, c: number) => number} value */
function map(side, channels, value) {
    const data = new Uint8Array(side * side * channels);
    data.forEach((_, i) => {
        const texel = Math.floor(i / channels);
        data[i] = value(texel % side, Math.floor(texel / side), i % channels);
    });
    return { data, width: side, height: side, channels };
}
const rough = map(8, 1, (x, y) => 60 + 10 * x + y);
const bumpy = map(8, 3, (x, y, c) => [128 + 20 * (x % 3), 128 - 15 * (y % 2), 240][c]);

test('a flat material stays what it is at every level', async () => {
    const maps = { baseColor: map(16, 3, () => 150), roughness: map(16, 1, () => 100), metallic: 0 };
    for (const method of /** @type {const} */ (['neural', 'linear', 'lean'])) {
        const { levels } = await bake(maps, { method });
        assert.equal(levels.length, 5);
        for (const level of levels) {
            const { width, height } = level.normal;
            assert.equal(level.normal.data.length, 3 * width * height);
            level.roughness.data.forEach((each) => assert.ok(Math.abs(each - 100) <= 2, `${method}: ${each}`));
            level.baseColor.data.forEach((each) => assert.ok(Math.abs(each - 150) <= 2, `${method}: ${each}`));
        }
    }
});

test('bumps that a level cannot hold widen its roughness', async () => {
    const { levels } = await bake({ normal: bumpy, roughness: map(8, 1, () => 50) });
    const last = levels[levels.length - 1];
    assert.deepEqual([last.roughness.width, last.roughness.height], [1, 1]);
    assert.ok(last.roughness.data[0] > 60, `${last.roughness.data[0]}`);
});

test('canvases, numbers and floating-point maps are taken', async () => {
    const canvas = { data: new Uint8ClampedArray(4 * 64).fill(200), width: 8, height: 8 };
    const metallic = { data: new Float32Array(64).fill(0.25), width: 8, height: 8 };
    const { levels } = await bake({ baseColor: canvas, roughness: 0.5, metallic }, { method: 'linear' });
    assert.equal(levels[0].baseColor.channels, 4);
    assert.equal(levels[0].baseColor.data[0], 200);
    assert.equal(levels[0].roughness.data[0], 128);
    assert.ok(levels[0].metallic.data instanceof Float32Array);
    assert.ok(Math.abs(levels[3].metallic.data[0] - 0.25) < 1e-6);
});

test('a map of opacity counts in place of the alpha of a canvas', async () => {
    const canvas = { data: new Uint8ClampedArray(4 * 64).fill(255), width: 8, height: 8 };
    const opacity = map(8, 1, (x) => (x < 4 ? 255 : 0));
    const { levels } = await bake({ baseColor: canvas, roughness: rough, opacity });
    assert.equal(levels[0].baseColor.channels, 3);
    assert.deepEqual([levels[0].opacity.data[0], levels[3].opacity.data[0]], [255, 128]);
});

test('green may point down, and stays so', async () => {
    const down = { ...bumpy, data: bumpy.data.map((value, i) => (i % 3 === 1 ? 255 - value : value)) };
    const up = await bake({ normal: bumpy, roughness: rough });
    const turned = await bake({ normal: down, roughness: rough }, { normalConvention: 'directx' });
    up.stored.forEach((level, i) => {
        level.data.forEach((value, k) => assert.ok(Math.abs(value - turned.stored[i].data[k]) < 1e-5));
    });
    turned.levels[1].normal.data.forEach((value, i) => {
        const other = up.levels[1].normal.data[i];
        assert.ok(Math.abs(value - (i % 3 === 1 ? 255 - other : other)) <= 1);
    });
});

test('progress runs from 0 to 1', async () => {
    /** @type {number[]} */
    const shares = [];
    await bake(
        { roughness: map(64, 1, (x) => x) },
        { onProgress: (/** @type {number} */ share) => shares.push(share) },
    );
    assert.equal(shares[0], 0);
    assert.equal(shares[shares.length - 1], 1);
    assert.deepEqual(
        shares,
        [...shares].sort((a, b) => a - b),
    );
});

test('weights of every filter sum to 1', () => {
    for (const filter of FILTERS) {
        for (const [from, to] of [
            [64, 64],
            [61, 30],
            [7, 1],
        ]) {
            const { weights, taps, index } = resampleWeights(from, to, filter, 'wrap');
            for (let i = 0; i < to; i++) {
                const sum = weights.subarray(i * taps, (i + 1) * taps).reduce((total, each) => total + each, 0);
                assert.ok(Math.abs(sum - 1) < 1e-6);
            }
            assert.ok(index.every((each) => each >= 0 && each < from));
        }
    }
});

test('samplers have names', () => {
    assert.deepEqual(samplerOf('trilinear'), { lookups: 1, bias: 0, frames: 1 });
    assert.deepEqual(samplerOf('Anisotropic'), { lookups: 16, bias: 0, frames: 1 });
    assert.deepEqual(samplerOf('accumulated, anisotropic 4x, bias -1.5'), { lookups: 4, bias: -1.5, frames: 8 });
    assert.deepEqual(samplerOf({ lookups: 2 }), { lookups: 2, bias: 0, frames: 1 });
    for (const wrong of ['cubic', 'anisotropic 3x', 'bias 5', { lookups: 3 }, { taps: 2 }, 7, '']) {
        assert.throws(() => samplerOf(wrong), MipbakeError, String(wrong));
    }
});

/** @type {[string, any, any, RegExp][]} */
const WRONG = [
    ['no roughness', { normal: bumpy }, {}, /there is no roughness/],
    ['an unknown map', { rougness: rough }, {}, /unknown map "rougness": expected baseColor, normal/],
    ['a map twice', { roughness: rough, orm: map(8, 3, () => 9) }, {}, /roughness is given twice/],
    [
        'other shapes',
        { roughness: rough, normal: map(4, 3, () => 200), metallic: { data: new Uint8Array(8), width: 8, height: 1 } },
        {},
        /metallic is 8 x 1 and the largest map is 8 x 8/,
    ],
    [
        'too few numbers',
        { roughness: { data: new Uint8Array(60), width: 8, height: 8, channels: 1 } },
        {},
        /holds 60 numbers for 8 x 8/,
    ],
    ['no numbers', { roughness: { data: [1, 2], width: 1, height: 2 } }, {}, /no data of a known kind/],
    ['no size', { roughness: { data: new Uint8Array(4), width: 2 } }, {}, /roughness is 2 x undefined/],
    ['NaN', { roughness: { data: new Float32Array([NaN]), width: 1, height: 1 } }, {}, /NaN or infinite/],
    ['out of range', { roughness: { data: new Float32Array([3]), width: 1, height: 1 } }, {}, /roughness holds 3/],
    [
        'a colour map as normals',
        { roughness: rough, normal: map(8, 3, () => 90) },
        {},
        /does not look like a normal map/,
    ],
    [
        'encoded normals as numbers',
        {
            roughness: rough,
            normal: { data: new Float32Array(192).map((_, i) => [0.5, 0.5, 1][i % 3]), width: 8, height: 8 },
        },
        {},
        /encoded in 0 to 1/,
    ],
    ['an unknown option', { roughness: rough }, { fitler: 'box' }, /unknown option "fitler": expected method/],
    [
        'an unknown method',
        { roughness: rough },
        { method: 'auto' },
        /unknown method "auto": expected neural, linear, lean/,
    ],
    ['an unknown filter', { roughness: rough }, { filter: 'cubic' }, /unknown filter "cubic": expected gaussian/],
    ['an unknown wrap', { roughness: rough }, { wrap: 'mirror' }, /unknown wrap "mirror": expected wrap, clamp/],
    ['half a thread', { roughness: rough }, { threads: 0.5 }, /threads is 0.5: expected a whole number/],
    ['a cutoff of 0', { roughness: rough }, { alphaCutoff: 0 }, /alphaCutoff is 0/],
];
for (const [what, maps, options, says] of WRONG) {
    test(`${what}: one sentence`, async () => {
        await assert.rejects(bake(maps, options), (/** @type {any} */ error) => {
            assert.ok(error instanceof MipbakeError, error.stack);
            assert.match(error.message, says);
            assert.ok(!error.message.includes('\n') && error.message.length < 300);
            return true;
        });
    });
}

test('engines without SIMD bake the same but for rounding', async () => {
    const [own, maps, options] = [WebAssembly.validate, { normal: bumpy, roughness: rough }, { threads: 1 }];
    const wanted = await bake(maps, options);
    /** @type {string[]} */
    const names = [];
    const assets = (/** @type {string} */ name) => (names.push(name), packaged(name));
    WebAssembly.validate = () => false;
    try {
        const { stored } = await bake(maps, { ...options, assets });
        stored.forEach(({ data }, level) =>
            data.forEach((value, i) => assert.ok(Math.abs(value - wanted.stored[level].data[i]) < 2e-5)),
        );
        assert.deepEqual(await ktx2(wanted, 'normal', { assets }), await ktx2(wanted, 'normal'));
    } finally {
        WebAssembly.validate = own;
    }
    assert.ok(names.includes('bakes-scalar.wasm') && !names.includes('bakes.wasm'), names.join());
});

test('bytes of colours are their rounded encoding', () => {
    const value = new Float32Array(1);
    const bits = new Int32Array(value.buffer);
    const check = () => assert.equal(toByte(value[0]), Math.floor(toEncoded(value[0]) * 255 + 0.5), `${value[0]}`);
    for (let byte = 1; byte < 256; byte++) {
        value[0] = toLinear((byte - 0.5) / 255);
        for (bits[0] -= 20; toByte(value[0]) < byte; bits[0]++) check();
        for (let i = 0; i < 20; i++, bits[0]++) check();
    }
    for (value[0] = 0; value[0] <= 1; value[0] += 0.00037) check();
    assert.deepEqual([-1, 0, 1, 2, Infinity, NaN].map(toByte), [0, 0, 255, 255, 255, 0]);
});

const node = /** @type {any} */ (process.getBuiltinModule('node:worker_threads'));
const own = node.Worker;

/** @param {any} kind of workers that a bake of three parts finds; gives the stack and how many were started */
async function byThree(kind) {
    let started = 0;
    const construct = (/** @type {any} */ of, /** @type {any[]} */ given) => (started++, Reflect.construct(of, given));
    node.Worker = new Proxy(kind, { construct });
    try {
        return { ...(await bake({ normal: bumpy, roughness: rough }, { threads: 3 })), started };
    } finally {
        node.Worker = own;
    }
}

class Refused {
    constructor() {
        throw new Error('no threads are left');
    }
}

class Missing extends own {
    constructor() {
        super('./no_such_file.js');
    }
}

class Broken extends EventEmitter {
    postMessage() {
        queueMicrotask(() => this.emit('message', { error: { message: 'the maps do not fit', known: true } }));
    }
    terminate() {}
}

test('workers bake parts, or the caller where none starts', async () => {
    const wanted = await bake({ normal: bumpy, roughness: rough }, { threads: 1 });
    for (const kind of [own, Refused, Missing]) {
        const { stored, started } = await byThree(kind);
        assert.deepEqual(stored, wanted.stored);
        assert.equal(started, 3);
    }
    await assert.rejects(byThree(Broken), (error) => error instanceof MipbakeError && /do not fit/.test(error.message));
});

test('files of the package that are missing are named', async () => {
    const assets = async (/** @type {string} */ name) => {
        throw new MipbakeError(`${name} is not here`);
    };
    await assert.rejects(bake({ roughness: rough }, { assets }), /bakes.wasm is not here/);
});

test('a map of a stack becomes a KTX2 file', async () => {
    const stack = await bake({ normal: bumpy, roughness: rough }, { method: 'linear' });
    for (const texels of /** @type {const} */ (['uastc', 'rgba8'])) {
        const file = await ktx2(stack, 'normal', { texels });
        const view = new DataView(file.buffer);
        assert.deepEqual([...file.subarray(1, 4)], [...new TextEncoder().encode('KTX')]);
        assert.deepEqual(
            [20, 24, 40].map((at) => view.getUint32(at, true)),
            [8, 8, 4],
        );
    }
    await assert.rejects(ktx2(stack, 'gloss'), /the stack has no map gloss: expected normal, roughness/);
});
