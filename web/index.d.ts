/** Values of a map: integers as image files store them (colours sRGB-encoded, vectors moved into 0 to 1), or numbers as
 * they are (colours linear Rec.709, vectors signed). */
export type Texels = Uint8Array | Uint8ClampedArray | Uint16Array | Float32Array;

/** A map, top row first. An `ImageData` is one, too. Channels are counted where they are not given. */
export interface TextureMap {
    data: Texels;
    width: number;
    height: number;
    channels?: number;
}

/** A map at a level, of the same kind of numbers as the map that it comes from; 8 bits where there was none. */
export interface LevelMap {
    data: Uint8Array | Uint16Array | Float32Array;
    width: number;
    height: number;
    channels: number;
}

/** The maps of a material; maps that shade have one shape, and smaller ones are enlarged. */
export interface Maps {
    /** Red, green and blue, or grey; alpha is opacity, unless there is a map of that. A number or three, linear, stand
     * for a map. Where it is left out: 0.5. */
    baseColor?: TextureMap | number | number[];
    /** Tangent-space normals, of two channels or more. Where it is left out: flat. */
    normal?: TextureMap;
    /** Perceptual roughness. It is needed, here or in `orm`. */
    roughness?: TextureMap | number;
    /** Where it is left out: 0. */
    metallic?: TextureMap | number;
    /** Occlusion, roughness and metallic in red, green and blue, as glTF packs them. */
    orm?: TextureMap;
    /** As KHR_materials_anisotropy has it: direction in red and green, strength in blue. */
    anisotropy?: TextureMap;
    /** These do not shade: they get plain averages. */
    occlusion?: TextureMap;
    emissive?: TextureMap;
    height?: TextureMap;
    opacity?: TextureMap;
}

/** Whoever looks the stack up: most lookups of a pixel (1, 2, 4, 8 or 16), MIP bias (-4 to 4), frames (1 or 8) that the
 * engine averages. */
export interface Sampler {
    lookups: number;
    bias: number;
    frames: number;
}

export type Wrap = 'wrap' | 'clamp';
export type Target = 'gltf' | 'gltf-anisotropic';
export type Method = 'neural' | 'linear' | 'lean';
export type Filter = 'gaussian' | 'box' | 'tent' | 'mitchell' | 'blackman-harris';

export interface Options {
    /** `neural`: a trained network. `linear`: averages, what engines make. `lean`: averages with the variance of slopes
     * in the roughness. Default `neural`. */
    method?: Method;
    /** What is made: `auto` makes `gltf-anisotropic` of materials with an anisotropy map, and `gltf` of others. */
    target?: Target | 'auto';
    /** Pixel filter of the renderer. Default `gaussian`. */
    filter?: Filter;
    /** The sampler, or what it is called: `trilinear` (default), `anisotropic`, `accumulated`, `anisotropic 4x`,
     * `accumulated, bias -1`. */
    sampler?: Partial<Sampler> | string;
    /** What stands beyond the borders, or that along u and along v. Default `wrap`. */
    wrap?: Wrap | [Wrap, Wrap];
    /** Whether green of the normal map points up (`opengl`, default) or down; it stays so. */
    normalConvention?: 'opengl' | 'directx';
    /** What a renderer tests opacity against: then as much of it passes at every level. Left out: it is blended. */
    alphaCutoff?: number;
    /** Sides are enlarged to multiples of this number; 4 is what textures of blocks in glTF need. Default 1. */
    multipleOf?: number;
    /** Workers that `neural` has, 1 for none: levels are the same. Left out: up to 8, as many as there are threads of the
     * processor and 131,072 texels each. */
    threads?: number;
    /** Told the finished share, from 0 to 1. */
    onProgress?: (share: number) => void;
    /** Gives the bytes of a file of dist/ by its name; left out, they come from beside the package. */
    assets?: (name: string) => Promise<ArrayBuffer | Uint8Array>;
}

/** Levels from level 0 down to 1 x 1. */
export interface Stack {
    width: number;
    height: number;
    model: Target;
    method: string;
    filter: string;
    /** Null for methods that take none. */
    sampler: Sampler | null;
    /** Name of the trained weights. */
    weights: string | null;
    wrap: [Wrap, Wrap];
    normalConvention: 'opengl' | 'directx';
    /** The maps that were given, and the maps of the model that were not, at every level. A map of fewer levels has its
     * last one in their place. */
    levels: Record<string, LevelMap>[];
    /** What engines sample, unrounded: base colour (3, linear), metallic, roughness, normal (3, green up), and of
     * `gltf-anisotropic` direction (2) and strength. */
    stored: { data: Float32Array; width: number; height: number; channels: number }[];
}

/** What was given cannot be baked; the message says why in one sentence. */
export class MipbakeError extends Error {}

/** Every level of the maps of a material, level 0 included. */
export function bake(maps: Maps, options?: Options): Promise<Stack>;

export const METHODS: Method[];
export const FILTERS: Filter[];

/** A map of a stack with all levels as a KTX2 file. `uastc`: blocks that loaders turn into what a graphics card takes;
 * `rgba8`: texels as they are. Levels are compressed with Zstandard where Node.js has it (22.15 and later). */
export function ktx2(stack: Stack, map: string, options?: Ktx2Options): Promise<Uint8Array>;

export interface Ktx2Options {
    /** Default `uastc`. */
    texels?: 'uastc' | 'rgba8';
    onProgress?: (share: number) => void;
    assets?: (name: string) => Promise<ArrayBuffer | Uint8Array>;
}
