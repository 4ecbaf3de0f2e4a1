// Textures whose every level comes from a file: arrays, or KTX 2 through three.js's own loader.
import * as THREE from 'three';
import { KTX2Loader } from 'three/addons/loaders/KTX2Loader.js';

const TYPES = {
  rgba8: [Uint8Array, THREE.UnsignedByteType],
  half: [Uint16Array, THREE.HalfFloatType],
  float: [Float32Array, THREE.FloatType],
};

let loader = null;

export function startLoading(renderer) {
  loader = new KTX2Loader().setTranscoderPath('/engines/node_modules/three/examples/jsm/libs/basis/').detectSupport(renderer);
}

// filter: `levels` samples trilinearly, `generated` too but in levels that WebGL makes, `finest` bilinearly in level 0 at any distance.
export async function loadTexture(map, filter) {
  const url = `/files/${map.file}`;
  const texture = map.kind === 'ktx2' ? await loader.loadAsync(url) : await loadArrays(url, map);
  if (filter === 'levels' && texture.mipmaps.length !== map.levels) {
    throw new Error(`${map.file} has ${map.levels} levels, three.js took ${texture.mipmaps.length}`);
  }
  texture.wrapS = texture.wrapT = THREE.RepeatWrapping;
  texture.magFilter = THREE.LinearFilter;
  texture.minFilter = filter === 'finest' ? THREE.LinearFilter : THREE.LinearMipmapLinearFilter;
  texture.generateMipmaps = filter === 'generated';
  if (filter === 'generated') texture.mipmaps = [];
  texture.anisotropy = 1;
  texture.colorSpace = map.srgb ? THREE.SRGBColorSpace : THREE.NoColorSpace;
  texture.needsUpdate = true;
  return texture;
}

async function loadArrays(url, map) {
  const answer = await fetch(url);
  if (!answer.ok) throw new Error(`${url}: ${answer.status}`);
  const [Values, type] = TYPES[map.kind];
  const all = new Values(await answer.arrayBuffer());
  const levels = [];
  let at = 0;
  for (let level = 0; level < map.levels; level++) {
    const width = Math.max(1, map.width >> level);
    const height = Math.max(1, map.height >> level);
    levels.push({ data: all.subarray(at, at + 4 * width * height), width, height });
    at += 4 * width * height;
  }
  if (at !== all.length) throw new Error(`${url} holds ${all.length} values, expected ${at}`);
  const texture = new THREE.DataTexture(levels[0].data, map.width, map.height, THREE.RGBAFormat, type);
  texture.mipmaps = map.levels > 1 ? levels : [];
  return texture;
}
