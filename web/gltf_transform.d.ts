import type { Transform } from '@gltf-transform/core';
import type { Options } from './index.d.ts';

export interface MipbakeOptions extends Pick<Options, 'method' | 'filter' | 'sampler' | 'threads' | 'assets' | 'onProgress'> {
    /** The function of the package `sharp`, as the transforms of glTF-Transform take it. Left out: `sharp` in Node.js,
     * else the decoder of the browser. */
    encoder?: unknown;
    /** What the KTX2 textures hold. Default `uastc`; KHR_texture_basisu allows for nothing else, but three.js loads
     * `rgba8`. */
    texels?: 'uastc' | 'rgba8';
    /** Told the names of the materials that were baked. */
    onBaked?: (names: string[]) => void;
}

/** Gives every material that has a normal or a metallicRoughness texture KTX2 textures with baked levels. */
export function mipbake(options?: MipbakeOptions): Transform;
